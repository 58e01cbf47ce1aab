"""Options that several commands have, and how tyro makes them of the weights of registered terms."""

from __future__ import annotations

from typing import Annotated, Literal

import tyro
from tyro import constructors

from loco_mjx.config.reward_terms import Weights
from loco_mjx.ranges import Range

# A checkpoint of a run: the samples trained at it, or the best by evaluation; None: the newest.
Step = Annotated[int, Range(0, 2**31 - 1)] | Literal["best"] | None
REGISTRY = constructors.ConstructorRegistry()


@REGISTRY.struct_rule
def _weights(info: constructors.StructTypeInfo) -> constructors.StructConstructorSpec | None:
    if info.type is not Weights:
        return None
    kind = Annotated[float, tyro.conf.arg(help="of an imported module")]
    values = info.default if isinstance(info.default, Weights) else Weights()
    fields = tuple(constructors.StructFieldSpec(name=name, type=kind, default=value) for name, value in values.items())
    return constructors.StructConstructorSpec(instantiate=lambda **given: Weights(given), fields=fields)
