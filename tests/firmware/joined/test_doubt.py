"""The joined core doubts what flies: implausible outputs, a crash, a runaway; each flight begins anew."""

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
    RUNAWAY_WINDOW_MS,
    WRONG_WAY_MS,
    FallbackCause,
    FlightState,
    StopCause,
)

Make = Callable[..., Any]
COUNTS_PER_DEG_S = 32768 / 2000
RIGHT, WRONG = [0.2, 0.2, 0.1, 0.1], [0.1, 0.1, 0.2, 0.2]  # answers to a roll error > 0
ROLL_US = 1700
CYCLE_MS = 30  # in which two frames tell the arm switch


@pytest.fixture
def make_doubted(bench: Make, scripted: Any) -> Make:
    """Makes benches whose PID answers roll errors a little, armed; the scripted policy answers rightly.

    They are in the air as soon as they are armed, unless a test wants it otherwise.
    """

    def make(p: float = 0.005, **settings: float) -> Any:
        scripted.lib.scripted_action = RIGHT
        pid = scripted.new("struct pid_gains *")
        pid.motor_count, pid.period_s, pid.smoothing = 4, 1e-3, 1.0
        pid.p = [p, 0.0, 0.0]
        pid.mixer = [[1.0, 0.0, 0.0]] * 2 + [[-1.0, 0.0, 0.0]] * 2
        b = bench(1000, pid=pid, **{"level_limit_deg": 0, "ground_detection": 0, **settings})
        b.arm()
        return b

    return make


@pytest.fixture
def doubted(make_doubted: Make) -> Any:
    return make_doubted()


def fly(b: Any, ms: int, **sticks: int) -> None:
    b.run(ms, **{"arm": 2000, "throttle": 1400, **sticks})


def again(b: Any) -> None:
    """Disarms and arms."""
    b.run(CYCLE_MS)
    assert b.status.state == FlightState.DISARMED
    b.run(CYCLE_MS, arm=2000)
    assert b.armed


def test_the_pid_takes_over_and_the_motors_stop_when_that_does_not_help(doubted: Any, scripted: Any) -> None:
    fly(doubted, 20, c0=ROLL_US)
    scripted.lib.scripted_action = WRONG
    fly(doubted, WRONG_WAY_MS + 20, c0=ROLL_US)
    assert (doubted.armed, doubted.status.pid_flies, doubted.status.fallback_cause) == (
        True,
        True,
        FallbackCause.WRONG_WAY,
    )
    fly(doubted, NO_RESPONSE_MS - 50, c0=ROLL_US)
    assert doubted.armed
    fly(doubted, 100, c0=ROLL_US)
    assert (doubted.status.state, doubted.status.stop_cause) == (FlightState.CRASHED, StopCause.CRASH)


def test_the_pid_that_takes_over_has_time_when_the_policy_was_helpless(
    make_doubted: Make, scripted: Any
) -> None:
    b = make_doubted(p=0.05)
    scripted.lib.scripted_action = [0.0, 0.0, 0.6, 0.6]
    taken_over = 0
    while not b.status.pid_flies:
        fly(b, 1, c0=2000)
        taken_over += 1
    assert CRASH_MS - taken_over < NO_RESPONSE_MS - 20, "the two would add up to a crash"
    fly(b, NO_RESPONSE_MS - 20, c0=2000)
    assert b.armed
    fly(b, 40, c0=2000)
    assert b.status.stop_cause == StopCause.CRASH


def test_the_pid_that_the_pilot_chose_is_not_doubted(doubted: Any) -> None:
    fly(doubted, 20, **{f"c{CHANNEL_PID}": 2000})
    fly(doubted, 3 * NO_RESPONSE_MS, c0=ROLL_US, **{f"c{CHANNEL_PID}": 2000})
    assert (doubted.status.state, doubted.status.pid_flies) == (FlightState.ARMED, True)


def test_a_policy_is_not_doubted_when_that_is_switched_off(make_doubted: Make, scripted: Any) -> None:
    b = make_doubted(plausibility_detection=0)
    scripted.lib.scripted_action = WRONG
    fly(b, 3 * NO_RESPONSE_MS, c0=ROLL_US)
    assert (b.status.state, b.status.pid_flies) == (FlightState.ARMED, False)


