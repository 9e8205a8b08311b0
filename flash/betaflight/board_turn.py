"""The turn of a whole board: Betaflight's align_board_* holds the maker's and the pilot's as one."""

from __future__ import annotations

import math
from collections.abc import Sequence

Turn = Sequence[float]  # roll, pitch, yaw [deg]
BOARD_AXES = ("roll", "pitch", "yaw")
BOARD_TURN = {f"align_board_{axis}": axis for axis in BOARD_AXES}  # settings of Betaflight's
NOT_TURNED: Turn = (0.0, 0.0, 0.0)
Axes = list[list[float]]  # rows: the body's axes, columns: the board's
STEEP = 0.999_999  # of a pitch of 90 degrees, where roll and yaw turn about one axis


def pilots_turn(whole: Turn, makers: Turn) -> tuple[float, float, float]:
    """Return what the pilot has turned a board by, (roll, pitch, yaw) [deg], -180 to 180, to 0.01 deg.

    whole: as Betaflight has it; makers: what the maker presets, which the board's description holds. Each
    turns a board that lies flat by yaw clockwise, then pitch, then roll, about the board's own axes.
    """
    if not any(makers):  # as it is told, which is not the only way to say it
        roll, pitch, yaw = ((turn + 180) % 360 - 180 if abs(turn) > 180 else turn for turn in whole)
        return roll, pitch, yaw
    first, last = _axes(whole), _axes(makers)
    rest = [[sum(a * b for a, b in zip(row, column, strict=True)) for column in last] for row in first]
    steep = abs(rest[2][0]) > STEEP
    x = 0.0 if steep else math.atan2(-rest[2][1], rest[2][2])
    z = math.atan2(rest[0][1], rest[1][1]) if steep else math.atan2(-rest[1][0], rest[0][0])
    y = math.asin(max(-1.0, min(1.0, rest[2][0])))
    rounded = [round(math.degrees(angle), 2) + 0.0 for angle in (x, y, z)]
    return rounded[0], rounded[1], rounded[2]


def _axes(turn: Turn) -> Axes:
    """Return a turned board's axes in the body's: the matrix of firmware/src/sensing/gyro.c."""
    (sx, cx), (sy, cy), (sz, cz) = ((math.sin(a), math.cos(a)) for a in map(math.radians, turn))
    return [
        [cy * cz, cx * sz + sx * sy * cz, sx * sz - cx * sy * cz],
        [-cy * sz, cx * cz - sx * sy * sz, sx * cz + cx * sy * sz],
        [sy, -sx * cy, cx * cy],
    ]
