"""Spatial algebra: inertias, motions and forces of rigid bodies, with their coordinates kept apart.

Two axes are enough, for a quadruped's joints turn about x and y. Featherstone, "Rigid Body Dynamics Algorithms" (2008),
chapter 2. Every function takes arrays of one environment, or of many with the environments on the last axis.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jp

from loco_mjx.physics.kinematics import Vector
from loco_mjx.physics.xla import add_up


class Inertia(NamedTuple):
    """Of a rigid body, about the origin of a frame and along its axes.

    Attributes:
        mass: kg.
        moment: mass times centre of mass, kg m.
        diagonal: Ixx, Iyy, Izz, kg m².
        products: Iyz, Ixz, Ixy as the matrix has them, kg m².
    """

    mass: Any
    moment: Vector
    diagonal: Vector
    products: Vector


class Wrench(NamedTuple):
    """A force, N, and its torque about a frame's origin, N m; or a momentum and an angular momentum."""

    force: Vector
    torque: Vector


class Twist(NamedTuple):
    """An angular velocity, rad/s, and the velocity of what is at a frame's origin, m/s; or their derivatives."""

    angular: Vector
    linear: Vector


class Motion(NamedTuple):
    """How something moves that has no joint within: its twist, and the twist's derivative."""

    velocity: Twist
    acceleration: Twist


