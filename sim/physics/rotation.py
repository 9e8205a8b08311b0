"""Rotation matrices, of one or of N aircraft, and unit quaternions."""

from __future__ import annotations

import math

import numpy as np

from neuroflight.sim.arrays import Array

Quaternion = tuple[float, float, float, float]  # w, x, y, z


def quaternion(rotation: Array) -> Quaternion:
    """Compute the unit quaternion of a rotation matrix (3, 3), by its largest component (Shepperd 1978)."""
    (a, b, c), (d, e, f), (g, h, i) = rotation.tolist()
    w2, x2, y2, z2 = 1 + a + e + i, 1 + a - e - i, 1 - a + e - i, 1 - a - e + i
    largest = max(w2, x2, y2, z2)
    if largest == w2:
        q = (w2, h - f, c - g, d - b)
    elif largest == x2:
        q = (h - f, x2, b + d, c + g)
    elif largest == y2:
        q = (c - g, b + d, y2, f + h)
    else:
        q = (d - b, c + g, f + h, z2)
    scale = 0.5 / math.sqrt(largest)
    return (q[0] * scale, q[1] * scale, q[2] * scale, q[3] * scale)


def roll_pitch_yaw(rotation: Array) -> tuple[float, float, float]:
    """Compute angles [rad] about the fixed x, then y, then z axis that make a rotation matrix (3, 3)."""
    r = rotation
    return math.atan2(r[2, 1], r[2, 2]), math.asin(-r[2, 0]), math.atan2(r[1, 0], r[0, 0])


def turned(rotation: Array, vectors: Array) -> Array:
    """Turn rows of `vectors` (N, 3), each by its own matrix of `rotation` (N, 3, 3)."""
    rows: Array = np.einsum("nij,nj->ni", rotation, vectors)
    return rows


def cross_matrix(r: Array) -> Array:
    """Return the matrix (3, 3) of r x, for r of shape (3,)."""
    x, y, z = r
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
