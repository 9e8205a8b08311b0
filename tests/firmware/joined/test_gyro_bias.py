"""The gyro's bias in the joined core: it follows while the motors stand, and arming takes no notice."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from neuroflight.toolchain.contract import (
    CALIBRATION_MS,
    CALIBRATION_STEP_DEG_S,
    DSHOT_ALL_MOTORS,
    MOTOR_TEST_MAGIC,
    DshotCommand,
    Refusal,
)
from tests.firmware.conftest import Bench

DRIFT = (10, -10, 5)  # counts, 0.6 deg/s
STEP = np.deg2rad(CALIBRATION_STEP_DEG_S)
ARMED = {"arm": 2000}


@pytest.fixture
def drifting(bench: Callable[..., Bench]) -> Bench:
    """Calibrated at 0, disarmed; from now on the gyro is off."""
    b = bench(1000)
    b.run(1001)
    assert bias(b) == [0.0] * 3 and b.reasons == 0
    b.counts = DRIFT
    return b


def bias(b: Bench) -> list[float]:
    return list(b.fw.gyro.bias)


def test_the_bias_follows_disarmed_and_nothing_forbids_arming_meanwhile(drifting: Bench) -> None:
    for second in range(1, 4):
        for _ in range(CALIBRATION_MS // 10):
            drifting.run(10)
            assert drifting.reasons == 0
        np.testing.assert_allclose(bias(drifting), np.array([1, -1, 1]) * second * STEP, rtol=1e-5)


def test_the_bias_stays_while_armed_and_a_window_begins_with_the_rest(drifting: Bench) -> None:
    drifting.run(CALIBRATION_MS - 100)
    drifting.run(5 * CALIBRATION_MS, **ARMED)
    assert drifting.armed and bias(drifting) == [0.0] * 3
    drifting.run(CALIBRATION_MS)  # the motors still turned in the first steps
    assert not drifting.armed and bias(drifting) == [0.0] * 3
    drifting.run(30)
    assert bias(drifting) != [0.0] * 3


def test_it_arms_in_the_middle_of_a_window(drifting: Bench) -> None:
    for part_ms in (1, 500, CALIBRATION_MS - 1):
        drifting.run(part_ms, every_ms=1)
        drifting.run(2, every_ms=1, **ARMED)
        assert drifting.armed
        drifting.run(2, every_ms=1)
        assert not drifting.armed and drifting.reasons == 0


def test_the_bias_stays_during_a_motor_test(drifting: Bench) -> None:
    lib, ffi = drifting.core.lib, drifting.core.ffi
    test = ffi.addressof(drifting.fw, "motor_test")
    assert lib.motor_test_ask(test, MOTOR_TEST_MAGIC, True) == Refusal.NONE
    for _ in range(40):
        assert lib.motor_test_give(test, [0.25] * 4, 4) == Refusal.NONE
        assert drifting.run(100)[0] > 48
    assert bias(drifting) == [0.0] * 3


def test_the_bias_stays_while_controllers_are_told_to_beep(drifting: Bench) -> None:
    lib, ffi = drifting.core.lib, drifting.core.ffi
    commands = ffi.addressof(drifting.fw, "dshot_command")
    for _ in range(40):
        drifting.run(CALIBRATION_MS // 2)
        asked: Any = lib.dshot_command_ask(commands, DshotCommand.BEACON_1, DSHOT_ALL_MOTORS, True)
        assert asked == Refusal.NONE
    assert bias(drifting) == [0.0] * 3


def test_a_calibration_that_is_asked_for_takes_the_whole_drift_at_once(drifting: Bench) -> None:
    drifting.run(300)
    drifting.core.lib.firmware_calibrate(drifting.fw)
    drifting.run(CALIBRATION_MS + 10)
    assert drifting.reasons == 0
    assert list(drifting.trace.gyro) == [0.0] * 3
