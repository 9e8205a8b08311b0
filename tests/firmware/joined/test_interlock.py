"""The joined core under pilots, receivers and policies that misbehave: when the motors may turn."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from neuroflight.toolchain.contract import (
    RECEIVER_HOLD_MS,
    RECEIVER_LOST_MS,
    RECEIVER_OFF_FRAMES,
    RECEIVER_RECOVERY_MS,
    ArmingReason,
    FlightState,
)

Make = Callable[..., Any]
Frame = Callable[..., bytes]
STOPPED = [0, 0, 0, 0]


def reasons(*names: ArmingReason) -> int:
    return sum(1 << name for name in names)


# --- What forbids arming ----------------------------------------------------------------------
def test_every_reason_is_named_when_it_holds(bench: Make) -> None:
    b = bench(4000)
    b.sample()
    assert b.reasons == reasons(
        ArmingReason.BOOT_GRACE,
        ArmingReason.GYRO_NOT_CALIBRATED,
        ArmingReason.RECEIVER_LOST,
        ArmingReason.SWITCH_NOT_CYCLED,
        ArmingReason.NOT_LEVEL,
    )
    b.run(500)
    assert b.reasons == reasons(
        ArmingReason.BOOT_GRACE, ArmingReason.GYRO_NOT_CALIBRATED, ArmingReason.NOT_LEVEL
    )
    b.run(510)
    assert b.reasons == 0
    b.run(20, throttle=1051)
    assert b.reasons == reasons(ArmingReason.THROTTLE_HIGH)
    b.run(20, throttle=1050)
    assert b.reasons == 0
    b.run(RECEIVER_LOST_MS, every_ms=None)
    assert b.reasons == reasons(ArmingReason.RECEIVER_LOST, ArmingReason.SWITCH_NOT_CYCLED)


def test_it_arms_when_the_switch_moves_on_and_nothing_forbids_it(bench: Make) -> None:
    b = bench(4000)
    b.arm()
    assert b.reasons == 0
    assert b.run(50, arm=2000) == [48] * 4


@pytest.mark.parametrize(("us", "armed"), [(1699, False), (1700, True)])
def test_the_switch_is_on_when_its_channel_reaches_the_threshold(bench: Make, us: int, armed: bool) -> None:
    b = bench()
    b.run(1100)
    b.run(20, arm=us)
    assert b.armed is armed


def test_it_never_arms_when_the_switch_was_on_at_boot(bench: Make) -> None:
    b = bench()
    assert b.run(5000, arm=2000) == STOPPED
    assert b.reasons == reasons(ArmingReason.SWITCH_NOT_CYCLED)
    b.run(20)
    b.run(20, arm=2000)
    assert b.armed


def test_it_stays_disarmed_when_the_switch_came_during_boot_grace(bench: Make) -> None:
    b = bench()
    b.run(500)
    b.run(3000, arm=2000)
    assert not b.armed
    assert b.reasons == reasons(ArmingReason.SWITCH_NOT_CYCLED)


def test_it_stays_disarmed_when_throttle_falls_only_after_the_switch(bench: Make) -> None:
    b = bench()
    b.run(1100)
    b.run(100, arm=2000, throttle=1500)
    assert b.run(1000, arm=2000, throttle=1000) == STOPPED
    assert not b.armed


def test_it_stays_disarmed_when_the_gyro_never_came_to_rest(bench: Make) -> None:
    b = bench()
    for index in range(3000):
        b.counts = (300 * (index % 2), 0, 0)
        b.run(1)
    assert b.reasons == reasons(ArmingReason.GYRO_NOT_CALIBRATED)
    b.stick(arm=2000)
    b.sample()
    assert not b.armed
    b.counts = (0, 0, 0)
    b.run(3000, arm=2000)
    assert not b.armed, "a switch that came too early must be cycled"


# --- Disarming --------------------------------------------------------------------------------
def test_motors_stop_within_the_step_of_the_second_frame_that_says_off(bench: Make, scripted: Any) -> None:
    b = bench(1000)
    b.arm()
    scripted.lib.scripted_action = [0.5] * 4
    assert min(b.run(100, arm=2000, throttle=1500)) > 48
    b.stick(arm=1000, throttle=1500)
    assert min(b.sample()) > 48
    b.stick(arm=1000, throttle=1500)
    assert b.sample() == STOPPED


def test_an_off_is_not_overlooked_when_an_on_follows_in_the_same_step(bench: Make, frame: Frame) -> None:
    b = bench(1000)
    b.arm()
    b.run(50, arm=2000, throttle=1500)
    b.send(2 * frame(arm=1000, throttle=1500) + frame(arm=2000, throttle=1500))
    assert b.sample() == STOPPED
    assert b.run(200, arm=2000, throttle=1000) == STOPPED


def test_the_last_frame_counts_when_one_in_failsafe_and_a_good_one_come_in_one_step(
    bench: Make, frame: Frame
) -> None:
    b = bench(1000)
    b.arm()
    b.run(20, arm=2000, c0=1900)
    b.send(frame(arm=2000, c0=1900, failsafe=True))
    b.sample()
    assert (b.status.state, b.trace.setpoint[0]) == (FlightState.FAILSAFE_HOLD, 0)
    b.send(frame(arm=1000, failsafe=True) + frame(arm=2000, c0=1900) + frame(arm=1000, failsafe=True))
    b.sample()
    assert (b.status.state, b.trace.setpoint[0]) == (FlightState.FAILSAFE_HOLD, 0), "the last one counts"
    b.send(2 * frame(arm=1000, failsafe=True) + frame(arm=2000, c0=1900))
    b.sample()
    assert b.status.state == FlightState.ARMED and b.trace.setpoint[0] > 0


def test_it_arms_again_when_the_switch_is_cycled_after_disarming(bench: Make) -> None:
    b = bench(1000)
    b.arm()
    for _ in range(3):
        b.run(30)
        assert not b.armed
        b.run(30, arm=2000)
        assert b.armed


# --- Receiver ---------------------------------------------------------------------------------
@pytest.mark.parametrize("gyro_hz", [1000, 4000])
def test_sticks_are_centred_and_then_motors_stop_when_the_receiver_falls_silent(
    bench: Make,
    scripted: Any,
    gyro_hz: int,
) -> None:
    b = bench(gyro_hz)
    b.arm()
    scripted.lib.scripted_action = [0.1] * 4
    b.stick(arm=2000, throttle=1500, c0=1525, c1=1475, c3=1520)  # answers that stay away are no matter yet
    b.sample()
    for step in range(1, RECEIVER_LOST_MS + 50):
        b.run(1, every_ms=None)
        # `run` may begin between two control steps: the trace is of the last one.
        silent_ms = step - (gyro_hz > 1000)
        held = silent_ms >= RECEIVER_HOLD_MS
        lost = silent_ms >= RECEIVER_LOST_MS
        assert any(b.trace.setpoint) != held, step
        assert b.armed != lost, step
        assert b.trace.throttle == pytest.approx(0 if lost else 0.5), step


@pytest.mark.parametrize("seed", range(5))
def test_motors_stop_and_stay_stopped_when_the_receiver_is_lost_at_a_random_moment(
    bench: Make, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    b = bench(1000)
    b.arm()
    b.run(int(rng.integers(1, 500)), arm=2000, throttle=int(rng.integers(1000, 2001)))
    assert b.armed
    if rng.random() < 0.5:
        b.run(RECEIVER_LOST_MS + 1, every_ms=None)
    else:
        for elapsed in range(RECEIVER_LOST_MS):
            assert b.armed or elapsed > RECEIVER_LOST_MS - 10  # the last good frame may be 10 ms old
            b.stick(arm=2000, failsafe=True)
            b.sample()
    assert not b.armed
    assert b.reasons & reasons(ArmingReason.RECEIVER_LOST)
    assert b.run(RECEIVER_RECOVERY_MS + int(rng.integers(20, 500)), arm=2000) == STOPPED
    assert b.reasons == reasons(ArmingReason.SWITCH_NOT_CYCLED)
    b.run(20)
    b.run(20, arm=2000)
    assert b.armed


def test_the_controller_stays_the_pilots_choice_when_the_receiver_is_lost(bench: Make, scripted: Any) -> None:
    pid = scripted.new("struct pid_gains *")
    pid.motor_count, pid.period_s, pid.smoothing = 4, 1e-3, 1.0
    for us, flies in ((2000, True), (1000, False)):
        b = bench(1000, pid=pid, failsafe_stage=1, failsafe_descend_ms=1000, failsafe_throttle=0.5)
        b.arm()
        b.run(100, arm=2000, c5=us)
        assert b.status.pid_flies == flies
        b.run(RECEIVER_LOST_MS + 500, every_ms=None)
        assert b.status.state == FlightState.FAILSAFE_DROP and b.armed, "it descends"
        assert b.status.pid_flies == flies


@pytest.mark.parametrize(("us", "state"), [(2000, FlightState.FAILSAFE_DROP), (1000, FlightState.DISARMED)])
def test_two_frames_that_say_off_end_a_descent_when_the_link_is_not_good_yet(
    bench: Make, us: int, state: FlightState
) -> None:
    b = bench(1000, failsafe_stage=1, failsafe_descend_ms=3000, failsafe_throttle=0.5)
    b.arm()
    b.run(RECEIVER_LOST_MS + 100, every_ms=None)
    assert b.status.state == FlightState.FAILSAFE_DROP and b.armed
    b.run(30, arm=us)
    assert not b.status.receiver_good
    assert b.status.state == state


def test_readiness_is_lost_when_the_receiver_comes_back_with_the_switch_on(bench: Make) -> None:
    b = bench(1000)
    b.run(1100)
    b.run(RECEIVER_LOST_MS + 1, every_ms=None)
    assert b.run(300, arm=2000) == STOPPED


def test_repeated_frames_do_not_keep_it_flying_when_the_receiver_says_frame_lost(bench: Make) -> None:
    b = bench(1000)
    b.arm()
    for _ in range(RECEIVER_LOST_MS + 1):
        b.stick(arm=2000, frame_lost=True)
        b.sample()
    assert not b.armed


def test_short_gaps_do_no_harm_when_frames_return_before_the_hold_time(bench: Make) -> None:
    b = bench(1000)
    b.arm()
    for _ in range(10):
        b.run(RECEIVER_HOLD_MS - 1, every_ms=None)
        b.run(1, every_ms=1, arm=2000, c0=1600)
        assert b.armed
        assert b.trace.setpoint[0] == pytest.approx(math.radians(200))


# --- Policy -----------------------------------------------------------------------------------
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, -1e-6, 1.0000001])
@pytest.mark.parametrize("motor", range(4))
def test_motors_stop_for_good_when_the_policy_answers_nonsense(
    bench: Make,
    scripted: Any,
    bad: float,
    motor: int,
) -> None:
    b = bench(1000)
    b.arm()
    action = [0.5] * 4
    action[motor] = bad
    scripted.lib.scripted_action = action
    b.stick(arm=2000)
    assert b.sample() == STOPPED
    scripted.lib.scripted_action = [0.5] * 4
    assert b.run(100, arm=2000) == STOPPED
    b.run(50)
    assert b.run(50, arm=2000) == STOPPED
    assert b.reasons & reasons(ArmingReason.POLICY_BAD)
    assert not b.status.policy_good


def test_the_ends_are_allowed_when_the_policy_answers_zero_and_one(bench: Make, scripted: Any) -> None:
    b = bench(1000)
    b.arm()
    scripted.lib.scripted_action = [0.0, 1.0, -0.0, 1.0]
    assert b.run(20, arm=2000) == [48, 2047, 48, 2047]


def test_it_never_arms_when_the_policy_is_bad(bench: Make) -> None:
    b = bench(1000, policy_good=False)
    b.run(1100)
    assert b.reasons == reasons(ArmingReason.POLICY_BAD)
    assert b.run(50, arm=2000) == STOPPED


# --- Everything at once -----------------------------------------------------------------------
@pytest.mark.parametrize("seed", range(3))
def test_motors_never_turn_without_a_witnessed_off_to_on_when_everything_is_random(
    bench: Make,
    scripted: Any,
    seed: int,
) -> None:
    """An observer who only sees the frames knows when arming is possible at all."""
    rng = np.random.default_rng(seed)
    b = bench(1000)
    scripted.lib.scripted_action = [0.5] * 4
    b.run(1001)
    off_seen, was_armed, armed_steps, silent = True, False, 0, 0
    counts_on, offs, failsafe = False, 0, False  # as the receiver counts them
    throttle, switch = 1000, 1000
    for step in range(24000):
        if rng.random() < 0.02:
            switch = int(rng.choice([1000, 1699, 1700, 2000]))
        if rng.random() < 0.02:
            throttle = int(rng.choice([1000, 1050, 1051, 1600]))
        gone = step % 2500 > 1000 and seed > 0
        silent_now = gone and seed == 1
        failsafe = not silent_now and (gone or rng.random() < (0.5 if failsafe else 0.001))
        # A single frame that says something else: a wrong one.
        wrong = not silent_now and not failsafe and rng.random() < 0.02
        told = (1000 if switch >= 1700 else 2000) if wrong else switch
        good = not silent_now and not failsafe
        if silent_now:
            b.send(b"")
        else:
            b.stick(arm=told, throttle=throttle, failsafe=failsafe)
        silent = 0 if good else silent + 1
        if good:
            offs = offs + 1 if told < 1700 else 0
            counts_on = told >= 1700 or (counts_on and offs < RECEIVER_OFF_FRAMES)
        running = b.sample() != STOPPED
        lost = silent >= RECEIVER_LOST_MS
        if good and not counts_on:
            off_seen = True
            assert not running
        if lost:
            off_seen = False
            assert not running
        if running and not was_armed:
            assert off_seen and throttle <= 1050
            off_seen = False
        elif running:
            armed_steps += 1
        elif good and counts_on:
            off_seen = False
        was_armed = running
    assert armed_steps > 500, "the test must have flown to mean anything"
