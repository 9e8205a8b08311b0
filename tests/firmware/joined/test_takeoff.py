"""The joined core on the ground: what waits for the take-off, and what does not."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from neuroflight.toolchain.contract import (
    CHANNEL_PID,
    CRASH_ERROR_DEG_S,
    CRASH_MS,
    NO_RESPONSE_MS,
    OSCILLATION_ERROR_DEG_S,
    RUNAWAY_MS,
    TAKEOFF_MS,
    TAKEOFF_THROTTLE,
    TAKEOFF_TURN_DEG,
    WRONG_WAY_DEG,
    WRONG_WAY_ERROR_DEG_S,
    WRONG_WAY_MS,
    WRONG_WAY_TAKEOFF_DEG,
    FallbackCause,
    FlightState,
    StopCause,
)
from tests.firmware.conftest import Bench
from tests.firmware.joined.field import Field

Make = Callable[..., Bench]
COUNTS_PER_DEG_S = 32768 / 2000
RIGHT, WRONG = [0.7, 0.7, 0.1, 0.1], [0.1, 0.1, 0.2, 0.2]  # answers to a roll error > 0; a large one
INTEGRAL, PREVIOUS = slice(9, 12), slice(12, 16)  # in the observation of the scripted policy
CHECK = {"throttle": 1060, "c0": 1610}  # of the sticks, before a flight
TAKEOFF_US = 1000 + round(1000 * TAKEOFF_THROTTLE)
CYCLE_MS = 30  # in which two frames tell the arm switch
PID = {f"c{CHANNEL_PID}": 2000}


@pytest.fixture
def make_armed(bench: Make, scripted: Any) -> Callable[..., Bench]:
    """Makes benches armed on the ground; their PID's integral acts on roll, the policy answers rightly."""

    def make(**settings: float) -> Bench:
        scripted.lib.scripted_action = RIGHT
        pid = scripted.new("struct pid_gains *")
        pid.motor_count, pid.period_s, pid.smoothing = 4, 1e-3, 1.0
        pid.p, pid.i = [0.1, 0.0, 0.0], [1.0, 0.0, 0.0]
        pid.integral_max = [1.0] * 3
        pid.mixer = [[1.0, 0.0, 0.0]] * 2 + [[-1.0, 0.0, 0.0]] * 2
        b = bench(1000, pid=pid, **{"level_limit_deg": 0, "ground_detection": 1, **settings})
        b.arm()
        return b

    return make


@pytest.fixture
def armed(make_armed: Callable[..., Bench]) -> Bench:
    return make_armed()


def fly(b: Bench, ms: int, **channels_us: int) -> None:
    b.run(ms, **{"arm": 2000, **channels_us})


def take_off(b: Bench, **channels_us: int) -> None:
    assert not b.status.airborne
    fly(b, TAKEOFF_MS + 20, throttle=TAKEOFF_US + 20, **channels_us)
    assert b.status.airborne


def seen(scripted: Any, part: slice) -> list[float]:
    return list(scripted.lib.scripted_observation)[part]


# --- Checks of the sticks ---------------------------------------------------------------------
@pytest.mark.parametrize("sticks", [CHECK, {"throttle": 1000, "c0": 2000}, {"throttle": 1190, "c0": 1900}])
def test_sticks_that_move_nothing_are_no_fault_of_the_policy_before_take_off(
    armed: Bench, sticks: dict[str, int]
) -> None:
    fly(armed, 10 * NO_RESPONSE_MS, **sticks)
    assert (armed.status.state, armed.status.pid_flies, armed.status.airborne) == (
        FlightState.ARMED,
        False,
        False,
    )
    take_off(armed)
    fly(armed, NO_RESPONSE_MS + 20, **CHECK)
    assert armed.status.fallback_cause == FallbackCause.NO_RESPONSE, "in the air they are"


@pytest.mark.parametrize("flies", [{}, PID], ids=["policy", "pid"])
def test_sticks_that_move_nothing_are_no_crash_before_take_off(
    make_armed: Callable[..., Bench], flies: dict[str, int]
) -> None:
    b = make_armed(plausibility_detection=0)
    fly(b, 10 * CRASH_MS, throttle=1060, c0=2000, **flies)
    assert b.status.state == FlightState.ARMED
    take_off(b, **flies)
    fly(b, CRASH_MS + 20, throttle=1060, c0=2000, **flies)
    assert (b.status.state, b.status.stop_cause) == (FlightState.CRASHED, StopCause.CRASH)