def cross(a: Vector, b: Vector) -> Vector:
    """The cross product a × b."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def add(*vectors: Vector) -> Vector:
    """The sum of vectors."""
    x, y, z = (add_up(parts) for parts in zip(*vectors, strict=True))
    return x, y, z


def _times(inertia: Inertia, vector: Vector) -> Vector:
    """The rotational part of an inertia times a vector."""
    (xx, yy, zz), (yz, xz, xy), (x, y, z) = inertia.diagonal, inertia.products, vector
    return (xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z)


def shifted(body: Inertia, place: Vector) -> Inertia:
    """An inertia about another origin, from which the present one is at `place`."""
    (x, y, z), (hx, hy, hz), m = place, body.moment, body.mass
    # with s = h + m p / 2:  I' = I + 2 (p · s) 1 − p sᵀ − s pᵀ
    sx, sy, sz = hx + 0.5 * m * x, hy + 0.5 * m * y, hz + 0.5 * m * z
    px, py, pz = 2.0 * x * sx, 2.0 * y * sy, 2.0 * z * sz
    diagonal = add(body.diagonal, (py + pz, px + pz, px + py))
    products = add(body.products, (-(y * sz + z * sy), -(x * sz + z * sx), -(x * sy + y * sx)))
    return Inertia(m, (hx + m * x, hy + m * y, hz + m * z), diagonal, products)


def turned_inertia(body: Inertia, axis: int, sin: jax.Array, cos: jax.Array) -> Inertia:
    """An inertia in a frame from which the present one is turned about an axis (0: x, 1: y) through its origin."""
    b, c = (axis + 1) % 3, (axis + 2) % 3
    moment, diagonal, products = list(turned(body.moment, axis, sin, cos)), list(body.diagonal), list(body.products)
    half, mean = 0.5 * (diagonal[b] - diagonal[c]), 0.5 * (diagonal[b] + diagonal[c])
    cos2, sin2 = cos * cos - sin * sin, 2.0 * sin * cos
    off = products[axis]
    across = half * cos2 - off * sin2
    diagonal[b], diagonal[c] = mean + across, mean - across
    products[axis] = half * sin2 + off * cos2
    # I_ab and I_ac turn like a vector's components b and c; products are named by the axis they leave out
    ab, ac = products[c], products[b]
    products[c], products[b] = cos * ab - sin * ac, sin * ab + cos * ac
    return Inertia(body.mass, tuple(moment), tuple(diagonal), tuple(products))  # type: ignore[arg-type]


def turned(vector: Vector, axis: int, sin: jax.Array, cos: jax.Array) -> Vector:
    """A vector turned about an axis (0: x, 1: y) by an angle of this sine and cosine."""
    b, c = (axis + 1) % 3, (axis + 2) % 3
    parts = list(vector)
    parts[b], parts[c] = cos * vector[b] - sin * vector[c], sin * vector[b] + cos * vector[c]
    return parts[0], parts[1], parts[2]


def joined(a: Inertia, b: Inertia) -> Inertia:
    """Of two bodies that are one, both about the same origin."""
    return Inertia(a.mass + b.mass, add(a.moment, b.moment), add(a.diagonal, b.diagonal), add(a.products, b.products))


def _momentum(body: Inertia, twist: Twist) -> Wrench:
    # p = m v + ω × h,  L = I ω + h × v
    x, y, z = (body.mass * v for v in twist.linear)
    return Wrench(
        add((x, y, z), cross(twist.angular, body.moment)),
        add(_times(body, twist.angular), cross(body.moment, twist.linear)),
    )


def force_on(body: Inertia, motion: Motion) -> Wrench:
    """What moves a body so: the rate of its momentum, I a + v ×* I v."""
    twist, acceleration = motion
    rate, momentum = _momentum(body, acceleration), _momentum(body, twist)
    return Wrench(
        add(rate.force, cross(twist.angular, momentum.force)),
        add(rate.torque, cross(twist.angular, momentum.torque), cross(twist.linear, momentum.force)),
    )


def _crossed(vector: Vector, axis: int, speed: jax.Array, onto: Vector) -> Vector:
    """Onto + vector × (speed along an axis)."""
    b, c = (axis + 1) % 3, (axis + 2) % 3
    parts = list(onto)
    parts[b], parts[c] = onto[b] + vector[c] * speed, onto[c] - vector[b] * speed
    return parts[0], parts[1], parts[2]


def beyond_joint(motion: Motion, axis: int, speed: jax.Array, arm: Vector | None = None) -> Motion:
    """How what is beyond a joint moves, which turns at a speed about an axis (0: x, 1: y) at the end of an arm.

    An arm along the axis makes no difference, nor does none.
    """
    (angular, linear), (alpha, a) = motion.velocity, motion.acceleration
    alpha, a = _crossed(angular, axis, speed, alpha), _crossed(linear, axis, speed, a)
    if arm is not None:  # what turns about y at the arm's end passes the origin at (x, z)
        x, z = -arm[2] * speed, arm[0] * speed
        a = add(a, (angular[1] * z, angular[2] * x - angular[0] * z, -angular[1] * x))
        linear = (linear[0] + x, linear[1], linear[2] + z)
    angular = (*angular[:axis], angular[axis] + speed, *angular[axis + 1 :])  # type: ignore[assignment]
    return Motion(Twist(angular, linear), Twist(alpha, a))


def joint_momentum(body: Inertia, axis: int, arm: Vector | None = None) -> Wrench:
    """Of a body that turns at 1 rad/s about an axis (0: x, 1: y) at the end of an arm."""
    (hx, hy, hz), (xx, yy, _), (yz, xz, xy) = body.moment, body.diagonal, body.products
    if axis == 0:
        return Wrench((jp.zeros_like(hx), -hz, hy), (xx, xy, xz))
    if arm is None:
        return Wrench((hz, jp.zeros_like(hx), -hx), (xy, yy, yz))
    x, z = arm[0], arm[2]
    force = (hz - body.mass * z, jp.zeros_like(hx), body.mass * x - hx)
    return Wrench(force, (xy + hy * x, yy - hz * z - hx * x, yz + hy * z))


def carried(wrench: Wrench, place: Vector, axis: int, sin: jax.Array, cos: jax.Array) -> Wrench:
    """A wrench in a frame in which the present one is at `place`, turned about an axis (0: x, 1: y)."""
    force = turned(wrench.force, axis, sin, cos)
    return Wrench(force, add(turned(wrench.torque, axis, sin, cos), cross(place, force)))


def torque_about_y(wrench: Wrench, arm: Vector) -> jax.Array:
    """A wrench's torque about y at the end of an arm."""
    return wrench.torque[1] - arm[2] * wrench.force[0] + arm[0] * wrench.force[2]


def plus(a: Wrench, b: Wrench) -> Wrench:
    """Two wrenches about the same origin."""
    return Wrench(add(a.force, b.force), add(a.torque, b.torque))
