"""The turn of a board, or of what sits on it: angles, and the axes that they make."""

from __future__ import annotations

import math
from collections.abc import Sequence

Turn = Sequence[float]  # roll, pitch, yaw [deg]
Axes = Sequence[Sequence[float]]  # rows: the body's axes, columns: the board's
BOARD_AXES = ("roll", "pitch", "yaw")
STEEP = 0.999_999  # of a pitch of 90 degrees, where roll and yaw turn about one axis


def turned_axes(turn: Turn) -> Axes:
    """Return a turned board's axes in the body's: the matrix of firmware/src/sensing/gyro.c.

    A board that lies flat is turned by yaw clockwise, then pitch, then roll, about its own axes.
    """
    (sx, cx), (sy, cy), (sz, cz) = ((math.sin(a), math.cos(a)) for a in map(math.radians, turn))
    return [
        [cy * cz, cx * sz + sx * sy * cz, sx * sz - cx * sy * cz],
        [-cy * sz, cx * cz - sx * sy * sz, sx * cz + cx * sy * sz],
        [sy, -sx * cy, cx * cy],
    ]


def turn_of(axes: Axes) -> tuple[float, float, float]:
    """Return the turn (roll, pitch, yaw) [deg] that makes these axes, -180 to 180, to 0.01 deg."""
    steep = abs(axes[2][0]) > STEEP
    x = 0.0 if steep else math.atan2(-axes[2][1], axes[2][2])
    z = math.atan2(axes[0][1], axes[1][1]) if steep else math.atan2(-axes[1][0], axes[0][0])
    y = math.asin(max(-1.0, min(1.0, axes[2][0])))
    rounded = [round(math.degrees(angle), 2) + 0.0 for angle in (x, y, z)]
    return rounded[0], rounded[1], rounded[2]


def times(first: Axes, last: Axes) -> Axes:
    """Return the product of two (3, 3)."""
    columns = list(zip(*last, strict=True))
    return [[sum(a * b for a, b in zip(row, column, strict=True)) for column in columns] for row in first]
