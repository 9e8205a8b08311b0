"""gyro.c: how the board is turned in the aircraft, on top of how the chip is turned on the board."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from neuroflight.toolchain.contract import CALIBRATION_MS, GyroHealth
from tests.flights.wiring import board_axes

RATE = math.radians(2000) / 32768  # rad/s of a count
FORCE = 9.80665 / 2048  # m/s^2 of a count
FORWARD, LEFT, UP = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
SLANT = math.sqrt(0.5)


class Board:
    """A gyro on a board that is so turned, calibrated at rest unless told otherwise."""

    def __init__(self, core: Any, angles: Sequence[float], alignment: int = 0) -> None:
        self._core, self._out = core, core.new("float[3]")
        self.gyro = core.new("struct gyro *")
        assert core.lib.gyro_init(self.gyro, 1000, alignment, 0) == 0
        core.lib.gyro_board_init(self.gyro, *angles)

    def feed(self, gyro: Sequence[int], accel: Sequence[int] = (0, 0, 2048)) -> NDArray[np.float64]:
        """A sample of these counts; returns the body rates."""
        sample = self._core.new("struct imu_sample *", (list(gyro), list(accel), 0, True))
        self._core.lib.gyro_step(self.gyro, sample, self._out)
        return np.array(list(self._out))

    def force(self) -> NDArray[np.float64]:
        self._core.lib.gyro_acceleration(self.gyro, self._out)
        return np.array(list(self._out))


@pytest.mark.parametrize(
    ("angles", "along_board", "along_body"),
    [
        ((0, 0, 45), FORWARD, (SLANT, -SLANT, 0)),  # the arrow points forward and to the right
        ((0, 0, 90), FORWARD, (0, -1, 0)),  # to the right
        ((0, 0, -90), FORWARD, LEFT),
        ((0, 0, 180), FORWARD, (-1, 0, 0)),  # backwards
        ((180, 0, 0), UP, (0, 0, -1)),  # hangs upside down, the arrow forward
        ((180, 0, 0), FORWARD, FORWARD),
        ((180, 0, 0), LEFT, (0, -1, 0)),
        ((0, 180, 0), FORWARD, (-1, 0, 0)),  # upside down, the arrow backwards
        ((0, 180, 0), UP, (0, 0, -1)),
        ((0, 45, 0), FORWARD, (SLANT, 0, SLANT)),  # the arrow points upwards
        ((45, 0, 0), LEFT, (0, SLANT, -SLANT)),  # its left side is lower
        ((90, 0, 90), FORWARD, (0, -1, 0)),  # turned first, then rolled about its own arrow
        ((90, 0, 90), LEFT, (0, 0, -1)),
        ((0, 90, 90), FORWARD, UP),
        ((180, 0, 45), FORWARD, (SLANT, -SLANT, 0)),
    ],
)
def test_a_board_so_mounted_is_read_in_the_bodys_axes(
    scripted: Any, angles: Sequence[float], along_board: Sequence[float], along_body: Sequence[float]
) -> None:
    board = Board(scripted, angles)
    rate = board.feed([round(1000 * value) for value in along_board], [round(2048 * v) for v in along_board])
    np.testing.assert_allclose(rate / (1000 * RATE), along_body, atol=2e-6)
    np.testing.assert_allclose(board.force() / 9.80665, along_body, atol=2e-6)
    np.testing.assert_allclose(board_axes(angles) @ along_board, along_body, atol=1e-12)


@pytest.mark.parametrize("seed", range(8))
def test_any_turn_is_undone_and_the_chips_own_before_it(scripted: Any, seed: int) -> None:
    rng = np.random.default_rng(seed)
    angles = rng.uniform(-180, 180, 3).tolist()
    board, chip = Board(scripted, angles, alignment=seed % 4), Board(scripted, (0, 0, 0), alignment=seed % 4)
    for _ in range(50):
        gyro, accel = rng.integers(-20000, 20001, (2, 3)).tolist()
        straight = chip.feed(gyro, accel)
        np.testing.assert_allclose(board.feed(gyro, accel), board_axes(angles) @ straight, atol=40 * 1e-6)
        np.testing.assert_allclose(board.force(), board_axes(angles) @ chip.force(), atol=2e-4)


@pytest.mark.parametrize("maker", [(0, 0, -45), (0, 0, 135), (180, 0, 90)])
def test_the_pilots_turn_comes_on_top_of_the_makers(scripted: Any, maker: Sequence[float]) -> None:
    pilot = (10, -20, 90)
    board = Board(scripted, maker)
    scripted.lib.gyro_board_init(board.gyro, *pilot)
    gyro, accel = [1000, -2000, 3000], [100, 2000, -300]
    wanted = board_axes(pilot) @ board_axes(maker)
    np.testing.assert_allclose(board.feed(gyro, accel) / RATE, wanted @ gyro, atol=2e-2)
    np.testing.assert_allclose(board.force() / FORCE, wanted @ accel, atol=2e-2)


def test_nothing_is_computed_when_the_board_is_not_turned(scripted: Any) -> None:
    assert not Board(scripted, (0, 0, 0)).gyro.turned
    assert not Board(scripted, (-0.0, 0.0, -0.0)).gyro.turned
    for angles in np.eye(3).tolist():
        assert Board(scripted, angles).gyro.turned


def test_the_bias_is_that_of_the_chip_when_the_board_is_turned(scripted: Any) -> None:
    board = Board(scripted, (30, -50, 110), alignment=1)
    bias = [100, -37, 5]
    for _ in range(CALIBRATION_MS):
        board.feed(bias)
    assert board.gyro.calibrated
    np.testing.assert_allclose(board.feed(bias), 0.0, atol=1e-6)
    turned = board.feed([1100, -37, 5])
    np.testing.assert_allclose(np.linalg.norm(turned), 1000 * RATE, rtol=1e-5)


def test_an_axis_of_the_chip_saturates_when_the_board_is_turned(scripted: Any) -> None:
    board = Board(scripted, (30, -50, 110))
    board.feed([20000, 20000, 20000])
    assert board.gyro.health == GyroHealth.GOOD, "its length is beyond the range, no axis is"
    board.feed([32767, 0, 0])
    assert board.gyro.health == GyroHealth.SATURATED
