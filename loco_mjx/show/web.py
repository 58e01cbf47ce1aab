"""A live viewer in the browser: the server's threads ask, one loop simulates and has it drawn."""

from __future__ import annotations

import queue
import socket
import time
import traceback
from collections.abc import Callable
from typing import cast

from loco_mjx.errors import UserError
from loco_mjx.scene.tasks import TASKS
from loco_mjx.show.rollout import Agent, Kind, Moment, Rollout
from loco_mjx.show.web_scene import WebScene

IDLE = 0.05  # s between looks at what was asked while nothing moves
# m, from where the robot is followed: behind and above it, for walls are at its sides. And where the camera looks.
CAMERA, TARGET = (-2.4, 0.4, 1.3), (0.6, 0.0, 0.2)


def serve(agent: Agent, task: str, seed: int, host: str, port: int) -> None:
    """Runs the viewer until Ctrl-C.

    Raises:
        UserError: if viser is missing, the port is taken, or the seed out of range.
    """
    viewer = Viewer(agent, task, seed, host, port)
    print(f"open http://{host}:{port} in a browser; Ctrl-C stops")
    try:
        viewer.run()
    except KeyboardInterrupt:
        print("stopped")
    finally:
        viewer.close()


class Viewer:
    """The page, and the episode it shows. GUI callbacks only queue what is asked; `run` does it.

    Attributes:
        rollout: None until it is compiled.
        moment: the one that is shown, once there is a rollout.
        scene: how it is shown.
    """

    def __init__(self, agent: Agent, task: str, seed: int, host: str = "127.0.0.1", port: int = 8080) -> None:
        """Opens the page; nothing is compiled before :meth:`run`.

        Raises:
            UserError: if viser is missing or the port is taken.
        """
        try:
            import viser
        except ImportError:
            raise UserError("--web needs viser; install it with `pip install 'loco-mjx[play]'`") from None
        _check_port(host, port)
        self.agents: dict[str, Agent] = {agent.kind: agent}
        self._policy, self._robot = agent.given, agent.robot
        self.kind: Kind = agent.kind
        self.task, self.seed = task, seed
        self.paused, self.error, self.steps = False, "", 0
        self.follow, self.overlay = True, agent.attends
        self.rollout: Rollout | None = None
        self._asked: queue.Queue[Callable[[], None]] = queue.Queue()
        self._stopped = False
        self.moment: Moment
        self._server = viser.ViserServer(host=host, port=port, label="loco-mjx", verbose=False)
        self._server.initial_camera.position, self._server.initial_camera.look_at = CAMERA, TARGET
        self._build_gui()

    # What the page asks for -----------------------------------------------------------------------------------------

    def ask(self, request: Callable[[], None]) -> None:
        """Has the loop do something between two steps."""
        self._asked.put(request)

    def _build_gui(self) -> None:
        gui = self._server.gui
        self._status = gui.add_markdown("starting")
        self._pause = gui.add_button("Pause")
        self._single = gui.add_button("Step")
        self._again = gui.add_button("Reset")
        self._task = gui.add_dropdown("Task", tuple(TASKS), initial_value=self.task)
        self._seed = gui.add_number("Seed", self.seed, min=0, max=2**31 - 1, step=1)
        kinds = ("policy", "zero", "random") if self._policy is not None else ("zero", "random")
        self._kind = gui.add_dropdown("Agent", kinds, initial_value=self.kind)
        self._following = gui.add_checkbox("Follow the robot", self.follow)
        self._attending = gui.add_checkbox("Attention", self.overlay, disabled=not self.overlay)
        self.scene = WebScene(self._server)
        self._pause.on_click(lambda _: self.ask(self.toggle))
        self._single.on_click(lambda _: self.ask(self.single))
        self._again.on_click(lambda _: self.ask(self.reset))
        self._task.on_update(lambda _: self.ask(lambda: self.choose(task=self._task.value)))
        self._seed.on_update(lambda _: self.ask(lambda: self.choose(seed=int(self._seed.value))))
        self._kind.on_update(lambda _: self.ask(lambda: self.choose(kind=cast(Kind, self._kind.value))))
        self._following.on_update(lambda _: setattr(self, "follow", self._following.value))
        self._attending.on_update(lambda _: self.ask(lambda: self.attend(self._attending.value)))

    def toggle(self) -> None:
        """Pauses, or goes on."""
        self.paused, self.error = not self.paused, ""
        self._start_clock()

    def single(self) -> None:
        """Pauses, and makes one step."""
        self.paused, self.error = True, ""
        self._advance()

    def reset(self) -> None:
        """Starts the seed's first episode again."""
        self.error = ""
        if self.rollout is None:
            self._prepare()
        self.show(self.rollout.reset(self.seed))  # type: ignore[union-attr]
        self.steps = 0
        self._start_clock()

    def choose(self, task: str | None = None, seed: int | None = None, kind: Kind | None = None) -> None:
        """Another task, seed or agent, from its first episode on."""
        self.task, self.seed, self.kind = task or self.task, self.seed if seed is None else seed, kind or self.kind
        if task is not None or kind is not None:
            self._prepare()
        self.reset()

    def attend(self, overlay: bool) -> None:
        """Shows attention beside the depth image, or not."""
        self.overlay = overlay
        if self.rollout is not None:
            self.draw(self.moment)

    # The loop -------------------------------------------------------------------------------------------------------

    def run(self) -> None:
        """Simulates at real time and does what is asked, until :meth:`stop`; an error is shown and pauses."""
        self.ask(self.reset)
        while not self._stopped:
            self._try(self._turn)

    def stop(self) -> None:
        """Has :meth:`run` return."""
        self._stopped = True

    def close(self) -> None:
        """Closes the page's server."""
        self.stop()
        self._server.stop()

    def _turn(self) -> None:
        moving = not self.paused and self.rollout is not None
        wait = max(self._due - time.perf_counter(), 0.0) if moving else IDLE
        try:
            request = self._asked.get(timeout=wait) if wait > 0 else self._asked.get_nowait()
        except queue.Empty:
            if moving:
                self._advance()
                self._due += self.rollout.env.dt  # type: ignore[union-attr]
        else:
            request()
        self._report()

    def _try(self, action: Callable[[], None]) -> None:
        try:
            action()
        except Exception as error:  # shown on the page, where the user is
            if not isinstance(error, UserError):
                traceback.print_exc()
            self.paused, self.error = True, f"{type(error).__name__}: {error}"
            self._report()

    def _start_clock(self) -> None:
        self._due = time.perf_counter()

    def _report(self) -> None:
        """Tells the page how things stand; sends nothing where nothing has changed."""
        if self.error:
            text = f"**Error**, paused: {self.error}"
        elif self.rollout is None:
            text = "starting"
        else:
            late = time.perf_counter() - self._due
            pace = "paused" if self.paused else "real time" if late < 0.2 else f"{late:.1f} s behind real time"
            moment, now = self.moment, self.moment.step * self.rollout.env.dt
            text = f"episode {moment.episode}, {now:.1f} s, {moment.distance:.1f} m; {pace}"
        if self._status.content != text:
            self._status.content = text
        label = "Resume" if self.paused else "Pause"
        if self._pause.label != label:
            self._pause.label = label

    def _prepare(self) -> None:
        """Agent and environment as chosen; compiles where the task is new, and says so on the page."""
        agent = self.agents.get(self.kind) or Agent(self.kind, self._policy, self._robot)
        self.agents[self.kind] = agent
        config = agent.env_config(self.task)
        if self.rollout is not None and self.rollout.config == config:
            self.rollout = self.rollout.with_agent(agent)
            return
        self._status.content = f"compiling {self.task}: up to a minute"
        rollout = Rollout(agent, config)
        rollout.reset(self.seed)
        rollout.step()  # compiles
        self.rollout = rollout

    def _advance(self) -> None:
        if self.rollout is None:
            raise UserError("there is no episode to step; choose another task, or reset")
        before, moment = self.moment, self.rollout.step()
        self.steps += 1
        if moment.episode != before.episode:
            self.show(moment)
        else:
            self.draw(moment)

    def show(self, moment: Moment) -> None:
        """Shows an episode's first moment, in a scene of its own."""
        self.scene.build(moment, self.rollout.env.robot)  # type: ignore[union-attr]
        self.draw(moment)

    def draw(self, moment: Moment) -> None:
        """Shows a moment of the same episode."""
        self.moment = moment
        self.scene.draw(moment, self.follow)
        self.scene.draw_eye(moment, self.rollout.config.observation.depth, self.overlay)  # type: ignore[union-attr]


def _check_port(host: str, port: int) -> None:
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            raise UserError(f"cannot listen on {host}:{port}: {error.strerror}; choose another --port") from None
