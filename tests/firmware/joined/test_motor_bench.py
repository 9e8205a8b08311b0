"""Motor test and DShot commands in the joined core: what reaches the motors, what keeps it from arming."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from neuroflight.toolchain.contract import (
    DSHOT_ALL_MOTORS,
    MOTOR_TEST_MAGIC,
    MOTOR_TEST_TIMEOUT_MS,
    RECEIVER_HOLD_MS,
    ArmingReason,
    DshotCommand,
    Refusal,
)

STOPPED = [0, 0, 0, 0]
QUARTERS = [0.25] * 4
TURNING = [48 + 500] * 4
UNDER_TEST = 1 << ArmingReason.MOTOR_TEST


class Stand:
    """A bench that stands disarmed, its receiver heard, with the background's hands on it."""

    def __init__(self, make: Callable[..., Any], gyro_hz: int = 1000) -> None:
        self.bench = make(gyro_hz)
        self.lib, ffi = self.bench.core.lib, self.bench.core.ffi
        self.motors = ffi.addressof(self.bench.fw, "motor_test")
        self.commands = ffi.addressof(self.bench.fw, "dshot_command")
        self.bench.run(1100)
        assert self.bench.reasons == 0

    def stopped(self) -> bool:
        return bool(self.lib.firmware_stopped(self.bench.fw))

    def open(self) -> Refusal:
        return Refusal(self.lib.motor_test_ask(self.motors, MOTOR_TEST_MAGIC, self.stopped()))

    def give(self, fractions: list[float]) -> Refusal:
        return Refusal(self.lib.motor_test_give(self.motors, fractions, len(fractions)))

    def command(self, command: int, motor: int = DSHOT_ALL_MOTORS) -> Refusal:
        return Refusal(self.lib.dshot_command_ask(self.commands, command, motor, self.stopped()))

    def turn(self) -> None:
        assert self.open() == Refusal.NONE
        assert self.give(QUARTERS) == Refusal.NONE
        assert self.bench.run(1) == TURNING


@pytest.fixture
def stand(bench: Callable[..., Any]) -> Stand:
    return Stand(bench)


# --- Motor test -------------------------------------------------------------------------------
def test_motors_turn_disarmed_when_a_test_is_open(stand: Stand) -> None:
    stand.turn()
    assert not stand.bench.armed
    assert stand.bench.reasons == UNDER_TEST
    assert not stand.stopped()
    assert stand.bench.run(MOTOR_TEST_TIMEOUT_MS - 1) == TURNING
    assert stand.bench.run(1) == STOPPED
    assert stand.bench.reasons == UNDER_TEST
    assert stand.bench.run(MOTOR_TEST_TIMEOUT_MS) == STOPPED
    assert stand.bench.reasons == 0
    assert stand.stopped()


def test_motors_stop_and_nothing_arms_when_the_switch_goes_on_during_a_test(stand: Stand) -> None:
    stand.turn()
    stand.bench.stick(arm=2000)
    assert stand.bench.sample() == STOPPED
    assert stand.bench.run(3 * MOTOR_TEST_TIMEOUT_MS, arm=2000) == STOPPED
    assert not stand.bench.armed
    stand.bench.run(20)
    stand.bench.run(20, arm=2000)
    assert stand.bench.armed, "off and on again, the motors at rest"


def test_motors_stop_when_an_on_hides_before_an_off(stand: Stand, frame: Callable[..., bytes]) -> None:
    stand.turn()
    stand.bench.send(frame(arm=2000) + frame(arm=1000))
    assert stand.bench.sample() == STOPPED
    assert stand.bench.run(100) == STOPPED


def test_no_test_opens_when_armed_or_when_the_switch_is_on(stand: Stand) -> None:
    stand.bench.run(20, arm=2000)
    assert stand.bench.armed
    before = stand.bench.run(1, every_ms=None)
    assert stand.open() == Refusal.ARMED
    assert stand.give(QUARTERS) == Refusal.ORDER
    assert stand.bench.run(10, arm=2000) == before
    stand.bench.run(20, throttle=1500)
    stand.bench.run(20, arm=2000, throttle=1500)
    assert not stand.bench.armed, "the switch is on, the throttle too high to arm"
    stand.open()
    assert stand.bench.run(10, arm=2000, throttle=1500) == STOPPED
    assert stand.give(QUARTERS) == Refusal.ORDER


def test_motors_stop_when_the_receiver_falls_silent(stand: Stand) -> None:
    stand.turn()
    stand.bench.run(10)
    stand.bench.stick()
    assert stand.bench.sample() == TURNING
    assert stand.bench.run(RECEIVER_HOLD_MS - 1, every_ms=None) == TURNING
    assert stand.bench.run(1, every_ms=None) == STOPPED
    assert stand.give(QUARTERS) == Refusal.ORDER


def test_motors_stop_when_the_gyro_falls_silent(stand: Stand) -> None:
    stand.turn()
    out = stand.bench.core.new("uint16_t[8]")
    stand.lib.firmware_gyro_silent(stand.bench.fw, out)
    assert list(out)[:4] == STOPPED
    assert stand.give(QUARTERS) == Refusal.ORDER
    assert stand.bench.run(20) == STOPPED


# --- Commands ---------------------------------------------------------------------------------
@pytest.mark.parametrize("gyro_hz", [1000, 8000])
def test_a_command_is_sent_each_gyro_sample_when_asked_for(bench: Callable[..., Any], gyro_hz: int) -> None:
    stand = Stand(bench, gyro_hz)
    assert stand.command(DshotCommand.DIRECTION_REVERSED, 2) == Refusal.NONE
    assert stand.command(DshotCommand.SAVE) == Refusal.ARMED, "one after the other"
    assert stand.open() == Refusal.ARMED
    frames = [stand.bench.sample() for _ in range(30 * gyro_hz // 1000)]
    assert frames.count([0, 0, 21, 0]) == 10
    assert frames.count(STOPPED) == len(frames) - 10
    assert stand.stopped()


def test_nothing_arms_when_a_command_is_under_way(stand: Stand) -> None:
    assert stand.command(DshotCommand.BEACON_5) == Refusal.NONE
    stand.bench.run(20)
    assert stand.bench.reasons == UNDER_TEST
    assert stand.bench.run(2000, arm=2000) == STOPPED
    assert not stand.bench.armed
    stand.bench.run(20)
    stand.bench.run(20, arm=2000)
    assert stand.bench.armed


def test_no_command_is_sent_when_armed_or_under_test(stand: Stand) -> None:
    stand.turn()
    assert stand.command(DshotCommand.SAVE) == Refusal.ARMED
    assert stand.bench.run(20) == TURNING
    stand.lib.motor_test_ask(stand.motors, 0, True)
    stand.bench.run(MOTOR_TEST_TIMEOUT_MS + 1)
    stand.bench.run(20, arm=2000)
    assert stand.bench.armed
    assert stand.command(DshotCommand.SAVE) == Refusal.ARMED
    assert stand.bench.run(20, arm=2000) == [48] * 4
