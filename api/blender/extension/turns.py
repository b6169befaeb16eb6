"""Vectors and quaternions (w, x, y, z) as tuples, for code without Blender."""

import math

Vec = tuple[float, float, float]
Quat = tuple[float, float, float, float]
NO_TURN: Quat = (1.0, 0.0, 0.0, 0.0)
"""Rotation that changes nothing."""


def times(a: Quat, b: Quat) -> Quat:
    """Rotation ``a`` after rotation ``b``."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def inverse(a: Quat) -> Quat:
    """Inverse of a rotation."""
    return (a[0], -a[1], -a[2], -a[3])


def turned(a: Quat, v: Vec) -> Vec:
    """Vector after a rotation."""
    w, x, y, z = a
    vx, vy, vz = v
    tx, ty, tz = 2.0 * (y * vz - z * vy), 2.0 * (z * vx - x * vz), 2.0 * (x * vy - y * vx)
    return (vx + w * tx + y * tz - z * ty, vy + w * ty + z * tx - x * tz, vz + w * tz + x * ty - y * tx)


def between(a: Quat, b: Quat, share: float) -> Quat:
    """Rotation at a share of the way from one to another, by the shorter way."""
    dot = sum(x * y for x, y in zip(a, b, strict=True))
    sign = -1.0 if dot < 0.0 else 1.0
    mixed = [(1.0 - share) * x + share * sign * y for x, y in zip(a, b, strict=True)]
    if abs(dot) < 0.9995:
        angle = math.acos(abs(dot))
        first, second = math.sin((1.0 - share) * angle), math.sin(share * angle)
        mixed = [first * x + second * sign * y for x, y in zip(a, b, strict=True)]
    return unit_turn((mixed[0], mixed[1], mixed[2], mixed[3]))


def unit_turn(a: Quat) -> Quat:
    """Quaternion of length 1; no turn for length 0."""
    norm = math.sqrt(sum(x * x for x in a))
    return NO_TURN if norm == 0.0 else (a[0] / norm, a[1] / norm, a[2] / norm, a[3] / norm)


def plus(a: Vec, b: Vec) -> Vec:
    """Sum of two vectors."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def minus(a: Vec, b: Vec) -> Vec:
    """Difference of two vectors."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def scaled(a: Vec, factor: float) -> Vec:
    """Vector times a factor."""
    return (a[0] * factor, a[1] * factor, a[2] * factor)


def length(a: Vec) -> float:
    """Length of a vector."""
    return math.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])


def turn_to(a: Vec, b: Vec) -> Quat:
    """Smallest rotation that turns the direction of one vector into another's; no turn without directions."""
    product = length(a) * length(b)
    if product == 0.0:
        return NO_TURN
    dot = (a[0] * b[0] + a[1] * b[1] + a[2] * b[2]) / product
    if dot < -1.0 + 1e-9:  # Any half turn about an axis across.
        axis = (0.0, -a[2], a[1]) if abs(a[0]) < 0.9 * length(a) else (-a[2], 0.0, a[0])
        return unit_turn((0.0, *axis))
    x, y, z = (
        (a[1] * b[2] - a[2] * b[1]) / product,
        (a[2] * b[0] - a[0] * b[2]) / product,
        (a[0] * b[1] - a[1] * b[0]) / product,
    )
    return unit_turn((1.0 + dot, x, y, z))
