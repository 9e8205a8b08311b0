"""How the gyro chip is turned on a board, and what it counts of the body's motion."""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import IntEnum

from toolchain.contract import ACCEL_COUNTS, ACCEL_FULL_SCALE_G, GRAVITY, GYRO_COUNTS, GYRO_FULL_SCALE_DEG_S

_DEGREES = 180.0 / math.pi


class Alignment(IntEnum):
    """How the chip is turned on the board, clockwise seen from above."""

    CW0 = 0
    CW90 = 1
    CW180 = 2
    CW270 = 3


# Chip axis i is body axis (x forward, y left, z up) number `_AXES[i]` times `_SIGNS[i]`.
_AXES = {
    Alignment.CW0: (0, 1, 2),
    Alignment.CW90: (1, 0, 2),
    Alignment.CW180: (0, 1, 2),
    Alignment.CW270: (1, 0, 2),
}
_SIGNS = {
    Alignment.CW0: (1.0, 1.0, 1.0),
    Alignment.CW90: (-1.0, 1.0, 1.0),
    Alignment.CW180: (-1.0, -1.0, 1.0),
    Alignment.CW270: (1.0, -1.0, 1.0),
}

Counts = tuple[int, int, int]


def gyro_counts(rates: Sequence[float], alignment: Alignment) -> Counts:
    """Counts on the chip's axes at +-2000 deg/s of body rates (3,) [rad/s]: half to even, clamped to int16.

    The same arithmetic in the same order as the host build's, so that both see the same counts.
    """
    scaled = [rate * _DEGREES * GYRO_COUNTS / GYRO_FULL_SCALE_DEG_S for rate in rates]
    return _mounted(scaled, alignment, 1.0)


def accel_counts(force: Sequence[float], alignment: Alignment) -> Counts:
    """Counts on the chip's axes at +-16 g of specific force (3,) [m/s^2], body axes."""
    return _mounted(force, alignment, ACCEL_COUNTS / ACCEL_FULL_SCALE_G / GRAVITY)


def _mounted(vector: Sequence[float], alignment: Alignment, scale: float) -> Counts:
    (i, j, k), (a, b, c) = _AXES[alignment], _SIGNS[alignment]
    x, y, z = round(a * vector[i] * scale), round(b * vector[j] * scale), round(c * vector[k] * scale)
    if not (-32768 <= x <= 32767 and -32768 <= y <= 32767 and -32768 <= z <= 32767):
        x, y, z = (max(-32768, min(32767, value)) for value in (x, y, z))
    return x, y, z
