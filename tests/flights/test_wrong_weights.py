"""Weights that change in memory: no number, one bit, before the flight and in it. Nobody tumbles."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from neuroflight.flash.link import messages
from neuroflight.flash.link.client import Client
from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.flight.loop import fly
from neuroflight.sim.flight.scenario import Scenario, Segment
from neuroflight.sim.flight.trace import Trace
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.ports.library import Reference, ReferencePort
from neuroflight.toolchain.contract import FallbackCause, FlightState, Msp, StopCause
from neuroflight.toolchain.ir.activation_tables import TANH
from tests.flights.weights import Change, ChangedPort, Weights, shipped_table
from tests.sampling import examples

GYRO_RATE_HZ = 4000
CHECK_S = 1.0  # in which the whole table has been compared with flash
TUMBLE_DEG_S, TUMBLE_S = 500.0, 0.1  # so far from the sticks for so long
G = 9.80665
STICKS = Scenario(
    "sticks",
    (
        Segment(0.3, throttle=0.3),
        Segment(0.5, (200.0, -150.0, 100.0), 0.3),
        Segment(0.5, (-150.0, 200.0, -100.0), 0.3),
        Segment(0.7, throttle=0.3),
    ),
)
# First floats of each part of the shipped policy's table: the table of tanh, then three layers.
ROWS = TANH.rows.size
FIRST, SECOND = 56 * (1 + 27), 56 * (1 + 56)
REGIONS = {"tanh": 0, "layer 1": ROWS, "layer 2": ROWS + FIRST, "layer 3": ROWS + FIRST + SECOND}
Flown = tuple[Trace, ChangedPort]
Fly = Callable[[Change, float], Flown]


@pytest.fixture
def fly_struck(reference_library: Path) -> Fly:
    """Flies the sticks; some weights change at a time in flight [s]."""

    def run(change: Change, at_s: float) -> Flown:
        port = ChangedPort(ReferencePort(reference_library, GYRO_RATE_HZ), change, round(at_s * GYRO_RATE_HZ))
        twin = Twin(load_aircraft("nf1"), rate_hz=GYRO_RATE_HZ, rng=np.random.default_rng(7))
        with closing(twin), closing(port):
            return fly(twin, port, STICKS), port

    return run


def tumbles(trace: Trace) -> bool:
    """Whether it is far from its sticks for long while the motors turn."""
    far = (np.rad2deg(np.abs(trace.setpoint - trace.rate)) > TUMBLE_DEG_S).any(axis=1) & (
        trace.dshot > 0
    ).any(axis=1)
    ends = np.flatnonzero(np.diff(np.concatenate([[0], far.astype(int), [0]])))
    return bool((ends[1::2] - ends[::2] > TUMBLE_S * trace.control_rate_hz).any())


@pytest.mark.parametrize("region", REGIONS)
def test_the_pid_takes_over_at_once_when_weights_are_no_numbers(fly_struck: Fly, region: str) -> None:
    def strike(weights: Weights) -> None:
        begin = REGIONS[region]
        weights[begin : begin + 64] = np.nan

    trace, port = fly_struck(strike, 0.6)
    calm, _ = fly_struck(lambda weights: None, 0.6)
    assert port.safety().fallback_cause == FallbackCause.POLICY_OUTPUT
    assert (trace.dshot > 0).all()
    first = int(np.flatnonzero((trace.dshot != calm.dshot).any(axis=1))[0])
    assert first - 600 in (0, 1), "the PID answers in the step whose policy does not"
    assert not tumbles(trace)
    assert np.rad2deg(np.abs(trace.setpoint - trace.rate)[-400:]).mean() < 1


def test_one_nan_weight_is_never_flown(fly_struck: Fly) -> None:
    """Wherever a layer has it: its sum is NaN whatever is observed."""
    for index in np.random.default_rng(3).integers(ROWS, shipped_table().size, examples(48)).tolist():

        def strike(weights: Weights, index: int = index) -> None:
            weights[index] = np.nan

        trace, port = fly_struck(strike, 0.6)
        assert port.safety().fallback_cause == FallbackCause.POLICY_OUTPUT
        assert not tumbles(trace)


@pytest.mark.parametrize("count", [6, pytest.param(2000, marks=pytest.mark.slow)])
def test_nobody_tumbles_when_a_bit_of_a_weight_turns_over(fly_struck: Fly, count: int) -> None:
    rng, ends = np.random.default_rng(17), Counter[str]()
    for number in range(count):
        index, bit = int(rng.integers(shipped_table().size)), int(rng.integers(32))
        at_s = float(rng.uniform(0.0, 0.9))

        def strike(weights: Weights, index: int = index, bit: int = bit) -> None:
            weights.view(np.uint32)[index] ^= np.uint32(1 << bit)

        trace, port = fly_struck(strike, at_s)
        safety, where = port.safety(), f"flip {number}: weight {index}, bit {bit}, {at_s:.3f} s"
        assert not tumbles(trace), where
        assert safety.fallback_cause not in (FallbackCause.NONE, FallbackCause.SWITCH), where
        assert safety.refused_cause == safety.fallback_cause, where
        stopped = (trace.dshot == 0).all(axis=1).any()
        ends["stopped" if stopped else safety.fallback_cause.name] += 1
    print(dict(ends))
    assert ends[FallbackCause.WEIGHTS.name] > 0


def test_the_pid_flies_within_a_second_when_any_weight_changes(fly_struck: Fly) -> None:
    """The last bit of a weight: nothing but the comparison with flash can tell it."""
    calm, _ = fly_struck(lambda weights: None, 0.0)
    size = shipped_table().size
    for index in (0, ROWS, size // 2, size - 1):

        def strike(weights: Weights, index: int = index) -> None:
            weights.view(np.uint32)[index] ^= np.uint32(1)

        trace, port = fly_struck(strike, 0.2)
        assert port.safety().fallback_cause == FallbackCause.WEIGHTS
        late = (trace.dshot != calm.dshot).any(axis=1)[round((0.2 + CHECK_S) * 1000) :]
        assert late.mean() > 0.9, "another controller flies"
        assert (trace.dshot > 0).all()


class Bench:
    """A disarmed library at rest whose weights can be reached; steps are milliseconds."""

    def __init__(self, library: Path) -> None:
        self.port = ChangedPort(ReferencePort(library, 1000), lambda weights: None, -1)
        self.core: Reference = self.port.port.reference
        self.client = Client(self.core)
        self.weights = self.port.weights()
        self.ms, self.arm = 0, 1000

    def run(self, ms: int) -> None:
        for _ in range(ms):
            if self.ms % 10 == 0:
                self.core.receiver([1500, 1500, 1000, 1500, self.arm, *[1000] * 11])
            self.core.sample(np.zeros(3), np.array([0.0, 0.0, G + 0.01 * (self.ms % 2)]))
            self.ms += 1

    @property
    def reasons(self) -> set[str]:
        return set(messages.arming_reasons(self.port.safety().arming_flags))


@pytest.fixture
def bench(reference_library: Path) -> Bench:
    """Booted and ready to arm."""
    bench = Bench(reference_library)
    bench.run(3500)
    assert not bench.reasons
    return bench


def test_weights_are_restored_from_flash_when_they_changed_while_disarmed(bench: Bench) -> None:
    table = bench.weights.copy()
    for index in (0, table.size // 3, table.size - 1):
        bench.weights[index] = np.nan
        bench.run(1000)
        np.testing.assert_array_equal(bench.weights, table)
        assert not bench.reasons
        assert bench.port.safety().policy_good
    bench.arm = 2000
    bench.run(100)
    assert bench.port.safety().state == FlightState.ARMED
    assert bench.port.safety().fallback_cause == FallbackCause.NONE


def test_the_policy_stays_bad_when_flash_has_no_good_weights_either(bench: Bench) -> None:
    def strike(weights: Weights) -> None:
        weights[4000] += 1

    with bench.port.kept_changed(strike):
        bench.run(2000)
        assert bench.reasons == {"POLICY_BAD"}
        bench.arm = 2000
        bench.run(200)
        assert bench.port.safety().state == FlightState.DISARMED


def test_changed_weights_are_restored_after_the_flight_and_fly_again_when_acknowledged(bench: Bench) -> None:
    table = bench.weights.copy()
    bench.arm = 2000
    bench.run(100)
    bench.weights[3000] += 1
    bench.run(1000)
    safety = bench.port.safety()
    assert (safety.state, safety.pid_flies) == (FlightState.ARMED, True)
    assert safety.fallback_cause == safety.refused_cause == FallbackCause.WEIGHTS
    assert (bench.weights != table).any(), "nothing is written while it flies"
    bench.arm = 1000
    bench.run(500)
    np.testing.assert_array_equal(bench.weights, table)
    assert bench.reasons == {"POLICY_REFUSED"}
    assert bench.port.safety().stop_cause == StopCause.SWITCH
    bench.client.request(Msp.ACKNOWLEDGE)
    bench.run(500)
    assert not bench.reasons
