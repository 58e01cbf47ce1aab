"""The kinds of numbers that stand in the configuration, each with its range."""

from __future__ import annotations

from typing import Annotated

from loco_mjx.ranges import Range

Share = Annotated[float, Range(0, 1)]
Weight = Annotated[float, Range(-10_000, 10_000)]  # of a term of the reward or the loss
Factor = Annotated[float, Range(0, 10)]
Mass = Annotated[float, Range(0.01, 10)]  # factor; without mass there is no motion to compute
Kp = Annotated[float, Range(0, 500, above=True)]  # N·m/rad
Kd = Annotated[float, Range(0, 50)]  # N·m·s/rad
Degrees = Annotated[float, Range(0, 180, above=True, below=True)]
Angle = Annotated[float, Range(0, 3.1416)]  # rad
Latency = Annotated[float, Range(0, 0.04)]  # s; histories hold one control step
Metres = Annotated[float, Range(0, 1000, above=True)]
Deviation = Annotated[float, Range(0, 10, above=True)]
LearningRate = Annotated[float, Range(0, 1, above=True)]
Blind = Annotated[int, Range(0, 1024 * 1024)]  # pixels
Pixels = Annotated[int, Range(1, 1024)]
Frames = Annotated[int, Range(1, 64)]
Width = Annotated[int, Range(1, 16_384)]  # of a layer
Passes = Annotated[int, Range(1, 1000)]
NumEnvs = Annotated[int, Range(1, 2**20)]
TotalSteps = Annotated[int, Range(1, 2_000_000_000)]
Samples = Annotated[int, Range(1, 2**26)]  # of a minibatch
