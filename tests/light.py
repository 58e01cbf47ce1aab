"""Physics as small as it gets, for tests of what is around it."""

from loco_mjx.config import PhysicsConfig

LIGHT = PhysicsConfig(iterations=1, ls_iterations=1, more_iterations=0, near_boxes=1, near_cylinders=1)
