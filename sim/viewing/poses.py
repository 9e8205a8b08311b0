"""Attitude of a flight, from its body rates."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from neuroflight.sim.arrays import Array


def attitudes(t: Array, rate: Array) -> Array:
    """Compute rotation matrices (N, 3, 3), body to world, of a flight that begins level and heading along x.

    t: times [s], (N,), rising. rate: body rates [rad/s], (N, 3). Between two rows their mean is turned by:
    exact for a constant rate, of second order in the step for others.
    """
    turns = Rotation.from_rotvec(np.diff(t)[:, None] * (rate[1:] + rate[:-1]) / 2).as_matrix()
    found = np.empty((len(t), 3, 3))
    found[0] = np.eye(3)
    for k, turn in enumerate(turns):
        np.matmul(found[k], turn, out=found[k + 1])
    return found
