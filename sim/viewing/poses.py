"""Attitude of a flight, from its body rates."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def attitudes(t: Array, rate: Array) -> Array:
    """Compute rotation matrices (N, 3, 3), body to world, of a flight that begins level and heading along x.

    t: times [s], (N,), rising. rate: body rates [rad/s], (N, 3). Between two rows their mean is turned by:
    exact for a constant rate, of second order in the step for others.
    """
    turns = _rotations(np.diff(t)[:, None] * (rate[1:] + rate[:-1]) / 2)
    found = np.empty((len(t), 3, 3))
    found[0] = np.eye(3)
    for k, turn in enumerate(turns):
        np.matmul(found[k], turn, out=found[k + 1])
    return found


def _rotations(turns: Array) -> Array:
    """Compute the matrices (N, 3, 3) of rotation vectors [rad], (N, 3), by Rodrigues' formula."""
    angle = np.linalg.norm(turns, axis=1)[:, None, None]
    x, y, z = turns.T
    cross = np.zeros((len(turns), 3, 3))
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = -z, y, -x
    cross -= cross.transpose(0, 2, 1)
    half = np.sinc(angle / (2 * np.pi))
    matrices: Array = np.eye(3) + np.sinc(angle / np.pi) * cross + 0.5 * half**2 * cross @ cross
    return matrices
