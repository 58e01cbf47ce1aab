"""The sections of docs/results.md on robots beside the A1, and on the whole-body controller."""

from __future__ import annotations

import json
from typing import Any

from experiments.committed import RESULTS, figure, rows
from loco_mjx.compare.markup import markdown

ROBOTS = """## Other robots, on a CPU

`python -m experiments.robots` trains a blind policy with the `fast` preset for each, by PPO alone. Deterministic,
{episodes} episodes of 40 s in scenes it has not seen; distance ± its standard deviation over the episodes.
"""
WALKS = """## The whole-body controller

`python -m experiments.whole_body`: the A1 under commands, {seconds:g} s each, without any learning. A command is
tracked where mean speed and yaw rate from 1 s on are within 0.05 m/s and 0.05 rad/s of it and the robot does not fall;
on flat ground commands, friction and mass are varied. "Unsolved" are the quadratic programs whose forces are not
certain to 1 N, in which the last forces stand in.
"""
BLOCKS = "`heightfield` (5 cm blocks) straight ahead at {speed:g} m/s, MJX"
PUSH = "push sideways of {newtons:g} N for {seconds:g} s, C MuJoCo"
COST = """`{command}`: {per_second:,.0f} ticks per second of {num_envs} robots on {devices} CPU devices, which other
work shared. A program takes ours {program:,.0f} µs of a core, {peers}; a whole tick {tick:,.0f} µs.
"""


def robots() -> str:
    """The section on robots; nothing where there are no results."""
    body = []
    for path in sorted((RESULTS / "robots").glob("*/evaluation.json")):
        result = json.loads(path.read_text())
        metrics, curve = result["metrics"], rows(path.parent / "metrics.csv")
        config = json.loads((path.parent / "config.json").read_text())
        distance = metrics["distance"]
        body.append(
            [
                config["env"]["robot"],
                result["task"],
                f"{result['samples']:,}",
                f"{curve[-1]['time/seconds'] / 60:.0f} min",
                f"{distance['mean']:.2f} ± {distance['std']:.2f}",
                figure([metrics], "length", 0),
                figure([metrics], "collisions", 0),
                str(result["num_episodes"]),
            ]
        )
    if not body:
        return ""
    head = ["robot", "task", "samples", "time (machine shared)", "distance", "length", "collisions"]
    return ROBOTS.format(episodes=body[0][-1]) + "\n" + markdown(head, [row[:-1] for row in body])


def whole_body() -> str:
    """The section on the whole-body controller; nothing where there are no results."""
    folder = RESULTS / "whole_body"
    if not (folder / "flat.json").exists():
        return ""
    found = {name: json.loads((folder / f"{name}.json").read_text()) for name in ("flat", "c", "blocks", "push")}
    flat = [_tracked(name, found[part]) for name, part in (("MJX", "flat"), ("C MuJoCo", "c"))]
    blocks, push = found["blocks"], found["push"]
    fell = f"{push['cases'] - push['fell']} of {push['cases']} stay up"
    body = [*flat, [PUSH.format(**push), str(push["cases"]), fell, ""]]
    for name, said in (("obstacles", ""), ("no_obstacles", ", its obstacles left out")):
        part = blocks[name]
        walked = f"{part['survived']:.0%} do not fall; {part['distance']:.1f} m"
        # counted over both
        body.append([BLOCKS.format(**blocks) + said, str(blocks["episodes"]), walked, f"{blocks['unsolved']} in both"])
    text = WALKS.format(seconds=found["flat"]["seconds"]) + "\n"
    return text + markdown(["where", "cases", "result", "unsolved"], body) + "\n" + _cost()


def _tracked(where: str, result: dict[str, Any]) -> list[str]:
    worst = f"worst {result['worst_speed']:.3f} m/s, {result['worst_yaw_rate']:.3f} rad/s"
    tracked = f"{result['within']} tracked; {worst}"
    return [f"flat ground, {where}", str(result["cases"]), tracked, str(result["unsolved"])]


def _cost() -> str:
    path = RESULTS / "whole_body" / "bench.json"
    if not path.exists():
        return ""
    result = json.loads(path.read_text())
    peers = ", ".join(f"{name} {peer['times_ours']:.1f} times as much" for name, peer in result["peers"].items())
    return COST.format(**(result | result["microseconds"] | {"command": "loco-mjx bench mpc", "peers": peers}))
