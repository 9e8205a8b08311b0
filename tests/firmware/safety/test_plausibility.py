"""plausibility.c and turning.c: outputs that make no sense, and hard flight that does."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from neuroflight.toolchain.contract import (
    NO_RESPONSE_ERROR_DEG_S,
    NO_RESPONSE_MS,
    OSCILLATION_ERROR_DEG_S,
    OSCILLATION_HALF_MS,
    OSCILLATION_MOTORS,
    OSCILLATION_MOTORS_BY_ERROR,
    OSCILLATION_MOTORS_MS,
    OSCILLATION_SWINGS,
    TURNING_DEG_S2,
    TURNING_LIMIT_DEG_S,
    WRONG_WAY_DEG,
    WRONG_WAY_ERROR_DEG_S,
    WRONG_WAY_MS,
    WRONG_WAY_TAKEOFF_DEG,
    FallbackCause,
)

NONE, WRONG_WAY = FallbackCause.NONE, FallbackCause.WRONG_WAY
NO_RESPONSE, OSCILLATION = FallbackCause.NO_RESPONSE, FallbackCause.OSCILLATION
MOTORS = 4  # of the scripted policy
SETTLE_MS = 60  # of the low-passes that tell how fast a rate changes


class Turning:
    """turning.c, one call a control step."""

    def __init__(self, core: Any, rate_hz: int = 1000) -> None:
        self._core, self.state = core, core.new("struct turning *")
        core.lib.turning_init(self.state, rate_hz)
        core.lib.turning_reset(self.state)

    def step(self, *rates_deg_s: float) -> None:
        rates = [math.radians(rate) for rate in rates_deg_s]
        self._core.lib.turning_step(self.state, self._core.new("float[3]", rates))

    def towards(self, axis: int, error: float) -> bool:
        return bool(self._core.lib.turning_towards(self.state, axis, error))


class Watch:
    """A monitor of its own; in degrees and seconds, one axis at a time."""

    def __init__(self, core: Any, axis: int = 0, sign: int = 1, rate_hz: int = 1000) -> None:
        self._core, self.axis, self.sign = core, axis, sign
        self.blind = False  # no mixer is known
        self._turning = Turning(core, rate_hz)
        self._monitor = core.new("struct plausibility *")
        core.lib.plausibility_init(self._monitor, rate_hz)
        core.lib.plausibility_reset(self._monitor)

    def step(
        self,
        asked: float,
        rate: float,
        demand: float,
        *,
        thrust: bool = True,
        beside: float = 0.0,
        room: float = 0.0,
        room_beside: float = 0.0,
        moved: float = 0.0,
        standing: bool = False,
    ) -> FallbackCause:
        """One control step; `beside`: the error of the next axis, which is answered; `room`: of the axis.

        moved: by all motors together.
        """
        rates, wanted, given = [0.0] * 3, [0.0] * 3, [0.0] * 3
        rates[self.axis], wanted[self.axis] = self.sign * rate, math.radians(self.sign * asked)
        given[self.axis] = self.sign * demand
        wanted[(self.axis + 1) % 3] = given[(self.axis + 1) % 3] = math.radians(beside)
        self._turning.step(*rates)
        turned = [math.radians(value) for value in rates]
        floats = [self._core.new("float[3]", values) for values in (wanted, turned, given)]
        if self.blind:
            floats[2] = self._core.ffi.NULL
        rooms = [0.0] * 3
        rooms[self.axis] = math.radians(room)
        rooms[(self.axis + 1) % 3] = math.radians(room_beside)
        floats.append(self._core.new("float[3]", rooms))
        members = (*floats[:3], self._turning.state, floats[3], moved, standing, thrust)
        seen = self._core.new("struct plausibility_input *", members)
        return FallbackCause(self._core.lib.plausibility_step(self._monitor, seen))

    def reset(self) -> None:
        """Another flight begins."""
        self._core.lib.plausibility_reset(self._monitor)

    def first(
        self, ms: int, asked: float, rate: float, demand: float, **more: Any
    ) -> tuple[int, FallbackCause]:
        """Steps until something is found, and what; (ms, NONE) if nothing is."""
        for step in range(1, ms + 1):
            if found := self.step(asked, rate, demand, **more):
                return step, found
        return ms, NONE


axes = pytest.mark.parametrize("axis", range(3))
signs = pytest.mark.parametrize("sign", [-1, 1])


@pytest.mark.parametrize("rate_hz", [1000, 4000])
@signs
def test_an_axis_turns_towards_its_setpoint_when_its_rate_grows_fast_enough(
    scripted: Any, rate_hz: int, sign: int
) -> None:
    for share, turns in ((1.15, True), (0.85, False), (-2.0, False)):
        turning = Turning(scripted, rate_hz)
        for step in range(rate_hz * SETTLE_MS // 1000):
            turning.step(0.0, 100 + sign * share * TURNING_DEG_S2 * step / rate_hz, 0.0)
        assert turning.towards(1, sign * 5.0) is turns
        assert not turning.towards(0, 5.0), "another axis"
        assert turning.towards(1, -sign * 5.0) is (share < 0), "seen from the other side"


def test_an_axis_does_not_turn_when_a_flight_begins_at_another_rate(scripted: Any) -> None:
    turning = Turning(scripted)
    for _ in range(SETTLE_MS):
        turning.step(0.0, 0.0, 0.0)
    scripted.lib.turning_reset(turning.state)
    turning.step(500.0, -500.0, 0.0)
    assert not any(turning.towards(axis, error) for axis in range(3) for error in (-1.0, 1.0))


def test_an_axis_does_not_turn_when_its_rate_stands_whatever_it_is(scripted: Any) -> None:
    turning = Turning(scripted)
    for _ in range(SETTLE_MS):
        turning.step(500.0, -500.0, 0.0)
        assert not any(turning.towards(axis, error) for axis in range(3) for error in (-1.0, 1.0))


@axes
@signs
def test_outputs_that_do_not_answer_are_told_after_their_time(scripted: Any, axis: int, sign: int) -> None:
    error = WRONG_WAY_ERROR_DEG_S + 1
    assert Watch(scripted, axis, sign).first(500, error, 0.0, -0.1) == (WRONG_WAY_MS, WRONG_WAY)
    assert Watch(scripted, axis, sign).first(500, 5 * error, 0.0, -0.1) == (WRONG_WAY_MS, WRONG_WAY), (
        "no angle counts while the error does not grow"
    )
    assert Watch(scripted, axis, sign).first(500, error, 0.0, 0.1, thrust=False) == (500, NONE), "they answer"
    assert Watch(scripted, axis, sign).first(500, error, 0.0, 0.0) == (WRONG_WAY_MS, WRONG_WAY), "no answer"
    watch = Watch(scripted, axis, sign)
    watch.blind = True
    assert watch.first(500, error, 0.0, -0.1) == (500, NONE)
    assert Watch(scripted, axis, sign).first(500, error - 2, 0.0, -0.1) == (500, NONE), "a small error"
    watch = Watch(scripted, axis, sign)
    for _ in range(10):
        assert watch.first(WRONG_WAY_MS - 1, error, 0.0, -0.1)[1] == NONE
        assert watch.step(error, 0.0, 0.1) == NONE, "and the time begins anew"


@pytest.mark.parametrize("rate_hz", [1000, 2000, 4000])
def test_the_times_and_the_angle_are_the_same_when_the_control_rate_is_another(
    scripted: Any, rate_hz: int
) -> None:
    steps_ms = rate_hz // 1000
    error = WRONG_WAY_ERROR_DEG_S + 1
    found = Watch(scripted, rate_hz=rate_hz).first(500 * steps_ms, error, 0.0, -0.1)
    assert found == (WRONG_WAY_MS * steps_ms, WRONG_WAY)
    error = NO_RESPONSE_ERROR_DEG_S + 1
    found = Watch(scripted, rate_hz=rate_hz).first(900 * steps_ms, error, 0.0, 0.3)
    assert found == (NO_RESPONSE_MS * steps_ms, NO_RESPONSE)
    watch, rate, astray = Watch(scripted, rate_hz=rate_hz), -WRONG_WAY_ERROR_DEG_S, 0.0
    while astray < 2 * WRONG_WAY_DEG and not watch.step(0.0, rate, -0.5):
        rate -= 5000.0 / rate_hz
        astray -= rate / rate_hz
    assert WRONG_WAY_DEG < astray < WRONG_WAY_DEG + 0.02 * WRONG_WAY_ERROR_DEG_S
    watch, hz = Watch(scripted, rate_hz=rate_hz), 16.0
    times = np.arange(2 * rate_hz) / rate_hz
    swing = (3 * OSCILLATION_ERROR_DEG_S * np.sin(math.tau * hz * times)).tolist()
    told = [watch.step(0.0, each, 0.0) for each in swing].index(OSCILLATION) / rate_hz
    assert OSCILLATION_SWINGS - 1 <= told * 2 * hz <= OSCILLATION_SWINGS + 1


def test_outputs_that_brake_are_plausible_while_the_rate_nears_its_setpoint(scripted: Any) -> None:
    watch = Watch(scripted)
    for step in range(500):
        assert watch.step(1500.0, 2 * step, -1.0) == NONE


def test_an_axis_beside_a_much_larger_error_may_stray(scripted: Any) -> None:
    error = WRONG_WAY_ERROR_DEG_S + 1
    assert Watch(scripted).first(500, error, 0.0, -0.1, beside=2.1 * error, thrust=False) == (500, NONE)
    assert Watch(scripted).first(500, error, 0.0, -0.1, beside=1.9 * error, thrust=False)[1] == WRONG_WAY


@axes
@signs
def test_an_axis_that_its_outputs_turn_away_is_told_by_its_angle(scripted: Any, axis: int, sign: int) -> None:
    """Ever faster from rest: long before the time that a steady error takes."""
    cases = (
        (5000.0, False, WRONG_WAY_DEG),
        (5000.0, True, WRONG_WAY_TAKEOFF_DEG),
        (0.9 * TURNING_DEG_S2, False, None),
    )
    for growth, standing, angle in cases:
        watch, rate, astray = Watch(scripted, axis, sign), -WRONG_WAY_ERROR_DEG_S, 0.0
        found = NONE
        steps = 0
        while not found and steps < WRONG_WAY_MS - 1:
            rate -= growth / 1000
            astray -= rate / 1000
            found, steps = watch.step(0.0, rate, -0.5, standing=standing), steps + 1
        assert (found == WRONG_WAY) is (angle is not None)
        if angle is not None:  # the low-passes take some milliseconds to see that it grows
            assert angle < astray < angle + 0.02 * WRONG_WAY_ERROR_DEG_S
            assert steps < WRONG_WAY_MS / 2


def test_the_angle_is_forgotten_when_the_outputs_answer_for_a_step(scripted: Any) -> None:
    watch, rate = Watch(scripted), -WRONG_WAY_ERROR_DEG_S
    for step in range(400):
        rate -= 5.0
        assert watch.step(0.0, rate, 0.5 if step % 10 == 0 and step else -0.5) == NONE or rate < -600
        if rate < -600:
            break


@axes
@signs
def test_an_axis_that_does_not_turn_is_told_after_its_time(scripted: Any, axis: int, sign: int) -> None:
    error = NO_RESPONSE_ERROR_DEG_S + 1
    assert Watch(scripted, axis, sign).first(900, error, 0.0, 0.3) == (NO_RESPONSE_MS, NO_RESPONSE)
    assert Watch(scripted, axis, sign).first(900, error - 2, 0.0, 0.3) == (900, NONE)
    assert Watch(scripted, axis, sign).first(900, error, 0.0, 0.3, thrust=False) == (900, NONE), (
        "on the ground"
    )
    fast = TURNING_LIMIT_DEG_S + 1
    assert Watch(scripted, axis, sign).first(900, error + fast, fast, 0.3) == (900, NONE), "at its limit"
    assert Watch(scripted, axis, sign).first(900, 0.0, -error, 0.3)[1] == NO_RESPONSE, (
        "it spins, nobody asked"
    )


@axes
@pytest.mark.parametrize("hz", [10.0, 16.0, 30.0])
def test_an_oscillation_is_told_after_so_many_swings(scripted: Any, axis: int, hz: float) -> None:
    watch = Watch(scripted, axis)
    size = 3 * OSCILLATION_ERROR_DEG_S
    found = [watch.step(0.0, size * math.sin(math.tau * hz * ms / 1000), 0.0) for ms in range(2000)]
    assert OSCILLATION in found
    swings = found.index(OSCILLATION) / 1000 * 2 * hz
    assert OSCILLATION_SWINGS - 1 <= swings <= OSCILLATION_SWINGS + 1


@axes
def test_an_oscillation_is_told_from_a_chirps_when_it_is_larger(scripted: Any, axis: int) -> None:
    for size, told in ((0.8, False), (1.5, True)):
        watch = Watch(scripted, axis)
        error = size * (OSCILLATION_ERROR_DEG_S + 100.0)
        swing = [error * math.sin(math.tau * 12 * ms / 1000) for ms in range(2000)]
        assert (OSCILLATION in [watch.step(0.0, each, 0.0, room=100.0) for each in swing]) is told
    beside = Watch(scripted, axis)
    swing = [3 * OSCILLATION_ERROR_DEG_S * math.sin(math.tau * 12 * ms / 1000) for ms in range(2000)]
    assert OSCILLATION in [beside.step(0.0, each, 0.0, room_beside=100.0) for each in swing]


@pytest.mark.parametrize("rate_hz", [1000, 2000, 4000])
def test_motors_that_swing_for_long_are_told_when_the_body_does_not_follow(
    scripted: Any, rate_hz: int
) -> None:
    """However many control steps a millisecond has; a lasting swing below the bar never is."""
    for share, told in ((0.95, False), (1.5, True), (4.0, True)):
        watch, a_ms = Watch(scripted, rate_hz=rate_hz), share * OSCILLATION_MOTORS
        a_step = MOTORS * a_ms * 1000 / rate_hz
        found = [watch.step(0.0, 0.0, 0.0, moved=a_step) for _ in range(2 * rate_hz)]
        assert (OSCILLATION in found) is told
        if told:  # as a low-pass of that time constant reaches the bar
            reached_ms = -OSCILLATION_MOTORS_MS * math.log(1 - 1 / share)
            assert found.index(OSCILLATION) * 1000 / rate_hz == pytest.approx(reached_ms, abs=2)


@pytest.mark.parametrize("shakes", [False, True], ids=["setpoint", "gyro"])
def test_motors_that_follow_a_moving_error_are_no_oscillation(scripted: Any, shakes: bool) -> None:
    """Of a chirp at 100 Hz, or a bent propeller: what its moves explain, and what the bar allows."""
    swing = 0.8 * OSCILLATION_ERROR_DEG_S
    moves = MOTORS * OSCILLATION_MOTORS_BY_ERROR * math.radians(2 * swing)  # each time that it changes sides
    for share, told in ((0.9, False), (1.5, True)):
        watch = Watch(scripted)
        found = set()
        for ms in range(2000):
            error = swing if ms // 5 % 2 else -swing
            moved = share * MOTORS * OSCILLATION_MOTORS + (moves if ms % 5 == 0 else 0.0)
            asked, rate = (0.0, -error) if shakes else (error, 0.0)
            found.add(watch.step(asked, rate, error, moved=moved))
        assert (OSCILLATION in found) is told


def test_a_stick_that_throws_all_motors_from_end_to_end_is_no_oscillation(scripted: Any) -> None:
    watch = Watch(scripted)
    for _ in range(10):  # into a turn and out of it, four times through the whole range, then 0.5 s of it
        throw = [MOTORS / 20.0] * 80 + [0.0] * 500
        assert {watch.step(0.0, 0.0, 0.0, moved=moved) for moved in throw} == {NONE}


def test_nothing_of_a_flight_counts_in_the_next(scripted: Any) -> None:
    """Neither swings nor times nor angles."""
    size, hz = 3 * OSCILLATION_ERROR_DEG_S, 16.0
    period_ms = round(1000 * (OSCILLATION_SWINGS - 3) / 2 / hz)
    watch = Watch(scripted)
    for _ in range(4):
        found = {watch.step(0.0, size * math.sin(math.tau * hz * ms / 1000), 0.0) for ms in range(period_ms)}
        assert found == {NONE}
        watch.reset()
    for _ in range(4):
        assert watch.first(150, 0.0, 0.0, 0.0, moved=MOTORS * 1.5 * OSCILLATION_MOTORS)[1] == NONE
        watch.reset()
    for _ in range(4):
        assert watch.first(WRONG_WAY_MS - 1, WRONG_WAY_ERROR_DEG_S + 1, 0.0, -0.1)[1] == NONE
        watch.reset()
    for _ in range(4):
        assert watch.first(NO_RESPONSE_MS - 1, NO_RESPONSE_ERROR_DEG_S + 1, 0.0, 0.3)[1] == NONE
        watch.reset()


@pytest.mark.parametrize(
    ("hz", "size"), [(7.0, 50.0), (16.0, 0.9 * OSCILLATION_ERROR_DEG_S), (300.0, 50.0), (1.0, 50.0)]
)
def test_what_a_stick_or_noise_can_do_is_no_oscillation(scripted: Any, hz: float, size: float) -> None:
    """7 Hz: no pilot stirs so fast. 300 Hz: noise, which the low-pass removes."""
    assert 500 / hz > OSCILLATION_HALF_MS or size < OSCILLATION_ERROR_DEG_S or hz > 200
    watch = Watch(scripted)
    assert {watch.step(0.0, size * math.sin(math.tau * hz * ms / 1000), 0.0) for ms in range(5000)} == {NONE}


def test_noise_of_three_times_the_gyros_is_plausible(scripted: Any) -> None:
    rng, watch = np.random.default_rng(4), Watch(scripted)
    for noise in rng.normal(0, 6.0, 20_000).tolist():
        assert watch.step(0.0, noise, -0.01 * noise) == NONE
