"""`loco-mjx deploy`: runs an exported policy on a robot."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from loco_mjx import policies
from loco_mjx.cli import words
from loco_mjx.cli.parse import parse
from loco_mjx.deploy import folder
from loco_mjx.deploy.a1_robot import A1Robot
from loco_mjx.deploy.folder import Manifest
from loco_mjx.deploy.guided import Guided
from loco_mjx.deploy.mujoco_robot import Imperfections, MujocoRobot
from loco_mjx.deploy.observer import check_readable
from loco_mjx.deploy.record import Record
from loco_mjx.deploy.runner import Runner
from loco_mjx.deploy.safety import Limits
from loco_mjx.deploy.session import Session
from loco_mjx.deploy.walker import Walker, manifest_of
from loco_mjx.errors import UserError
from loco_mjx.ranges import SEED, Range
from loco_mjx.robots import DEFAULT, get_robot

PROG = "loco-mjx deploy"
STOPPED = 1  # exit code of a run that ended before its time
PATIENCE = 1.0  # s a simulated robot's tick may take on a busy machine
COMMANDED = ("--vx", "--yaw", "--body")  # options that only a walk without a policy looks at


@dataclass(frozen=True)
class Options:
    """Runs an exported policy: stands up, runs, sits down. Ctrl-C, SIGTERM or Enter stop it."""

    policy: tyro.conf.Positional[Path | None] = None
    """Folder that `loco-mjx export` wrote, or the name of a shipped policy; without one --controller mpc walks."""
    controller: Literal["pd", "mpc"] | None = None
    """With a policy: whose it has to be. Without: mpc walks as --vx and --yaw say (docs/whole_body.md)."""
    vx: Annotated[float, Range(-10, 10)] = 0.3
    """Without a policy: speed ahead, m/s; clipped to ±0.4."""
    yaw: Annotated[float, Range(-10, 10)] = 0.0
    """Without a policy: yaw rate, rad/s; clipped to ±0.3."""
    body: str = DEFAULT
    """Without a policy, in C MuJoCo: which robot, by name or the path of its MJCF."""
    robot: Literal["mujoco", "a1"] = "mujoco"
    """The policy's own robot in C MuJoCo, or a real A1 (docs/deployment.md)."""
    task: str = "thin"
    """Task whose scene it runs in; generating one needs JAX."""
    scene: Path | None = None
    """MJCF of a scene instead, as `loco-mjx scene --out` writes it; needs no JAX."""
    seed: SEED = 0
    """Which of the task's scenes, and the sensors' noise."""
    seconds: Annotated[float, Range(0, 3600, above=True)] = 20.0
    """To run the policy for."""
    log: Path | None = None
    """File for everything measured and commanded, .npz."""
    imperfections: Imperfections = field(default_factory=Imperfections)
    limits: Limits = field(default_factory=Limits)


def main(args: Sequence[str]) -> int:
    """Runs the command.

    Raises:
        UserError: before the robot is commanded, if anything is wrong.
    """
    options = parse(Options, args, PROG)
    if options.log is not None and (options.log.is_dir() or not options.log.parent.is_dir()):
        raise UserError(f"'{options.log}' cannot be written; accepted: a file in a directory that exists")
    if options.policy is None and options.controller == "mpc":
        return walk(options)
    if options.policy is None:
        raise UserError("no policy to run; accepted: a folder that `loco-mjx export` wrote, or --controller mpc")
    for name, _ in words.given(args):
        if name in COMMANDED:
            raise UserError(f"{name} is for --controller mpc without a policy; accepted: the one or the other")
    where = policies.find(options.policy)
    manifest = folder.read(where)
    if options.controller not in (None, manifest.controller.name):
        raise UserError(
            f"{options.policy} is a policy for controller '{manifest.controller.name}'; accepted: that one, or none; "
            "--controller mpc alone walks without a policy"
        )
    session = Session(manifest, where)
    robot: MujocoRobot | A1Robot
    if options.robot == "a1":
        if manifest.robot != A1Robot.name:
            raise UserError(f"the policy is {manifest.robot}'s; --robot a1 accepts those of {A1Robot.name} only")
        check_readable(manifest, position_known=False)
        robot, clock, patience = A1Robot(manifest.camera), time.perf_counter, 0.0
    else:
        # Simulated time stands still while the policy thinks: its own processor time counts, not who else uses it.
        robot, clock, patience = simulated(options, manifest), time.thread_time, PATIENCE
    how: dict[str, Any] = {"limits": options.limits, "clock": clock, "say": say, "patience": patience}
    runner: Runner
    try:
        if manifest.controller.name == Runner.for_controller:
            runner = Runner(manifest, session, robot, **how)
        else:
            how["waits"] = options.robot != "a1"
            runner = Guided(manifest, session, get_robot(manifest.body), robot, **how)
        record = runner.run(options.seconds)
    finally:
        robot.close()  # before anything is written, which may take a while
    return ended(options, record, runner)


