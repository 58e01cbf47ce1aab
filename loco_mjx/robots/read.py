"""A robot from its MJCF, by the names that docs/robots.md gives; what does not fit is refused in one line.

Python's own XML reader is enough for it: a small computer that only runs policies has no MuJoCo. Where MuJoCo is there,
`loco_mjx/physics/compiled.py` compares what was read with what MuJoCo makes of the same file.
"""

from __future__ import annotations

from pathlib import Path

from loco_mjx.errors import UserError
from loco_mjx.robots.document import Document, Element
from loco_mjx.robots.robot import LEG_SPHERES, LEGS, NQ, PARTS, Robot, Sphere, Vector3, joint_names

STAND, CAMERA, IMU, TRUNK = "stand", "depth_camera", "imu", "trunk"
AXES = {"hip": (1.0, 0.0, 0.0), "thigh": (0.0, 1.0, 0.0), "calf": (0.0, 1.0, 0.0)}
LEVEL = (0.0, -1.0, 0.0, 0.0, 0.0, 1.0)  # a camera's x and y axes where it looks along x, upright
NEAR = 1e-3  # m, by which a sphere may be off its place


def read(path: Path) -> Robot:
    """The robot of an MJCF.

    Raises:
        UserError: if the file cannot be read, or does not have what is needed of it; it says what.
    """
    try:
        return _robot(Document(path))
    except UserError as error:
        raise UserError(f"'{path}' is no robot that fits: {error}; docs/robots.md says what is needed") from None


def _robot(document: Document) -> Robot:
    trunk = document.named("body", TRUNK)
    roots = trunk.children("joint", "freejoint")
    if not any(joint.tag == "freejoint" or joint.get("type") == "free" for joint in roots):
        raise UserError(f"body '{TRUNK}' has no freejoint")
    pose = document.named("key", STAND).numbers("qpos", NQ)
    joints = _joints(document)
    kp, kd = (document.custom(name, 1)[0] for name in ("kp", "kd"))
    rate, step = document.custom("policy_hz", 1)[0], document.timestep
    if rate != round(rate) or abs(round(1 / (rate * step)) * rate * step - 1) > 1e-9:
        raise UserError(f"policy_hz is {rate:g}; accepted: a whole number of timesteps of {step} s each")
    lower, upper = zip(*(joint.limits(document.angle) for joint in joints), strict=True)
    hips, offsets, length = _links(document)
    radii, foot = _leg_spheres(document, offsets)
    return Robot(
        name=document.model,
        path=document.path,
        default_pose=pose[7:],
        stand_height=pose[2],
        lower=lower,
        upper=upper,
        torque_limit=_torque_limits(document),
        damping=tuple(joint.number("damping", 0.0) for joint in joints),
        kp=kp,
        kd=kd,
        action_scale=_vector(document.custom("action_scale", 3)),
        policy_hz=int(rate),
        physics_dt=step,
        hips=hips,
        thigh_offset=offsets,
        thigh_length=length,
        foot=foot,
        leg_radii=radii,
        trunk_spheres=_trunk_spheres(trunk),
        camera=_camera(document, trunk),
        imu=_vector(_on(trunk, document.named("site", IMU)).numbers("pos", 3, (0.0, 0.0, 0.0))),
    )


def _vector(values: tuple[float, ...]) -> Vector3:
    x, y, z = values
    return x, y, z


def _on(body: Element, part: Element) -> Element:
    """The part, of which is known that it lies directly in a body, along its axes."""
    if part.parent != body.name:
        raise UserError(f"{part} is in body '{part.parent}'; accepted: in '{body.name}'")
    if turned := part.turned():
        raise UserError(f"{part} is turned ({turned}); accepted: along the axes of '{body.name}'")
    return part


def _joints(document: Document) -> list[Element]:
    """The joints in order, each a hinge about its own axis, in its own body."""
    found = [joint for joint in document.all("joint") if joint.get("type", "hinge") != "free"]
    names = [joint.name for joint in found]
    wanted = list(joint_names())
    for name in wanted:
        document.named("joint", name)
    if names != wanted:
        raise UserError(f"its joints are {', '.join(names)}; accepted: {', '.join(wanted)}, in this order")
    for joint in found:
        leg, part, _ = joint.name.split("_")
        body = document.named("body", f"{leg}_{part}")
        _on(body, joint)
        if joint.numbers("axis", 3, (0.0, 0.0, 1.0)) != AXES[part] or joint.get("type", "hinge") != "hinge":
            raise UserError(f"{joint} has axis {joint.get('axis')}; accepted: a hinge about {AXES[part]}")
        for name in ("pos", "ref", "stiffness", "frictionloss", "springref"):
            if any(joint.numbers(name, None, (0.0,))):
                raise UserError(f"{joint} has {name} {joint.get(name)}; accepted: 0")
    return found


