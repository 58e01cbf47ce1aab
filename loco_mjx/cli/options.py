"""How tyro makes options of the configuration's weights of registered terms: `--env.reward.NAME`, beside the others."""

from __future__ import annotations

from typing import Annotated

import tyro
from tyro import constructors

from loco_mjx.config.reward_terms import Weights

REGISTRY = constructors.ConstructorRegistry()


@REGISTRY.struct_rule
def _weights(info: constructors.StructTypeInfo) -> constructors.StructConstructorSpec | None:
    if info.type is not Weights:
        return None
    kind = Annotated[float, tyro.conf.arg(help="of an imported module")]
    values = info.default if isinstance(info.default, Weights) else Weights()
    fields = tuple(constructors.StructFieldSpec(name=name, type=kind, default=value) for name, value in values.items())
    return constructors.StructConstructorSpec(instantiate=lambda **given: Weights(given), fields=fields)
