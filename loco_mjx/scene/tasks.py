"""The tasks by name. A new task is one function under :func:`register_task`, here or in a module of the user's."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar, overload

import jax

from loco_mjx.registry import Registry, caller
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


Generate = TypeVar("Generate", bound=Callable[[jax.Array], Scene])
TASKS: Registry[Task] = Registry("task")


@overload
def register_task(
    name: str, *, summary: str = "", toward_goal: bool = False, moving: bool = False, obstacle_slots: int = 2
) -> Callable[[Generate], Generate]: ...


@overload
def register_task(
    name: str,
    generate: Generate,
    *,
    summary: str = "",
    toward_goal: bool = False,
    moving: bool = False,
    obstacle_slots: int = 2,
) -> Generate: ...


def register_task(
    name: str,
    generate: Any = None,
    *,
    summary: str = "",
    toward_goal: bool = False,
    moving: bool = False,
    obstacle_slots: int = 2,
) -> Any:
    """Adds a task: as a decorator of the function that draws its scenes, or called with it.

    ``@register_task("plaza", summary="an empty square")`` above ``def plaza(key): return Scene(...)``. The function is
    compiled and vmapped: the numbers of obstacles may not depend on the key, where they stand may.

    Args:
        name: of letters, digits, `.`, `_` and `-`.
        generate: draws one scene from a key.
        summary: one line for users.
        toward_goal: see :class:`Task`, as for the others.
        moving: whether obstacles move.
        obstacle_slots: boxes or cylinders that may touch a foot or a knee at the same time.

    Raises:
        UserError: if the name is taken or no name.
    """
    origin = caller()

    def register(generate: Any) -> Any:
        TASKS.register(name, Task(name, generate, summary, toward_goal, moving, obstacle_slots), origin)
        return generate

    return register if generate is None else register(generate)


register_task("thin", layouts.thin, summary="pillars between two walls")
register_task("wide", layouts.wide, summary="wide blocks between two walls")
register_task("thin-sphere", layouts.thin_sphere, summary="thin, with spheres to collect")
register_task("wide-sphere", layouts.wide_sphere, summary="wide, with spheres to collect")
register_task("moving", layouts.moving, summary="thin, with moving pillars", moving=True)
register_task("mountain", layouts.mountain, summary="a rugged mountain with the goal on its summit", toward_goal=True)
register_task("heightfield", layouts.heightfield, summary="thin, on ground uneven by up to 5 cm")
register_task("random-shape", layouts.random_shape, summary="thin, with pillars of many sizes")
register_task("indoor", layouts.indoor, summary="a corridor with cartons and cabinets in the way")
register_task("forest", layouts.forest, summary="trees on rough, sloped ground with potholes")
register_task("hill", layouts.hill, summary="rolling hills with the goal on top", toward_goal=True)
register_task("stairs", layouts.stairs, summary="four steps up, a plateau, four steps down")


def get_task(name: str) -> Task:
    """The task of that name.

    Raises:
        UnknownNameError: if there is none.
    """
    return TASKS.find(name)
