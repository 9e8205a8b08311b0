"""The true turn of the gyro, from gravity: level, and with the nose raised."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from neuroflight.flash.board.turn import Axes, times, turn_of, turned_axes
from neuroflight.flash.hold_down.reaction import Array
from neuroflight.toolchain.errors import LinkError

RAISED_DEG = (8.0, 70.0)  # that the nose must be raised by
ASTRAY_DEG = 25.0  # that level and nose may be off a right angle's turn


def seen_turn(level: Array, raised: Array) -> Axes:
    """Return the body's axes in what the firmware takes for them: rows, (3, 3), one of the 24 right turns.

    level, raised: (3,) what the accelerometer reads, upwards, in the firmware's body axes, with the aircraft
    level and with its nose raised. Raises LinkError where they do not say.
    """
    up = level / np.linalg.norm(level)
    tilt = np.degrees(np.arccos(np.clip(up @ raised / np.linalg.norm(raised), -1.0, 1.0)))
    if not RAISED_DEG[0] <= tilt <= RAISED_DEG[1]:
        raise LinkError(
            f"the nose was raised by {tilt:.0f} degrees, expected {RAISED_DEG[0]:g} to {RAISED_DEG[1]:g}: "
            "raise it by a hand's breadth and hold it; no motor turned"
        )
    ahead = raised - (raised @ up) * up
    ahead = ahead / np.linalg.norm(ahead)
    seen = np.stack([ahead, np.cross(up, ahead), up])
    turns = [turn for turn in _right_turns() if np.linalg.det(turn) > 0]
    nearest = max(turns, key=lambda turn: float(np.trace(turn.T @ seen)))
    angle = np.degrees(np.arccos(np.clip((np.trace(nearest.T @ seen) - 1.0) / 2.0, -1.0, 1.0)))
    if angle > ASTRAY_DEG:
        raise LinkError(
            f"level and raised nose are {angle:.0f} degrees off every right-angled turn of the board, "
            f"expected at most {ASTRAY_DEG:g}: lay it level, raise only the nose; a board that is tilted in "
            "the aircraft needs board_roll_deg and its like first; no motor turned"
        )
    return [[float(each) for each in row] for row in nearest]


def mended_turn(seen: Axes, set_deg: Sequence[float]) -> tuple[float, float, float]:
    """Return board_roll_deg, board_pitch_deg and board_yaw_deg with which `seen` is as it should be.

    set_deg: what they were.
    """
    return turn_of(times(seen, turned_axes(set_deg)))


def _right_turns() -> list[Array]:
    rows = np.eye(3)
    return [
        np.stack([sign * rows[axis] for sign, axis in zip(signs, order, strict=True)])
        for order in itertools.permutations(range(3))
        for signs in itertools.product((1.0, -1.0), repeat=3)
    ]