def walk(options: Options) -> int:
    """Runs the whole-body controller.

    Raises:
        UserError: before the robot is commanded, if anything is wrong.
    """
    about = get_robot(options.body)
    robot: MujocoRobot | A1Robot
    if options.robot == "a1":
        if about.name != A1Robot.name:
            raise UserError(f"--robot a1 walks as {A1Robot.name}; accepted: --body {A1Robot.name}, or none")
        robot, clock, patience = A1Robot(None), time.perf_counter, 0.0
    else:
        robot, clock, patience = simulated(options, manifest_of(about), about.policy_hz), time.thread_time, PATIENCE
    try:
        command = (options.vx, options.yaw)
        walker = Walker(about, lambda _: command, robot, options.limits, clock=clock, say=say, patience=patience)
        record = walker.run(options.seconds)
    finally:
        robot.close()
    return ended(options, record, walker)


def ended(options: Options, record: Record, runner: Runner) -> int:
    """Keeps the record and prints how it went; the exit code."""
    if options.log is not None:
        record.save(options.log)
    with contextlib.suppress(OSError, ValueError):  # a terminal that is gone
        if isinstance(runner, Walker):
            print(f"programs not solved: {runner.unsolved}")
        report(record)
    return STOPPED if record.cause is not None else 0


def simulated(options: Options, manifest: Manifest, rate: int | None = None) -> MujocoRobot:
    """The policy's robot in C MuJoCo, in the scene that was asked for; what moves there does `rate` times a second."""
    scene, rate = options.scene, rate or manifest.policy_hz
    model, between = generated(options.task, options.seed, manifest.body, rate) if scene is None else from_file(scene)
    rates: dict[str, Any] = {"between": between, "policy_hz": rate}
    return MujocoRobot(model, manifest.camera, options.imperfections, options.seed, **rates)


def from_file(path: Path) -> tuple[Any, None]:
    """A scene's compiled model.

    Raises:
        UserError: if the file is missing or no MJCF.
    """
    if not path.is_file():
        raise UserError(f"there is no scene '{path}'; `loco-mjx scene --out {path}` writes one")
    try:
        import mujoco
    except ModuleNotFoundError as error:
        raise UserError("--robot mujoco needs mujoco: pip install mujoco") from error
    try:
        return mujoco.MjModel.from_xml_path(str(path)), None
    except ValueError as error:
        raise UserError(f"'{path}' is no MJCF: {error}") from error


def generated(
    task: str, seed: int, robot: str = DEFAULT, rate: int | None = None
) -> tuple[Any, Callable[[Any, Any], None] | None]:
    """A task's scene with a robot in it, and what moves its obstacles if they move, `rate` times a second.

    Raises:
        UnknownNameError: if there is no task, or no robot, of that name.
    """
    try:
        from loco_mjx.scene.tasks import get_task
    except ModuleNotFoundError as error:
        raise UserError(
            f"generating a scene needs {error.name}: pip install 'loco-mjx[train]', or give --scene FILE.xml"
        ) from error
    chosen = get_task(task)
    from loco_mjx.run import machine

    machine.set_up()
    import jax

    from loco_mjx.scene.mjcf import scene_spec

    scene_key, motion_key = jax.random.split(jax.random.PRNGKey(seed))
    scene = jax.jit(chosen.generate)(scene_key)
    body = get_robot(robot)
    moves = mover(scene, motion_key, 1 / (rate or body.policy_hz)) if chosen.moving else None
    return scene_spec(scene, body).compile(), moves


def mover(scene: Any, key: Any, control_dt: float) -> Callable[[Any, Any], None]:
    """Moves a scene's obstacles as in training, one control step per call."""
    import jax

    from loco_mjx.scene import mjcf, motion

    @jax.jit
    def moved(scene: Any, step: Any) -> Any:
        return motion.move(motion.redraw(jax.random.fold_in(key, step), scene, step), control_dt)

    step = 0

    def between(model: Any, data: Any) -> None:
        nonlocal scene, step
        scene, step = moved(scene, step), step + 1
        mjcf.place_boxes(model, data, scene)

    return between


def say(when: float, text: str) -> None:
    """Prints an event as it happens."""
    print(f"{when:7.2f} s  {text}", flush=True)


def report(record: Record) -> None:
    """Prints how it went."""
    latency = ", ".join(f"{name} {value:.1f}" for name, value in record.latencies().items())
    print(f"{len(record.rows)} ticks; latency in ms: {latency}; deadlines missed: {record.misses}")
    if record.distance is not None:
        print(f"distance from start to end: {record.distance:.2f} m")
