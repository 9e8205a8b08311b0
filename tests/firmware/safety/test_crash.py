"""crash.c: what counts as a crash or a runaway, and normal flight that does not."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from neuroflight.sim.flight.scenario import Scenario, load_scenario
from neuroflight.sim.flight.trace import Trace
from neuroflight.toolchain.contract import (
    CRASH_ERROR_DEG_S,
    CRASH_MS,
    CRASH_SPREAD,
    RUNAWAY_MS,
    RUNAWAY_WINDOW_MS,
    TURNING_DEG_S2,
    TURNING_LIMIT_DEG_S,
)

NONE, HAPPENED, RUNAWAY = range(3)
OFF = math.radians(CRASH_ERROR_DEG_S + 1)
FULL = 1.0


class Watch:
    """A detector of its own."""

    def __init__(self, core: Any, rate_hz: int = 1000, *, crash: int = 1, runaway: int = 1) -> None:
        settings = core.new("struct nf_settings *")
        core.lib.settings_default(settings)
        settings.crash_detection, settings.runaway_detection = crash, runaway
        self._core, self._crash = core, core.new("struct crash *")
        self._turning = core.new("struct turning *")
        self.airborne = self.thrust = True
        core.lib.crash_init(self._crash, settings, rate_hz)
        core.lib.crash_reset(self._crash)
        core.lib.turning_init(self._turning, rate_hz)
        core.lib.turning_reset(self._turning)

    def reset(self) -> None:
        """Another flight begins."""
        self._core.lib.crash_reset(self._crash)
        self._core.lib.turning_reset(self._turning)

    def relieve(self) -> None:
        """Another controller takes over."""
        self._core.lib.crash_relieve(self._crash)

    def step(self, setpoint: float, rate: float, spread: float = FULL, axis: int = 0) -> int:
        setpoints, rates = [0.0] * 3, [0.0] * 3
        setpoints[axis], rates[axis] = setpoint, rate
        return self.turned(setpoints, rates, spread)

    def turned(self, setpoints: list[float], rates: list[float], spread: float = FULL) -> int:
        asked, turned = (self._core.new("float[3]", values) for values in (setpoints, rates))
        self._core.lib.turning_step(self._turning, turned)
        seen = (asked, turned, self._turning, spread, self.airborne, self.thrust)
        return int(self._core.lib.crash_step(self._crash, self._core.new("struct crash_input *", seen)))

    def held(self, steps: int, error: float = OFF, spread: float = FULL, axis: int = 0) -> list[int]:
        """An aircraft that does not turn at all, whatever is asked for."""
        return [self.step(error, 0.0, spread, axis) for _ in range(steps)]

    def spun(self, rates: list[float], axis: int = 0) -> list[int]:
        """An aircraft that turns like this while nobody asks for it, and whose controller hardly answers."""
        return [self.step(0.0, rate, 0.0, axis) for rate in rates]

    def fly(self, ms: int) -> None:
        assert set(self.held(ms, error=0.0)) <= {NONE}


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [-1, 1])
def test_a_crash_is_seen_after_its_time_when_the_error_stays(scripted: Any, axis: int, sign: int) -> None:
    watch = Watch(scripted)
    assert watch.held(CRASH_MS, sign * OFF, axis=axis) == [NONE] * (CRASH_MS - 1) + [HAPPENED]


@pytest.mark.parametrize("rate_hz", [1000, 4000])
def test_the_time_is_the_same_when_the_control_rate_is_another(scripted: Any, rate_hz: int) -> None:
    steps = CRASH_MS * rate_hz // 1000
    assert Watch(scripted, rate_hz).held(steps).index(HAPPENED) == steps - 1
    growing = np.linspace(OFF, 2 * OFF, steps).tolist()
    assert Watch(scripted, rate_hz).spun(growing).index(RUNAWAY) == RUNAWAY_MS * rate_hz // 1000 - 1


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [-1, 1])
def test_a_runaway_is_seen_when_it_turns_away_ever_faster_just_after_arming(
    scripted: Any, axis: int, sign: int
) -> None:
    growing = (sign * np.linspace(OFF, 2 * OFF, RUNAWAY_MS)).tolist()
    assert Watch(scripted).spun(growing, axis) == [NONE] * (RUNAWAY_MS - 1) + [RUNAWAY]
    assert set(Watch(scripted).spun(growing[::-1], axis)) == {NONE}, "it gets better"
    late = Watch(scripted)
    late.fly(RUNAWAY_WINDOW_MS)
    assert set(late.spun(growing, axis)) == {NONE}


def test_the_runaway_window_begins_with_the_first_throttle_in_the_air(scripted: Any) -> None:
    growing = np.linspace(OFF, 2 * OFF, RUNAWAY_MS).tolist()
    watch = Watch(scripted)
    watch.thrust = False
    watch.fly(5 * RUNAWAY_WINDOW_MS)
    assert watch.spun(growing)[-1] == RUNAWAY, "it waits for the throttle"
    watch.thrust = True
    watch.fly(RUNAWAY_WINDOW_MS // 2)
    watch.thrust = False
    watch.fly(RUNAWAY_WINDOW_MS // 2)
    assert set(watch.spun(growing)) == {NONE}, "and runs on when the throttle is closed again"


def test_nothing_is_a_crash_on_the_ground(scripted: Any) -> None:
    watch = Watch(scripted)
    watch.airborne = watch.thrust = False
    assert set(watch.held(20 * CRASH_MS)) == {NONE}
    watch.airborne = watch.thrust = True
    assert watch.held(CRASH_MS) == [NONE] * (CRASH_MS - 1) + [HAPPENED], "what was before does not count"


def test_nothing_of_a_flight_counts_in_the_next(scripted: Any) -> None:
    growing = np.linspace(OFF, 2 * OFF, RUNAWAY_MS).tolist()
    watch = Watch(scripted)
    watch.fly(2 * RUNAWAY_WINDOW_MS)
    watch.reset()
    assert watch.spun(growing)[-1] == RUNAWAY, "it has a window of its own"
    watch.reset()
    assert set(watch.spun(growing[:-1])) == {NONE}
    watch.reset()
    assert set(watch.spun([2.1 * OFF])) == {NONE}
    assert set(watch.held(CRASH_MS - 1)) == {NONE}
    watch.reset()
    assert set(watch.held(CRASH_MS - 1)) == {NONE}


def test_what_the_controller_before_could_not_correct_does_not_count(scripted: Any) -> None:
    watch = Watch(scripted)
    assert set(watch.held(CRASH_MS - 1)) == {NONE}
    watch.relieve()
    assert set(watch.held(CRASH_MS - 1)) == {NONE}
    assert watch.held(1) == [HAPPENED]
    growing = np.linspace(OFF, 2 * OFF, RUNAWAY_MS).tolist()
    watch = Watch(scripted)
    assert set(watch.spun(growing[:-1])) == {NONE}
    watch.relieve()
    assert set(watch.spun(growing[1:])) == {NONE}


def test_no_crash_is_seen_while_the_axis_turns_towards_its_setpoint(scripted: Any) -> None:
    far = math.radians(1900)
    slow = math.radians(TURNING_DEG_S2) / 1000  # rad/s a step
    for share, verdicts in ((1.5, {NONE}), (0.5, {NONE, HAPPENED})):
        for sign in (1, -1):
            watch = Watch(scripted)
            rates = [sign * share * slow * step for step in range(4 * CRASH_MS)]
            assert math.degrees(abs(rates[-1])) < 2 * TURNING_LIMIT_DEG_S * share
            limit = math.radians(TURNING_LIMIT_DEG_S)
            seen = [watch.step(sign * far, rate) for rate in rates if abs(rate) < limit]
            assert set(seen) == verdicts


@pytest.mark.parametrize("sign", [-1, 1])
def test_no_crash_is_seen_when_the_axis_turns_as_fast_as_it_can(scripted: Any, sign: int) -> None:
    asked, limit = sign * math.radians(1900), sign * math.radians(TURNING_LIMIT_DEG_S)
    watch = Watch(scripted)
    assert {watch.step(asked, 1.01 * limit) for _ in range(5000)} == {NONE}
    for rate in (0.99 * limit, -2 * limit):
        watch = Watch(scripted)
        assert HAPPENED in [watch.step(asked, rate) for _ in range(CRASH_MS + 1)], "blocked, or turning away"


def test_a_runaway_about_a_diagonal_is_seen_although_its_largest_axis_changes(scripted: Any) -> None:
    ahead = np.linspace(OFF, 2 * OFF, RUNAWAY_MS).tolist()
    overtakes = np.linspace(0.8 * OFF, 2.4 * OFF, RUNAWAY_MS).tolist()
    watch = Watch(scripted)
    seen = [watch.turned([0.0] * 3, [one, 0.0, -other]) for one, other in zip(ahead, overtakes, strict=True)]
    assert seen == [NONE] * (RUNAWAY_MS - 1) + [RUNAWAY]


def test_no_runaway_is_seen_when_the_axis_changes_or_it_turns_to_where_it_should(scripted: Any) -> None:
    growing = np.linspace(OFF, 2 * OFF, RUNAWAY_MS - 1).tolist()
    watch = Watch(scripted)
    assert set(watch.spun(growing, 0) + watch.spun(growing, 1)) == {NONE}
    watch = Watch(scripted)
    asked = [watch.step(4 * OFF, rate, 0.0) for rate in np.linspace(OFF, 2 * OFF, 3 * RUNAWAY_MS).tolist()]
    assert set(asked) == {NONE}


@pytest.mark.parametrize("sign", [-1, 1])
def test_no_runaway_is_seen_when_the_axis_turns_back_in_time(scripted: Any, sign: int) -> None:
    growing = np.linspace(OFF, 1.1 * OFF, 20)
    back = growing[-1] - math.radians(1) * np.arange(1, RUNAWAY_MS)
    rates = sign * np.concatenate([growing, back[back > OFF]])
    assert len(rates) > RUNAWAY_MS, "it is large for longer than a runaway takes, and larger than at first"
    assert set(Watch(scripted).spun(rates.tolist())) == {NONE}


@pytest.mark.parametrize(
    ("error", "spread"),
    [(math.radians(CRASH_ERROR_DEG_S - 1), FULL), (OFF, CRASH_SPREAD - 0.01), (0.0, FULL)],
)
def test_no_crash_is_seen_when_the_error_is_small_or_the_controller_does_little(
    scripted: Any, error: float, spread: float
) -> None:
    assert set(Watch(scripted).held(5000, error, spread)) == {NONE}


def test_the_time_begins_anew_when_one_step_is_good(scripted: Any) -> None:
    watch = Watch(scripted)
    assert set(watch.held(CRASH_MS - 1) + watch.held(1, 0.0) + watch.held(CRASH_MS - 1)) == {NONE}


def test_the_time_begins_anew_when_the_controller_does_little_for_a_step(scripted: Any) -> None:
    watch = Watch(scripted)
    seen = watch.held(CRASH_MS - 1) + watch.held(1, spread=CRASH_SPREAD - 0.01) + watch.held(CRASH_MS)
    assert seen == [NONE] * (2 * CRASH_MS - 1) + [HAPPENED]


def test_nothing_is_seen_when_it_is_switched_off(scripted: Any) -> None:
    growing = np.linspace(OFF, 9 * OFF, 900).tolist()
    assert set(Watch(scripted, crash=0).held(2000)) == {NONE}
    assert set(Watch(scripted, runaway=0).spun(growing)) == {NONE}


@pytest.mark.parametrize("pid", [False, True], ids=["policy", "pid"])
@pytest.mark.parametrize(
    ("name", "count"),
    [("roll", 1), ("flip", 1), ("pulses", 2), pytest.param("pulses", 1000, marks=pytest.mark.slow)],
)
def test_our_own_flights_are_far_from_a_crash_when_they_turn_and_flip(
    name: str, count: int, pid: bool, flown_here: Callable[[Scenario], Trace]
) -> None:
    scenario = load_scenario(name, 3, count)
    segments = tuple(replace(segment, pid=pid) for segment in scenario.segments)
    trace = flown_here(replace(scenario, segments=segments))
    error = np.abs(np.rad2deg(trace.setpoint - trace.gyro)).max(axis=1)
    runs = np.split(error > CRASH_ERROR_DEG_S, np.flatnonzero(np.diff(error > CRASH_ERROR_DEG_S)) + 1)
    worst = max(len(run) if run[0] else 0 for run in runs)
    print(f"{name}: {worst} ms far off, a crash takes {CRASH_MS} ms")
    assert worst < CRASH_MS / 2
    assert (trace.dshot > 0).all()


@pytest.fixture
def flown_here(reference_library: Path) -> Callable[[Scenario], Trace]:
    """Flies the shipped policy in a fresh twin of the NF1."""
    from contextlib import closing

    from neuroflight.sim.aircraft.model import load_aircraft
    from neuroflight.sim.flight.loop import fly
    from neuroflight.sim.physics.twin import Twin
    from neuroflight.sim.ports.library import ReferencePort

    def run(scenario: Scenario) -> Trace:
        port = ReferencePort(reference_library, 1000)
        rng = np.random.default_rng(1)
        twin = Twin(load_aircraft("nf1"), rate_hz=1000, mount=scenario.mount, rng=rng)
        with closing(port), closing(twin):
            return fly(twin, port, scenario)

    return run
