"""The mounting of the gyro chip on a board, and its counts of the body's motion."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from neuroflight.toolchain.contract import (
    ACCEL_COUNTS,
    ACCEL_FULL_SCALE_G,
    GRAVITY,
    GYRO_COUNTS,
    GYRO_FULL_SCALE_DEG_S,
    Alignment,
)

_DEGREES = 180.0 / math.pi


# By alignment: chip axis i is `_SIGNS[][i]` times body axis (x forward, y left, z up) number `_AXES[][i]`.
_AXES = 2 * ((0, 1, 2), (1, 0, 2), (0, 1, 2), (1, 0, 2))
_SIGNS = (
    *((1.0, 1.0, 1.0), (-1.0, 1.0, 1.0), (-1.0, -1.0, 1.0), (1.0, -1.0, 1.0)),
    *((-1.0, 1.0, -1.0), (1.0, 1.0, -1.0), (1.0, -1.0, -1.0), (-1.0, -1.0, -1.0)),
)
_PER_FORCE = ACCEL_COUNTS / ACCEL_FULL_SCALE_G / GRAVITY  # counts in 1 m/s^2

Counts = tuple[int, int, int]


def gyro_counts(
    rates: Sequence[float],
    alignment: Alignment,
    scale: tuple[int, int] = (GYRO_COUNTS, GYRO_FULL_SCALE_DEG_S),
) -> Counts:
    """Compute the chip's counts of body rates (3,) [rad/s]: half to even, clamped to int16.

    scale: counts at a rate [deg/s]. The arithmetic and its order are the host build's, so that both see the
    same counts.
    """
    x, y, z = rates
    counts, deg_s = scale
    x = x * _DEGREES * counts / deg_s
    y = y * _DEGREES * counts / deg_s
    z = z * _DEGREES * counts / deg_s
    return _mounted((x, y, z), alignment, 1.0)


def accel_counts(force: Sequence[float], alignment: Alignment) -> Counts:
    """Compute the chip's counts at +-16 g of specific force (3,) [m/s^2], body axes."""
    return _mounted(force, alignment, _PER_FORCE)


def board_axes(turn_deg: Sequence[float]) -> NDArray[np.float64]:
    """Return the axes of a turned board in the body's, (3, 3), as columns.

    turn_deg: roll, pitch, yaw. The board lies flat with its arrow forward, is turned by yaw (clockwise seen
    from above), then its arrow is raised by pitch, then its left side lowered by roll, each about its own
    axes: Betaflight's align_board_*, whose buildRotationMatrix was compiled and agrees.
    """
    roll, pitch, yaw = (math.radians(angle) for angle in turn_deg)
    axes = np.eye(3)
    for angle, i, j in ((yaw, 0, 1), (pitch, 2, 0), (roll, 1, 2)):  # turns axis i towards the back of axis j
        turned = axes.copy()
        turned[:, i] = math.cos(angle) * axes[:, i] - math.sin(angle) * axes[:, j]
        turned[:, j] = math.sin(angle) * axes[:, i] + math.cos(angle) * axes[:, j]
        axes = turned
    return axes


def _mounted(vector: Sequence[float], alignment: Alignment, scale: float) -> Counts:
    (i, j, k), (a, b, c) = _AXES[alignment], _SIGNS[alignment]
    x, y, z = round(a * vector[i] * scale), round(b * vector[j] * scale), round(c * vector[k] * scale)
    if not (-32768 <= x <= 32767 and -32768 <= y <= 32767 and -32768 <= z <= 32767):
        x, y, z = (max(-32768, min(32767, value)) for value in (x, y, z))
    return x, y, z
