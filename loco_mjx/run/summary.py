"""The table a run starts with: what is observed, what is rewarded, how large everything is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rich.console import Console
from rich.table import Table

from loco_mjx import controllers
from loco_mjx.config import Config, to_dict
from loco_mjx.sensors import in_use


def print_summary(
    console: Console, config: Config, devices: dict[str, Any], parameters: int, seeds: Sequence[int]
) -> None:
    """Prints the active parts of a configuration.

    Args:
        console: to print to.
        config: the run's.
        devices: what :func:`loco_mjx.run.provenance.devices` returned.
        parameters: number of the networks' parameters.
        seeds: that train side by side.
    """
    env = config.env
    under = "" if env.controller == controllers.DEFAULT else f", controller {env.controller}"
    seed = f"seed{'s' * (len(seeds) > 1)} {', '.join(map(str, seeds))}"
    table = Table(title=f"{config.policy} on {env.task}, {env.robot}{under}, {seed}", title_justify="left")
    table.add_column("part")
    table.add_column("name")
    table.add_column("size or weight", justify="right")
    groups = (
        ("observation", observations(config)),
        ("reward", rewards(config)),
        ("training" if len(seeds) == 1 else "training, each", sizes(config, devices, parameters)),
    )
    for part, rows in groups:
        for i, (name, value) in enumerate(rows):
            table.add_row(part if i == 0 else "", name, value, end_section=i == len(rows) - 1)
    console.print(table)


def observations(config: Config) -> list[tuple[str, str]]:
    """Every active part of the observation and its shape."""
    obs = config.env.observation
    rows = [(f"state: {name}", f"{obs.state_frames} × {sensor.size}") for name, sensor in in_use(obs).items()]
    rows += [("state: goal", "3")] if obs.goal else []
    rows.append(("state", str(obs.state_size)))
    if obs.depth.enabled:
        rows.append(("pixels/depth", f"{obs.depth.height} × {obs.depth.width} × {obs.depth.frames}"))
    return rows


def rewards(config: Config) -> list[tuple[str, str]]:
    """Every reward term with a weight, and its weight."""
    weights = to_dict(config.env.reward)
    target = weights.pop("target_speed")
    rows = [(name, f"{weight:g}") for name, weight in weights.items() if weight]
    return rows + ([("cap on the forward speed", f"{target:g} m/s")] if target is not None else [])


def sizes(config: Config, devices: dict[str, Any], parameters: int) -> list[tuple[str, str]]:
    """Sizes of training."""
    ppo = config.ppo
    return [
        ("devices", f"{devices['count']} × {devices['kind']}"),
        ("environments × steps", f"{ppo.num_envs} × {ppo.unroll}"),
        ("minibatch, epochs", f"{ppo.minibatch}, {ppo.epochs}"),
        ("parameters", f"{parameters:,}"),
        ("randomisation", "on" if config.env.randomization.enabled else "off"),
        ("samples", f"{ppo.total_steps:,}"),
    ]
