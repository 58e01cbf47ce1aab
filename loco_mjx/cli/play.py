"""`loco-mjx play`: shows a policy in a video, in a figure, or live in the browser."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from loco_mjx import policies
from loco_mjx.cli.options import Step
from loco_mjx.cli.parse import parse
from loco_mjx.cli.scene import choose_gl
from loco_mjx.controllers import SPEED_LIMIT, YAW_RATE_LIMIT
from loco_mjx.errors import UserError
from loco_mjx.ranges import SEED, Range
from loco_mjx.robots import DEFAULT

if TYPE_CHECKING:
    from loco_mjx.show.rollout import Agent

PROG = "loco-mjx play"
RATES = (25.0, 12.5, 5.0)  # frames per second; whole numbers of control steps at 25 Hz


@dataclass(frozen=True)
class Options:
    """Runs a policy by its mean in our own environment and shows it: --video, --figure or --web."""

    directory: tyro.conf.Positional[Path | None] = None
    """The run's directory, a policy's folder, or a shipped policy's name; none for --zero, --random, --controller."""
    video: Path | None = None
    """File for a video, .mp4 or .gif: the robot from behind, its depth image as an inset."""
    figure: Path | None = None
    """File for a strip of moments, .png or .svg: view, depth and, with --attention, attention."""
    web: bool = False
    """Open a live viewer for the browser, until Ctrl-C."""
    task: str | None = None
    """Task to run on; None: the one it was trained on, or thin."""
    robot: str | None = None
    """Robot of --zero, --random and --controller, by name or the path of its MJCF; None: a1."""
    step: Step = None
    """Which checkpoint of the run: the samples trained at it, or best by evaluation; None: the newest."""
    seed: SEED = 0
    """Of the scene; the first episode is the first of `loco-mjx evaluate` with this seed."""
    seconds: Annotated[float, Range(0, 600, above=True)] = 10.0
    """Simulated time to film."""
    attention: bool = False
    """Draw the last layer's attention of the state token over the depth image, as a multiple of uniform attention."""
    zero: bool = False
    """Hold the default pose instead of running a policy."""
    random: bool = False
    """Act at random instead of running a policy."""
    controller: Literal["mpc"] | None = None
    """Walk by the whole-body controller instead of running a policy (docs/whole_body.md)."""
    vx: Annotated[float, Range(-10, 10)] = 0.3
    """For --controller: speed ahead, m/s; clipped to ±0.4."""
    yaw: Annotated[float, Range(-10, 10)] = 0.0
    """For --controller: yaw rate, rad/s; clipped to ±0.3."""
    width: Annotated[int, Range(64, 1920)] = 640
    """Of the video, pixels; it is 16:9."""
    fps: Annotated[float, Range(5, 25)] = 25.0
    """Frames per second of the video: 25, 12.5 or 5; what comes nearest for a robot of another rate than 25 Hz."""
    columns: Annotated[int, Range(1, 20)] = 5
    """Moments in the figure."""
    overwrite: bool = False
    """Replace files that exist."""
    host: str = "127.0.0.1"
    """Address that the viewer listens on; 0.0.0.0 lets everyone in."""
    port: Annotated[int, Range(1, 65535)] = 8080
    """Port that the viewer listens on."""


def main(args: Sequence[str]) -> int:
    """Runs the command.

    Raises:
        UserError: before anything is computed or written, if something is wrong.
    """
    options = parse(Options, args, PROG, names=("tasks", "robots"))
    choose_gl()  # before anything imports MuJoCo
    from loco_mjx.run import machine

    machine.set_up()
    check(options)
    agent = _agent(options)
    if options.web:
        from loco_mjx.show import web

        web.serve(agent, agent.env_config(options.task).task, options.seed, options.host, options.port)
        return 0
    _film(options, agent)
    return 0


def check(options: Options) -> None:
    """Refuses what cannot be done.

    Raises:
        UserError: naming what is wrong and what is accepted.
    """
    from loco_mjx.scene.tasks import get_task
    from loco_mjx.show import video

    if options.video is None and options.figure is None and not options.web:
        raise UserError("nothing to show; accepted: --video FILE.mp4 or .gif, --figure FILE.png, or --web")
    if options.web and (options.video is not None or options.figure is not None):
        raise UserError("--web does not film; accepted: --web alone, or --video and --figure")
    if options.zero and options.random:
        raise UserError("--zero and --random are two agents; accepted: one of them")
    if options.directory is None and not (options.zero or options.random or options.controller):
        raise UserError("no policy to show; accepted: the directory of a run, --zero, --random or --controller mpc")
    if options.controller and (options.directory is not None or options.zero or options.random):
        raise UserError("--controller mpc walks without a policy; accepted: it alone, without one, --zero or --random")
    if options.controller and options.web:
        raise UserError("--web shows no --controller; accepted: --video and --figure")
    if options.robot is not None and options.directory is not None:
        raise UserError("--robot is for --zero, --random and --controller alone; a policy says itself whose it is")
    if options.fps not in RATES:
        raise UserError(f"fps is {options.fps}; accepted: {', '.join(map(str, RATES))}")
    if options.task is not None:
        get_task(options.task)
    for path, suffixes in ((options.video, video.VIDEOS), (options.figure, video.FIGURES)):
        if path is not None:
            video.check_output(path, suffixes, options.overwrite)


def _agent(options: Options) -> Agent:
    from loco_mjx.deploy import trained
    from loco_mjx.show.rollout import Agent, Kind

    policy = None
    if options.directory is not None:
        policy = trained.load(policies.find(options.directory), options.step)
    kind: Kind = options.controller or ("zero" if options.zero else "random" if options.random else "policy")
    if options.controller:
        say_limits(options)
    return Agent(kind, policy, options.robot or DEFAULT, (options.vx, options.yaw))


def pace(control_dt: float, fps: float) -> tuple[int, float]:
    """Control steps in a frame, and the frames per second that come of it: a film is of whole steps, in real time."""
    every = max(1, round(1 / (control_dt * fps)))
    return every, round(1 / (control_dt * every), 6)


def _film(options: Options, agent: Agent) -> None:
    from loco_mjx.show.record import record
    from loco_mjx.show.rollout import Rollout

    rollout = Rollout(agent, agent.env_config(options.task))
    every, fps = pace(rollout.env.dt, options.fps)
    done = record(
        rollout,
        options.seed,
        options.seconds,
        options.video,
        options.figure,
        options.attention,
        options.width,
        every,
        options.columns,
    )
    if options.video is not None and fps != options.fps:
        print(f"{fps:g} frames a second, for the robot has {1 / rollout.env.dt:g} control steps in one")
    for path in (options.video, options.figure):
        if path is not None:
            print(f"wrote {path} ({path.stat().st_size // 1024} KB)")
    for step, distance in done.ends:
        print(f"an episode ended after {step} steps, {distance:.2f} m; another scene followed")
    if rollout.unsolved is not None:
        print(f"programs not solved: {rollout.unsolved}")
    print(f"{agent.kind} on {rollout.config.task}: {done.distance:.2f} m in the episode shown last")


def say_limits(options: Options) -> None:
    """Says what of the command is beyond the whole-body controller's limits."""
    for name, value, limit in (("vx", options.vx, SPEED_LIMIT), ("yaw", options.yaw, YAW_RATE_LIMIT)):
        if abs(value) > limit:
            print(f"{name} {value:g} is clipped to {math.copysign(limit, value):g}")
