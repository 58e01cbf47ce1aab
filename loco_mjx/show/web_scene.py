"""What the browser shows of an episode: the world in three dimensions, the depth image, and attention over it."""

from __future__ import annotations

from typing import Any

import numpy as np

from loco_mjx.config import DepthConfig
from loco_mjx.robots import Robot
from loco_mjx.show import drawing, meshes
from loco_mjx.show.rollout import Moment
from loco_mjx.show.stage import HIDDEN_GROUP, Stage

EYE = (200, 320)  # rows and columns of the depth image
WORLD = "/world"


class WebScene:
    """The nodes of a page's scene, and its two images.

    Attributes:
        eye: the image of depth.
        looked: the image of attention over depth; hidden where there is none.
        world: the node that everything hangs from.
        floor: the node of the floor, which goes along with the robot.
    """

    def __init__(self, server: Any) -> None:
        """Adds the images to the page of a viser server; the scene stays empty until :meth:`build`."""
        self._server = server
        gui = server.gui
        self.eye = gui.add_image(np.zeros((*EYE, 3), np.uint8), label="Depth", format="png")
        self.looked = gui.add_image(np.zeros((*EYE, 3), np.uint8), label="Attention over depth", format="png")
        self.looked.visible = False
        self.world: Any = None
        self.floor: Any = None
        self._nodes: dict[int, Any] = {}  # by body
        self._spheres: dict[int, Any] = {}  # by geom

    def build(self, moment: Moment, robot: Robot) -> None:
        """A new scene: removes what was there, and adds every piece of the new one."""
        self._stage = Stage(moment, robot)
        scene = self._server.scene
        with self._server.atomic():
            scene.reset()
            self.world = scene.add_frame(WORLD, show_axes=False)
            self._nodes, self._spheres = {}, {}
            self.floor = scene.add_frame(f"{WORLD}/floor", show_axes=False)
            for name, mesh, paint in meshes.floor() if meshes.has_floor(self._stage.model) else ():
                scene.add_mesh_simple(
                    f"{WORLD}/floor/{name}", mesh.vertices, mesh.faces, color=paint, cast_shadow=False
                )
            for body, pieces in meshes.by_body(self._stage.model, set(self._stage.spheres.values())).items():
                self._nodes[body] = scene.add_frame(f"{WORLD}/body{body}", show_axes=False)
                for name, mesh, paint in pieces:
                    node = scene.add_mesh_simple(
                        f"{WORLD}/body{body}/{name}", mesh.vertices, mesh.faces, color=paint, flat_shading=True
                    )
                    if name.startswith("geom"):
                        self._spheres[int(name.removeprefix("geom"))] = node

    def draw(self, moment: Moment, follow: bool) -> None:
        """Moves what has moved; the world instead of the camera, which stays the user's to turn, to `follow`."""
        self._stage.pose(moment)
        data = self._stage.data
        with self._server.atomic():
            for body, node in self._nodes.items():
                if body:  # 0 is what never moves
                    node.position, node.wxyz = data.xpos[body], data.xquat[body]
            for geom, node in self._spheres.items():
                node.visible = bool(self._stage.model.geom_group[geom] != HIDDEN_GROUP)
            self.floor.position = meshes.floor_place(moment.qpos[:3])
            if follow:
                self.world.position = -moment.qpos[:3] * np.array([1.0, 1.0, 0.0])

    def draw_eye(self, moment: Moment, depth: DepthConfig, overlay: bool) -> None:
        """The depth image, and beside it the attention where it is asked for, with its scale."""
        seen = moment.depth is not None
        looked = seen and overlay and moment.attention is not None
        for panel, shown in ((self.eye, seen), (self.looked, looked)):
            if panel.visible != shown:
                panel.visible = shown
        if moment.depth is not None:
            self.eye.image = drawing.enlarge(drawing.depth_picture(moment.depth, depth), *EYE)
            if looked and moment.attention is not None:
                over = drawing.enlarge(drawing.overlay(moment.depth, moment.attention, depth), *EYE)
                self.looked.image = np.concatenate([over, drawing.scale(EYE[1])])
