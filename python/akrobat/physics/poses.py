"""Rigid poses as arrays `[x y z qw qx qy qz]`, metres."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Vector = NDArray[np.float64]

IDENTITY: Vector = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])


def quaternion_product(a: ArrayLike, b: ArrayLike) -> Vector:
    """Hamilton product of `[w x y z]`."""
    aw, ax, ay, az = np.asarray(a, float).tolist()
    bw, bx, by, bz = np.asarray(b, float).tolist()
    return np.array(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ]
    )


def rotation_matrix(quaternion: ArrayLike) -> Vector:
    """The matrix `[3, 3]` of a unit quaternion `[w x y z]`."""
    w, x, y, z = np.asarray(quaternion, float).tolist()
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


def rotate(quaternion: ArrayLike, points: ArrayLike) -> Vector:
    """Points `[..., 3]` turned by `[w x y z]`."""
    turned: Vector = np.asarray(points, float) @ rotation_matrix(quaternion).T
    return turned


def compose(a_from_b: ArrayLike, b_from_c: ArrayLike) -> Vector:
    """`a_from_c`."""
    a, b = np.asarray(a_from_b, float), np.asarray(b_from_c, float)
    position = a[:3] + rotate(a[3:], b[:3])
    return np.concatenate([position, quaternion_product(a[3:], b[3:])])


def inverse(a_from_b: ArrayLike) -> Vector:
    """`b_from_a`."""
    a = np.asarray(a_from_b, float)
    conjugate = a[3:] * np.array([1.0, -1.0, -1.0, -1.0])
    return np.concatenate([-rotate(conjugate, a[:3]), conjugate])


def transform(a_from_b: ArrayLike, points_in_b: ArrayLike) -> Vector:
    """Points `[..., 3]` in a."""
    a = np.asarray(a_from_b, float)
    return a[:3] + rotate(a[3:], points_in_b)


def angle_between(a: ArrayLike, b: ArrayLike) -> float:
    """Angle between two rotations `[w x y z]`, radians."""
    dot = min(1.0, abs(float(np.dot(np.asarray(a, float), np.asarray(b, float)))))
    return 2.0 * float(np.arccos(dot))


def rotation_from_x_to(axis: ArrayLike) -> Vector:
    """The shortest rotation `[w x y z]` that takes +x to a unit axis."""
    x, y, z = np.asarray(axis, float)
    if x < -1.0 + 1e-9:
        return np.array([0.0, 0.0, 0.0, 1.0])
    q = np.array([1.0 + x, 0.0, -z, y])
    return q / np.linalg.norm(q)