def test_a_tilted_stand_is_ground_like_any_other(armed: Bench) -> None:
    armed.accel = (700, 0, 1924)  # 20 deg
    for throttle in range(1000, TAKEOFF_US, 10):
        fly(armed, 50, throttle=throttle, c0=1610)
    assert (armed.status.state, armed.status.pid_flies, armed.status.airborne) == (
        FlightState.ARMED,
        False,
        False,
    )


# --- What protects the take-off meanwhile -----------------------------------------------------
def test_a_policy_that_steers_the_wrong_way_hands_over_on_the_ground(armed: Bench, scripted: Any) -> None:
    scripted.lib.scripted_action = WRONG
    fly(armed, WRONG_WAY_MS + 20, **CHECK)
    assert not armed.status.airborne
    assert (armed.status.pid_flies, armed.status.fallback_cause) == (True, FallbackCause.WRONG_WAY)


def test_a_policy_that_turns_the_aircraft_the_wrong_way_hands_over_sooner_before_take_off(
    make_armed: Callable[..., Bench], scripted: Any
) -> None:
    for in_the_air in (False, True):
        b = make_armed()
        scripted.lib.scripted_action = RIGHT
        if in_the_air:
            take_off(b)
        scripted.lib.scripted_action = WRONG
        rate, turned = 2 * WRONG_WAY_ERROR_DEG_S, 0.0
        while not b.status.pid_flies:
            rate += 10.0
            turned += rate / 1000
            b.counts = (round(-rate * COUNTS_PER_DEG_S), 0, 0)
            fly(b, 1)
        angle = WRONG_WAY_DEG if in_the_air else WRONG_WAY_TAKEOFF_DEG
        assert angle < turned < angle + 2 * rate / 1000


def test_a_policy_that_oscillates_hands_over_on_the_ground(armed: Bench) -> None:
    size = 3 * OSCILLATION_ERROR_DEG_S * COUNTS_PER_DEG_S
    for ms in range(1000):
        armed.counts = (round(size * math.sin(math.tau * 16 * ms / 1000)), 0, 0)
        fly(armed, 1)
    assert not armed.status.airborne
    assert armed.status.fallback_cause == FallbackCause.OSCILLATION


@pytest.mark.parametrize("waits_ms", [0, 5000])
def test_a_runaway_stops_the_motors_however_long_it_stood(
    make_armed: Callable[..., Bench], waits_ms: int
) -> None:
    b = make_armed(plausibility_detection=0)
    fly(b, waits_ms, throttle=1060)
    for rate in np.linspace(0, 2 * CRASH_ERROR_DEG_S, 4 * RUNAWAY_MS):
        b.counts = (0, round(-rate * COUNTS_PER_DEG_S), 0)
        fly(b, 1, throttle=1060)
    assert (b.status.state, b.status.stop_cause) == (FlightState.CRASHED, StopCause.RUNAWAY)


def test_an_aircraft_that_has_tipped_over_may_crash(make_armed: Callable[..., Bench]) -> None:
    b = make_armed(plausibility_detection=0)
    b.counts = (round(200 * COUNTS_PER_DEG_S), 0, 0)
    fly(b, round(1000 * 1.3 * TAKEOFF_TURN_DEG / 200), **CHECK)
    assert b.status.airborne
    b.counts = (0, 0, 0)
    fly(b, CRASH_MS + 50, throttle=1060, c0=2000)
    assert b.status.stop_cause == StopCause.CRASH


# --- What winds up ----------------------------------------------------------------------------
def test_the_policy_sees_no_integral_and_no_answer_of_its_own_until_take_off(
    armed: Bench, scripted: Any
) -> None:
    for sticks in ({}, CHECK, {"throttle": 1190, "c0": 1900}):
        fly(armed, 300, **sticks)
        assert (seen(scripted, INTEGRAL), seen(scripted, PREVIOUS)) == ([0.0] * 3, [0.0] * 4)
    take_off(armed)
    fly(armed, 100, throttle=1250, c0=1600)
    assert seen(scripted, INTEGRAL)[0] == pytest.approx(math.radians(200) * 0.1, rel=0.15)
    np.testing.assert_allclose(seen(scripted, PREVIOUS), RIGHT, rtol=1e-6)


