"""Rotation matrices and unit quaternions."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Quaternion = tuple[float, float, float, float]  # w, x, y, z


def quaternion(rotation: NDArray[np.float64]) -> Quaternion:
    """Unit quaternion of a rotation matrix (3, 3), by its largest component (Shepperd 1978)."""
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