def test_it_flies_on_when_the_pid_that_took_over_oscillates(doubted: Any, scripted: Any) -> None:
    scripted.lib.scripted_action = WRONG
    fly(doubted, WRONG_WAY_MS + 20, c0=ROLL_US)
    assert doubted.status.pid_flies
    size = 3 * OSCILLATION_ERROR_DEG_S * COUNTS_PER_DEG_S
    for ms in range(3000):
        doubted.counts = (round(size * math.sin(math.tau * 16 * ms / 1000)), 0, 0)
        fly(doubted, 1)
    assert (doubted.status.state, doubted.status.pid_flies) == (FlightState.ARMED, True)


def test_it_flies_on_when_the_pid_that_took_over_seems_to_steer_the_wrong_way(
    make_doubted: Make, scripted: Any
) -> None:
    """As it does while its integral unwinds: here its gain has the wrong sign."""
    b = make_doubted(p=-0.005)
    scripted.lib.scripted_action = WRONG
    fly(b, WRONG_WAY_MS + 20, c0=1600)
    assert b.status.pid_flies
    b.counts = (round(100 * COUNTS_PER_DEG_S), 0, 0)
    fly(b, 10 * WRONG_WAY_MS)  # 100 deg/s off: less than what counts as no response
    assert (b.status.state, b.status.pid_flies) == (FlightState.ARMED, True)


def test_the_policy_hands_over_when_it_oscillates(doubted: Any) -> None:
    size = 3 * OSCILLATION_ERROR_DEG_S * COUNTS_PER_DEG_S
    for ms in range(1000):
        doubted.counts = (round(size * math.sin(math.tau * 16 * ms / 1000)), 0, 0)
        fly(doubted, 1)
    assert (doubted.status.pid_flies, doubted.status.fallback_cause) == (True, FallbackCause.OSCILLATION)


def test_implausible_steps_of_one_flight_do_not_count_in_the_next(doubted: Any, scripted: Any) -> None:
    scripted.lib.scripted_action = WRONG
    for _ in range(5):
        doubted.run(WRONG_WAY_MS * 2 // 3, every_ms=1, arm=2000, c0=ROLL_US)
        assert (doubted.armed, doubted.status.pid_flies) == (True, False)
        doubted.run(5, every_ms=1, c0=ROLL_US)
        assert not doubted.armed
    doubted.run(WRONG_WAY_MS + 2, every_ms=1, arm=2000, c0=ROLL_US)
    assert doubted.status.pid_flies


def test_each_flight_has_its_runaway_window(make_doubted: Make) -> None:
    for flights in range(3):
        b = make_doubted(plausibility_detection=0)
        for _ in range(flights):
            fly(b, RUNAWAY_WINDOW_MS + 50)
            again(b)
        for rate in np.linspace(1.1 * CRASH_ERROR_DEG_S, 2 * CRASH_ERROR_DEG_S, RUNAWAY_MS + 20):
            b.counts = (round(rate * COUNTS_PER_DEG_S), 0, 0)
            fly(b, 1)
        assert (b.status.state, b.status.stop_cause) == (FlightState.CRASHED, StopCause.RUNAWAY)


def test_a_flight_that_begins_in_the_step_that_ends_the_one_before_forgets_it(
    make_doubted: Make, frame: Callable[..., bytes]
) -> None:
    b = make_doubted(plausibility_detection=0)
    fly(b, RUNAWAY_WINDOW_MS + 50)
    b.send(2 * frame(arm=1000) + frame(arm=2000))
    b.sample()
    assert b.armed
    for rate in np.linspace(1.1 * CRASH_ERROR_DEG_S, 2 * CRASH_ERROR_DEG_S, RUNAWAY_MS + 20):
        b.counts = (round(rate * COUNTS_PER_DEG_S), 0, 0)
        fly(b, 1)
    assert (b.status.state, b.status.stop_cause) == (FlightState.CRASHED, StopCause.RUNAWAY)
