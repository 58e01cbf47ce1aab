"""A live viewer in the browser: the server's threads ask, one loop simulates and draws."""

from __future__ import annotations

import queue
import socket
import time
import traceback
from collections.abc import Callable
from typing import Any, cast

import numpy as np

from loco_mjx.errors import UserError
from loco_mjx.scene.tasks import TASKS
from loco_mjx.show import drawing, meshes
from loco_mjx.show.rollout import Agent, Kind, Rollout
from loco_mjx.show.stage import HIDDEN_GROUP, Stage

IDLE = 0.05  # s between looks at what was asked while nothing moves
EYE = (200, 320)  # rows and columns of the depth image
WORLD = "/world"
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
    """The page, and the episode it shows. GUI callbacks only queue what is asked; `run` does it."""

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
        self._policy = agent.policy
        self.kind: Kind = agent.kind
        self.task, self.seed = task, seed
        self.paused, self.error, self.steps = False, "", 0
        self.follow, self.overlay = True, agent.attends
        self.rollout: Rollout | None = None
        self._asked: queue.Queue[Callable[[], None]] = queue.Queue()
        self._stopped = False
        self._nodes: dict[int, Any] = {}
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
        self._eye = gui.add_image(np.zeros((*EYE, 3), np.uint8), label="Depth", format="png")
        self._looked = gui.add_image(np.zeros((*EYE, 3), np.uint8), label="Attention over depth", format="png")
        self._looked.visible = False
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
        self._show(self.rollout.reset(self.seed))  # type: ignore[union-attr]
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
            self._draw(self._moment)

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
            moment, now = self._moment, self._moment.step * self.rollout.env.dt
            text = f"episode {moment.episode}, {now:.1f} s, {moment.distance:.1f} m; {pace}"
        if self._status.content != text:
            self._status.content = text
        label = "Resume" if self.paused else "Pause"
        if self._pause.label != label:
            self._pause.label = label

    def _prepare(self) -> None:
        """Agent and environment as chosen; compiles where the task is new, and says so on the page."""
        agent = self.agents.get(self.kind) or Agent(self.kind, self._policy)
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
        before = self._moment
        moment = self.rollout.step()
        self.steps += 1
        if moment.episode != before.episode:
            self._show(moment)
        else:
            self._draw(moment)

    # Drawing --------------------------------------------------------------------------------------------------------

    def _show(self, moment: Any) -> None:
        """A new scene: removes what was there, and adds every piece of the new one."""
        self.stage = Stage(moment, self.rollout.env.robot)  # type: ignore[union-attr]
        scene = self._server.scene
        with self._server.atomic():
            scene.reset()
            self._world = scene.add_frame(WORLD, show_axes=False)
            self._nodes, self._spheres = {}, {}
            self._floor = scene.add_frame(f"{WORLD}/floor", show_axes=False)
            for name, mesh, paint in meshes.floor() if meshes.has_floor(self.stage.model) else ():
                scene.add_mesh_simple(
                    f"{WORLD}/floor/{name}", mesh.vertices, mesh.faces, color=paint, cast_shadow=False
                )
            for body, pieces in meshes.by_body(self.stage.model, set(self.stage.spheres.values())).items():
                self._nodes[body] = scene.add_frame(f"{WORLD}/body{body}", show_axes=False)
                for name, mesh, paint in pieces:
                    node = scene.add_mesh_simple(
                        f"{WORLD}/body{body}/{name}", mesh.vertices, mesh.faces, color=paint, flat_shading=True
                    )
                    if name.startswith("geom"):
                        self._spheres[int(name.removeprefix("geom"))] = node
        self._draw(moment)

    def _draw(self, moment: Any) -> None:
        """Moves what has moved."""
        self._moment = moment
        self.stage.pose(moment)
        data = self.stage.data
        with self._server.atomic():
            for body, node in self._nodes.items():
                if body:  # 0 is what never moves
                    node.position, node.wxyz = data.xpos[body], data.xquat[body]
            for geom, node in self._spheres.items():
                node.visible = bool(self.stage.model.geom_group[geom] != HIDDEN_GROUP)
            self._floor.position = meshes.floor_place(moment.qpos[:3])
            if self.follow:  # the world is moved instead of the camera, which stays the user's to turn
                self._world.position = -moment.qpos[:3] * np.array([1.0, 1.0, 0.0])
        self._draw_eye(moment)

    def _draw_eye(self, moment: Any) -> None:
        """The depth image, and beside it the attention where it is asked for, with its scale."""
        seen = moment.depth is not None
        looked = seen and self.overlay and moment.attention is not None
        for panel, shown in ((self._eye, seen), (self._looked, looked)):
            if panel.visible != shown:
                panel.visible = shown
        depth = self.rollout.config.observation.depth  # type: ignore[union-attr]
        if seen:
            self._eye.image = drawing.enlarge(drawing.depth_picture(moment.depth, depth), *EYE)
        if looked:
            over = drawing.enlarge(drawing.overlay(moment.depth, moment.attention, depth), *EYE)
            self._looked.image = np.concatenate([over, drawing.scale(EYE[1])])


def _check_port(host: str, port: int) -> None:
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            raise UserError(f"cannot listen on {host}:{port}: {error.strerror}; choose another --port") from None