def test_the_policy_sees_nothing_of_its_motors_until_take_off(armed: Bench, scripted: Any) -> None:
    own = scripted.new("unsigned char[]", [1, 2, 3, 4, 9, 6])  # previous_motors for previous_action
    armed.fw.control.observation.blocks = own
    fly(armed, 100, **CHECK)
    assert seen(scripted, PREVIOUS) == [0.0] * 4
    take_off(armed)
    fly(armed, 100, throttle=1250)
    thrust = 0.25 * (1 - max(RIGHT))
    np.testing.assert_allclose(seen(scripted, PREVIOUS), np.array(RIGHT) + thrust - 0.25, rtol=1e-5)


def test_the_policy_sees_its_answers_as_soon_as_the_throttle_is_raised(armed: Bench, scripted: Any) -> None:
    """A light aircraft flies then, although it has not taken off yet; integrals wait for that."""
    for _ in range(3):
        fly(armed, 100, throttle=TAKEOFF_US + 20, c0=1600)
        np.testing.assert_allclose(seen(scripted, PREVIOUS), RIGHT, rtol=1e-6)
        assert (seen(scripted, INTEGRAL), bool(armed.status.airborne)) == ([0.0] * 3, False)
        fly(armed, 100, **CHECK)
        assert seen(scripted, PREVIOUS) == [0.0] * 4


def test_the_pids_integral_does_not_grow_until_take_off(armed: Bench) -> None:
    armed.counts = (round(1.0 * COUNTS_PER_DEG_S), 0, 0)
    fly(armed, 100, **PID)
    still = list(armed.trace.dshot)[:4]
    fly(armed, 5000, **PID)
    assert list(armed.trace.dshot)[:4] == still
    take_off(armed, **PID)
    fly(armed, 5000, throttle=1000, **PID)
    assert max(list(armed.trace.dshot)[:4]) > max(still) + 50


def test_a_landed_aircraft_keeps_its_integral_until_it_is_disarmed(armed: Bench, scripted: Any) -> None:
    """As Betaflight's airmode: with a closed throttle nobody knows it from one that hovers on its idle."""
    take_off(armed)
    fly(armed, 100, throttle=1250, c0=1600)
    kept = seen(scripted, INTEGRAL)
    fly(armed, 20_000, throttle=1000)
    assert armed.status.airborne
    assert seen(scripted, INTEGRAL)[0] == pytest.approx(kept[0], rel=0.1) and kept[0] > 0.1
    armed.run(CYCLE_MS)
    assert (armed.armed, bool(armed.status.airborne)) == (False, False)
    armed.run(CYCLE_MS, arm=2000)
    fly(armed, 100, **CHECK)
    assert (bool(armed.status.airborne), seen(scripted, INTEGRAL)) == (False, [0.0] * 3)


def test_the_pid_that_takes_over_on_the_ground_does_not_wind_up_either(armed: Bench, scripted: Any) -> None:
    scripted.lib.scripted_action = WRONG
    fly(armed, WRONG_WAY_MS + 20, **CHECK)
    assert armed.status.pid_flies
    fly(armed, 2000, **CHECK)
    assert list(armed.fw.control.pid.integral) == [0.0] * 3


def test_an_aircraft_on_a_rig_flies_at_once_when_it_is_told_so(
    make_armed: Callable[..., Bench], scripted: Any
) -> None:
    b = make_armed(ground_detection=0)
    assert b.status.airborne
    fly(b, 100, c0=1600)
    assert seen(scripted, INTEGRAL)[0] > 0.2


def test_the_pilot_is_told_whether_it_has_taken_off(scripted: Any, chip: Callable[..., Any]) -> None:
    field = Field(scripted, chip())
    field.boot()
    assert not field.safety.airborne
    field.arm = 2000
    field.run(100)
    assert (field.safety.state, field.safety.airborne) == (FlightState.ARMED, False)
    field.take_off()
    assert field.safety.airborne
    field.land()
    assert not field.safety.airborne
