"""Attitude of a flight, from its body rates."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim.physics.rotation import cross_matrix

Array = NDArray[np.float64]


def attitudes(t: Array, rate: Array) -> Array:
    """Rotation matrices (N, 3, 3), body to world, of a flight that begins level and heading along x.

    t: times [s], (N,), rising. rate: body rates [rad/s], (N, 3). Between two rows their mean is turned by:
    exact for a constant rate, of second order in the step for others.
    """
    turns = np.diff(t)[:, None] * (rate[1:] + rate[:-1]) / 2
    found = np.empty((len(t), 3, 3))
    found[0] = np.eye(3)
    for k, turn in enumerate(turns):
        found[k + 1] = found[k] @ _rotation(turn)
    return found


def _rotation(turn: Array) -> Array:
    """Matrix (3, 3) of a rotation vector [rad], (3,), by Rodrigues' formula."""
    angle = float(np.linalg.norm(turn))
    cross = cross_matrix(turn)
    matrix: Array = (
        np.eye(3) + np.sinc(angle / np.pi) * cross + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * cross @ cross
    )
    return matrix
