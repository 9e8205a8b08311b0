"""The turn of a whole board: Betaflight's align_board_* holds the maker's and the pilot's as one."""

from __future__ import annotations

from neuroflight.flash.board.turn import BOARD_AXES, Turn, times, turn_of, turned_axes

BOARD_TURN = {f"align_board_{axis}": axis for axis in BOARD_AXES}  # settings of Betaflight's
NOT_TURNED: Turn = (0.0, 0.0, 0.0)


def pilots_turn(whole: Turn, makers: Turn) -> tuple[float, float, float]:
    """Return what the pilot has turned a board by, (roll, pitch, yaw) [deg], -180 to 180, to 0.01 deg.

    whole: as Betaflight has it; makers: what the maker presets, which the board's description holds. Each
    turns a board as `turned_axes` says.
    """
    if not any(makers):  # as it is told, which is not the only way to say it
        roll, pitch, yaw = ((turn + 180) % 360 - 180 if abs(turn) > 180 else turn for turn in whole)
        return roll, pitch, yaw
    return turn_of(times(turned_axes(whole), list(zip(*turned_axes(makers), strict=True))))
