"""A quadruped as data. All that this package knows of a robot beside its masses and inertias, which MuJoCo reads.

Topology is the same for all: a free trunk and four legs FR, FL, RR, RL, each with a hip (about x), a thigh and a calf
(both about y). Units are SI, angles in radians; front is +x, left is +y.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

LEGS: tuple[str, ...] = ("FR", "FL", "RR", "RL")
PARTS: tuple[str, ...] = ("hip", "thigh", "calf")
NJOINT = len(LEGS) * len(PARTS)
NQ, NV = 7 + NJOINT, 6 + NJOINT  # sizes of qpos and qvel, as MuJoCo calls them: a free base, then the joints
LEG_SPHERES: tuple[str, ...] = ("foot", "hip", "knee", "calf")  # of each leg, in the order of Robot.spheres

Vector3 = tuple[float, float, float]


def joint_names() -> tuple[str, ...]:
    """Names of the joints in the order of every vector over joints."""
    return tuple(f"{leg}_{part}_joint" for leg in LEGS for part in PARTS)


@dataclass(frozen=True)
class Sphere:
    """A collision sphere on the trunk: its geom's name, centre in the trunk's frame and radius, m."""

    name: str
    center: Vector3
    radius: float


@dataclass(frozen=True)
class Robot:
    """What the code knows of a robot; hashable, so that compiled programs are found again.

    Vectors over joints have the order of :func:`joint_names`, those over legs that of LEGS.

    Attributes:
        name: of its MJCF's model.
        path: of its MJCF.
        default_pose: (12,) rad, of the keyframe ``stand``: what actions are relative to.
        stand_height: m, of the trunk's origin above flat ground in that pose.
        lower: (12,) joint limits, rad.
        upper: (12,) joint limits, rad.
        torque_limit: (12,) N·m.
        damping: (12,) of the joints themselves, N·m·s/rad.
        kp: N·m/rad, the controllers' nominal gain.
        kd: N·m·s/rad.
        action_scale: rad, of hip, thigh and calf, that an action of 1 adds to the default pose.
        policy_hz: control steps per second.
        physics_dt: s, the MJCF's timestep: of physics and of the controllers.
        hips: (4,) each leg's hip joint in the trunk's frame, m.
        thigh_offset: (4,) from hip joint to thigh joint along y, m.
        thigh_length: from thigh joint to knee, straight down, m.
        foot: x and z of the foot's centre in the calf's frame, m.
        leg_radii: m, of the spheres of foot, hip, knee and calf.
        trunk_spheres: collision spheres of the trunk.
        camera: the depth camera in the trunk's frame, m; it looks along x.
        imu: the IMU in the trunk's frame, m.
    """

    name: str
    path: Path
    default_pose: tuple[float, ...]
    stand_height: float
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    torque_limit: tuple[float, ...]
    damping: tuple[float, ...]
    kp: float
    kd: float
    action_scale: Vector3
    policy_hz: int
    physics_dt: float
    hips: tuple[Vector3, ...]
    thigh_offset: tuple[float, ...]
    thigh_length: float
    foot: tuple[float, float]
    leg_radii: tuple[float, float, float, float]
    trunk_spheres: tuple[Sphere, ...]
    camera: Vector3
    imu: Vector3

    @property
    def control_dt(self) -> float:
        """Duration of a control step, s."""
        return 1 / self.policy_hz

    @property
    def substeps(self) -> int:
        """Physics steps in a control step."""
        return round(1 / (self.policy_hz * self.physics_dt))

    @property
    def spheres(self) -> tuple[str, ...]:
        """Names of all collision spheres: feet, hips, knees, calves (each FR, FL, RR, RL), then the trunk's."""
        legs = tuple(f"{leg}_{part}_sphere" for part in LEG_SPHERES for leg in LEGS)
        return (*legs, *(sphere.name for sphere in self.trunk_spheres))

    @property
    def radii(self) -> tuple[float, ...]:
        """Radii of all collision spheres, m, in the order of `spheres`."""
        legs = tuple(radius for radius in self.leg_radii for _ in LEGS)
        return (*legs, *(sphere.radius for sphere in self.trunk_spheres))

    @property
    def feet(self) -> tuple[tuple[float, float], ...]:
        """(4,) x and y of the feet in the trunk's frame where they hang below their thighs' joints, m."""
        return tuple((x, y + offset) for (x, y, _), offset in zip(self.hips, self.thigh_offset, strict=True))