def _torque_limits(document: Document) -> tuple[float, ...]:
    """Of the motors, which come in the joints' order."""
    motors = document.all_in("actuator")
    if [motor.get("joint") for motor in motors] != list(joint_names()) or {m.tag for m in motors} != {"motor"}:
        raise UserError("its actuators are others; accepted: a <motor> for each joint, in the joints' order")
    limits = []
    for motor in motors:
        low, high = motor.numbers("ctrlrange", 2)
        if low != -high or high <= 0 or motor.number("gear", 1.0) != 1.0:
            raise UserError(f"{motor} has ctrlrange {low:g} {high:g}; accepted: -T T with its torque limit T, gear 1")
        limits.append(high)
    return tuple(limits)


def _links(document: Document) -> tuple[tuple[Vector3, ...], tuple[float, ...], float]:
    """Hip joints in the trunk, offsets of the thigh joints, and the length of the thighs."""
    trunk, hips, offsets, lengths = document.named("body", TRUNK), [], [], set()
    for leg in LEGS:
        hip, thigh, calf = (document.named("body", f"{leg}_{part}") for part in PARTS)
        hips.append(_vector(_on(trunk, hip).numbers("pos", 3, (0.0, 0.0, 0.0))))
        x, y, z = _on(hip, thigh).numbers("pos", 3, (0.0, 0.0, 0.0))
        along = _on(thigh, calf).numbers("pos", 3, (0.0, 0.0, 0.0))
        if x or z:
            raise UserError(f"{thigh} is at {x:g} {y:g} {z:g} of its hip; accepted: 0 Y 0")
        if along[0] or along[1] or along[2] >= 0:
            raise UserError(f"{calf} is at {' '.join(f'{c:g}' for c in along)} of its thigh; accepted: 0 0 -LENGTH")
        offsets.append(y)
        lengths.add(-along[2])
    if len(lengths) > 1:
        raise UserError(f"its thighs are {', '.join(map(str, sorted(lengths)))} m long; accepted: all the same")
    return tuple(hips), tuple(offsets), lengths.pop()


def _leg_spheres(
    document: Document, offsets: tuple[float, ...]
) -> tuple[tuple[float, float, float, float], tuple[float, float]]:
    """Radii of the legs' four kinds of spheres, and where the feet are in their calves."""
    radii: dict[str, set[float]] = {part: set() for part in LEG_SPHERES}
    feet = set()
    for leg, offset in zip(LEGS, offsets, strict=True):
        hip, calf = document.named("body", f"{leg}_hip"), document.named("body", f"{leg}_calf")
        spheres = {part: document.named("geom", f"{leg}_{part}_sphere") for part in LEG_SPHERES}
        for part, sphere in spheres.items():
            radii[part].add(sphere.radius())
            _on(hip if part == "hip" else calf, sphere)
        foot = spheres["foot"].numbers("pos", 3, (0.0, 0.0, 0.0))
        if foot[1] or foot[2] >= 0:
            raise UserError(f"{spheres['foot']} is at {' '.join(f'{c:g}' for c in foot)}; accepted: X 0 -LENGTH")
        feet.add((foot[0], foot[2]))
        half = tuple(0.5 * c for c in foot)
        for part, place in (("hip", (0.0, offset, 0.0)), ("knee", (0.0, 0.0, 0.0)), ("calf", half)):
            at = spheres[part].numbers("pos", 3, (0.0, 0.0, 0.0))
            if max(abs(a - b) for a, b in zip(at, place, strict=True)) > NEAR:
                where = {"hip": "the thigh's joint", "knee": "the calf's joint", "calf": "half way to the foot"}[part]
                raise UserError(f"{spheres[part]} is at {' '.join(f'{c:g}' for c in at)}; accepted: at {where}")
    for part, sizes in radii.items():
        if len(sizes) > 1:
            raise UserError(f"its {part} spheres have radii {', '.join(map(str, sorted(sizes)))}; accepted: the same")
    if len(feet) > 1:
        raise UserError("its feet are at different places in their calves; accepted: the same in all")
    one = [radii[part].pop() for part in LEG_SPHERES]
    return (one[0], one[1], one[2], one[3]), feet.pop()


def _trunk_spheres(trunk: Element) -> tuple[Sphere, ...]:
    found = [
        Sphere(geom.name, _vector(_on(trunk, geom).numbers("pos", 3, (0.0, 0.0, 0.0))), geom.radius())
        for geom in trunk.children("geom")
        if geom.name.startswith(f"{TRUNK}_") and geom.name.endswith("_sphere")
    ]
    if not found:
        raise UserError(f"body '{TRUNK}' has no geom '{TRUNK}_…_sphere'")
    return tuple(found)


def _camera(document: Document, trunk: Element) -> Vector3:
    camera = document.named("camera", CAMERA)
    if camera.parent != trunk.name or camera.numbers("xyaxes", 6, (0.0,) * 6) != LEVEL:
        raise UserError(f"{camera} does not look ahead; accepted: in '{TRUNK}', xyaxes=\"0 -1 0 0 0 1\"")
    return _vector(camera.numbers("pos", 3, (0.0, 0.0, 0.0)))
