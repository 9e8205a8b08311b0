"""crash.c: what is taken for a crash or a runaway, and what of our own flying is not."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sim.scenario import Scenario, load_scenario
from sim.trace import Trace
from toolchain.contract import CRASH_ERROR_DEG_S, CRASH_MS, CRASH_OUTPUT, RUNAWAY_MS, RUNAWAY_WINDOW_MS

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
        core.lib.crash_init(self._crash, settings, rate_hz)
        core.lib.crash_reset(self._crash)

    def step(self, error: float, output: float = FULL, axis: int = 0) -> int:
        errors = [0.0, 0.0, 0.0]
        errors[axis] = error
        return int(self._core.lib.crash_step(self._crash, self._core.new("float[3]", errors), output))

    def verdicts(self, errors: list[float], output: float = FULL, axis: int = 0) -> list[int]:
        return [self.step(error, output, axis) for error in errors]

    def fly(self, ms: int) -> None:
        assert set(self.verdicts([0.0] * ms)) <= {NONE}


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [-1, 1])
def test_a_crash_is_seen_after_its_time_when_the_error_stays(puppet: Any, axis: int, sign: int) -> None:
    watch = Watch(puppet)
    watch.fly(RUNAWAY_WINDOW_MS)
    assert watch.verdicts([sign * OFF] * CRASH_MS, axis=axis) == [NONE] * (CRASH_MS - 1) + [HAPPENED]


@pytest.mark.parametrize("rate_hz", [1000, 4000])
def test_the_time_is_the_same_when_the_control_rate_is_another(puppet: Any, rate_hz: int) -> None:
    watch = Watch(puppet, rate_hz, runaway=0)
    steps = CRASH_MS * rate_hz // 1000
    assert watch.verdicts([OFF] * steps).index(HAPPENED) == steps - 1


def test_a_runaway_is_seen_when_the_error_grows_just_after_arming(puppet: Any) -> None:
    growing = np.linspace(OFF, 2 * OFF, RUNAWAY_MS).tolist()
    assert Watch(puppet).verdicts(growing) == [NONE] * (RUNAWAY_MS - 1) + [RUNAWAY]
    assert set(Watch(puppet).verdicts(growing[::-1])) == {NONE}, "it gets better"
    late = Watch(puppet)
    late.fly(RUNAWAY_WINDOW_MS)
    assert set(late.verdicts(growing)) == {NONE}


@pytest.mark.parametrize(
    ("error", "output"),
    [(math.radians(CRASH_ERROR_DEG_S - 1), FULL), (OFF, CRASH_OUTPUT - 0.01), (0.0, FULL)],
)
def test_nothing_is_seen_when_the_error_is_small_or_motors_have_more_to_give(
    puppet: Any, error: float, output: float
) -> None:
    assert set(Watch(puppet).verdicts([error] * 5000, output)) == {NONE}


def test_the_time_begins_anew_when_one_step_is_good(puppet: Any) -> None:
    watch = Watch(puppet, runaway=0)
    assert set(watch.verdicts([OFF] * (CRASH_MS - 1) + [0.0] + [OFF] * (CRASH_MS - 1))) == {NONE}


def test_nothing_is_seen_when_it_is_switched_off(puppet: Any) -> None:
    growing = np.linspace(OFF, 9 * OFF, 2000).tolist()
    assert set(Watch(puppet, crash=0, runaway=0).verdicts(growing)) == {NONE}
    assert HAPPENED not in Watch(puppet, crash=0).verdicts(growing)
    assert RUNAWAY not in Watch(puppet, runaway=0).verdicts(growing)


def longest(trace: Trace, output: np.ndarray) -> int:
    """The most control steps in a row of a flight that looked like a crash."""
    error = np.abs(np.rad2deg(trace.setpoint - trace.gyro)).max(axis=1)
    beyond = (error > CRASH_ERROR_DEG_S) & (output >= CRASH_OUTPUT)
    run = most = 0
    for step in beyond.tolist():
        run = run + 1 if step else 0
        most = max(most, run)
    return most


@pytest.mark.parametrize(
    ("name", "count"),
    [("roll", 1), ("flip", 1), ("pulses", 2), pytest.param("pulses", 1000, marks=pytest.mark.prove)],
)
def test_our_own_flights_are_far_from_a_crash_when_they_turn_and_flip(
    name: str, count: int, flown_here: Callable[[Scenario], Trace]
) -> None:
    trace = flown_here(load_scenario(name, 3, count))
    worst = longest(trace, trace.motors.max(axis=1))
    print(f"{name}: {worst} ms like a crash, it takes {CRASH_MS} ms, a runaway {RUNAWAY_MS} ms")
    assert worst < RUNAWAY_MS / 2
    assert (trace.dshot > 0).all()


@pytest.fixture
def flown_here(reference_library: Path) -> Callable[[Scenario], Trace]:
    """Flies the shipped policy in a fresh twin of the NF1."""
    from contextlib import closing

    from sim.aircraft import load_aircraft
    from sim.loop import fly
    from sim.reference_port import ReferencePort
    from sim.twin import Twin

    def run(scenario: Scenario) -> Trace:
        port = ReferencePort(reference_library, 1000)
        rng = np.random.default_rng(1)
        twin = Twin(load_aircraft("nf1"), rate_hz=1000, mount=scenario.mount, rng=rng)
        with closing(port), closing(twin):
            return fly(twin, port, scenario)

    return run
