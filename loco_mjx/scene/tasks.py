"""The tasks by name. A new task is one function in layouts.py and one entry here."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import jax

from loco_mjx.errors import UnknownNameError
from loco_mjx.scene import layouts
from loco_mjx.scene.types import Scene


@dataclass(frozen=True)
class Task:
    """A kind of world and what "forward" means in it.

    Attributes:
        name: the task's name.
        generate: draws one scene from a key.
        summary: one line for users.
        toward_goal: forward is toward scene.goal, in three dimensions, instead of +x.
        moving: the obstacles move.
        obstacle_slots: boxes or cylinders that may touch a foot or a knee at the same time. Two, as a foot is between
            two blocks, or in the corner between a step and the next riser.
    """

    name: str
    generate: Callable[[jax.Array], Scene]
    summary: str
    toward_goal: bool = False
    moving: bool = False
    obstacle_slots: int = 2


_ALL = (
    Task("thin", layouts.thin, "pillars between two walls"),
    Task("wide", layouts.wide, "wide blocks between two walls"),
    Task("thin-sphere", layouts.thin_sphere, "thin, with spheres to collect"),
    Task("wide-sphere", layouts.wide_sphere, "wide, with spheres to collect"),
    Task("moving", layouts.moving, "thin, with moving pillars", moving=True),
    Task("mountain", layouts.mountain, "a rugged mountain with the goal on its summit", toward_goal=True),
    Task("heightfield", layouts.heightfield, "thin, on ground uneven by up to 5 cm"),
    Task("random-shape", layouts.random_shape, "thin, with pillars of many sizes"),
    Task("indoor", layouts.indoor, "a corridor with cartons and cabinets in the way"),
    Task("forest", layouts.forest, "trees on rough, sloped ground with potholes"),
    Task("hill", layouts.hill, "rolling hills with the goal on top", toward_goal=True),
    Task("stairs", layouts.stairs, "four steps up, a plateau, four steps down"),
)
TASKS: dict[str, Task] = {task.name: task for task in _ALL}


def get_task(name: str) -> Task:
    """The task of that name.

    Raises:
        UnknownNameError: if there is none.
    """
    if name not in TASKS:
        raise UnknownNameError("task", name, TASKS)
    return TASKS[name]
