"""Wrong policies in flight are told, and the PID takes over; right ones are left alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import replace
from itertools import accumulate
from pathlib import Path

import numpy as np
import pytest

from neuroflight.flash.link import records
from neuroflight.flash.link.client import Client
from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.flight.loop import fly
from neuroflight.sim.flight.scenario import Scenario, Segment, load_scenario, pulses
from neuroflight.sim.flight.trace import Trace
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.physics.variation import Variation
from neuroflight.sim.ports.library import ReferencePort
from neuroflight.toolchain.contract import (
    OSCILLATION_MOTORS,
    OSCILLATION_MOTORS_BY_ERROR,
    RECEIVER_HOLD_MS,
    FallbackCause,
    Mode,
    ModeRange,
    Msp,
    StopCause,
)
from neuroflight.toolchain.contract.observation import Width
from neuroflight.training.evaluation.robustness import EXTREMES
from tests.flights.weights import Change, ChangedPort, Weights, shipped
from tests.flights.wiring import drifting
from tests.sampling import sampled

GYRO_RATE_HZ = 4000
TRAINED_DELAY_S = 0.0055  # the longest in the recipe of the shipped policy
UNWOUND_DEG_S = 1.5  # error that is left seconds after the PID took over: its I of roll and pitch is small
ALONE, TAKEN_OVER = FallbackCause.NONE, frozenset({FallbackCause.WRONG_WAY, FallbackCause.NO_RESPONSE})
Fly = Callable[..., tuple[Trace, ChangedPort]]


def last_layer(weights: Weights) -> Weights:
    """Its biases, then a row of each input."""
    units, motors = shipped().network.widths[-3], shipped().network.outputs
    return weights[-(1 + units) * motors :].reshape(1 + units, motors)


def first_layer(weights: Weights) -> Weights:
    """Blocks of eight units: their biases, then a row of each input."""
    inputs, units = shipped().network.widths[:2]
    tables = (call.table for call in shipped().plan.calls if call.kernel == "linear8")
    begin = next(table for table in tables if table is not None)
    return weights[begin : begin + units * (1 + inputs)].reshape(units // 8, 1 + inputs, 8)


def observed(axis: int) -> list[int]:
    """Which inputs tell of an axis."""
    policy = shipped().policy
    widths = [term.count(policy.action_count) for term in policy.blocks]
    begins = accumulate(widths, initial=0)
    axes = [term.block.width is Width.AXES for term in policy.blocks]
    return [begin + axis for begin, told in zip(begins, axes, strict=False) if told]


def swapped(one: int, other: int) -> Change:
    """Two motors' outputs for each other."""

    def change(weights: Weights) -> None:
        layer = last_layer(weights)
        layer[:, [one, other]] = layer[:, [other, one]]

    return change


def mirrored(axis: int) -> Change:
    """All that is observed of an axis with the wrong sign."""

    def change(weights: Weights) -> None:
        first_layer(weights)[:, [1 + column for column in observed(axis)]] *= -1

    return change


def frozen(weights: Weights) -> None:
    """Outputs that nothing moves."""
    last_layer(weights)[1:] = 0
    last_layer(weights)[0] = 0.05


def twice_as_much(weights: Weights) -> None:
    """A gain error of 100 %; half of it makes no oscillation."""
    last_layer(weights)[:] *= 2


def unchanged(weights: Weights) -> None:
    """The shipped policy."""


@pytest.fixture
def fly_changed(reference_library: Path) -> Fly:
    """Flies a policy that is changed in flight; returns the trace, and the port to be asked."""

    def run(
        scenario: Scenario,
        change: Change = unchanged,
        *,
        at_s: float = 0.0,
        seed: int = 1,
        variation: Variation | None = None,
        settings: Mapping[str, float] | None = None,
    ) -> tuple[Trace, ChangedPort]:
        inner = ReferencePort(reference_library, GYRO_RATE_HZ, settings)
        port = ChangedPort(inner, change, round(at_s * GYRO_RATE_HZ), hidden=True)
        rng = np.random.default_rng((seed, 1))
        aircraft = load_aircraft("nf1")
        twin = Twin(aircraft, rate_hz=GYRO_RATE_HZ, mount=scenario.mount, rng=rng, variation=variation)
        with closing(twin), closing(port):
            return fly(twin, port, scenario), port

    return run


def drawn(seed: int) -> Variation:
    """An NF1 whose parameters are drawn from the ranges of the robustness table."""
    rng = np.random.default_rng((77, seed))
    return replace(EXTREMES, charge=None).draw(1, rng, 0.0)


def tail_error_deg_s(trace: Trace) -> float:
    """Mean absolute error of the last 1.5 s."""
    return float(np.rad2deg(np.abs(trace.setpoint - trace.rate)[-1500:]).mean())


@pytest.mark.parametrize("at_s", sampled([0.0, 0.7], 0.7), ids=["from the start", "in flight"])
@pytest.mark.parametrize(
    ("change", "causes"),
    [
        (swapped(0, 1), TAKEN_OVER),
        (swapped(1, 2), TAKEN_OVER),
        (swapped(0, 3), TAKEN_OVER),
        (mirrored(0), TAKEN_OVER),
        (mirrored(1), TAKEN_OVER),
        (mirrored(2), TAKEN_OVER),
        (frozen, TAKEN_OVER),
        (twice_as_much, {FallbackCause.OSCILLATION}),
    ],
    ids=["swap 1 2", "swap 2 3", "swap 1 4", "roll sign", "pitch sign", "yaw sign", "frozen", "gain 2"],
)
def test_a_wrong_policy_is_told_and_the_pid_brings_it_back(
    fly_changed: Fly, change: Change, causes: set[FallbackCause], at_s: float
) -> None:
    trace, port = fly_changed(pulses(50, 2), change, at_s=at_s)
    safety = port.safety()
    assert safety.fallback_cause in causes
    assert safety.refused_cause == safety.fallback_cause, "until it is acknowledged"
    assert (trace.dshot > 0).all(), "the motors never stop"
    assert safety.stop_cause == StopCause.SWITCH
    worst = np.rad2deg(np.abs(trace.rate)).max()
    print(f"{safety.fallback_cause.name}: {worst:.0f} deg/s, then {tail_error_deg_s(trace):.2f} off")
    assert worst < 800
    assert tail_error_deg_s(trace) < UNWOUND_DEG_S


def louder(factor: float) -> Change:
    """All outputs larger."""

    def change(weights: Weights) -> None:
        last_layer(weights)[:] *= factor

    return change


def livelier(factor: float) -> Change:
    """All that is observed of the axes larger."""

    def change(weights: Weights) -> None:
        columns = [1 + column for axis in range(3) for column in observed(axis)]
        first_layer(weights)[:, columns] *= factor

    return change


@pytest.mark.parametrize(
    "change",
    [louder(2), louder(3), livelier(4), livelier(8)],
    ids=["outputs 2", "outputs 3", "rates 4", "rates 8"],
)
def test_no_motors_go_on_swinging_too_fast_for_the_body_at_hover(fly_changed: Fly, change: Change) -> None:
    """The policy is told, or is calmer than the bar."""
    trace, port = fly_changed(Scenario("hover", (Segment(1.4, throttle=0.25),)), change, at_s=0.3)
    told = port.safety().fallback_cause == FallbackCause.OSCILLATION
    assert (trace.dshot > 0).all()
    moved = np.abs(np.diff(trace.motors, axis=0)).mean(axis=1)
    error = np.abs(np.diff(trace.setpoint - trace.gyro, axis=0)).sum(axis=1)
    left = (moved - OSCILLATION_MOTORS_BY_ERROR * error)[-200:].mean()
    print(
        f"{moved[400:500].mean():.3f} a ms, then {moved[-200:].mean():.3f}, of which {left:.3f} unexplained"
    )
    assert left < (0.005 if told else OSCILLATION_MOTORS)


@pytest.mark.parametrize("hz", [120.0, 250.0])
def test_a_policy_is_left_alone_when_a_bent_propeller_shakes_its_gyro(
    reference_library: Path, hz: float
) -> None:
    """Its motors follow: that is not its fault, and the PID's do the same."""
    inner = ReferencePort(reference_library, GYRO_RATE_HZ)
    port = drifting(inner, (20.0, 14.0, 6.0), hz)
    twin = Twin(load_aircraft("nf1"), rate_hz=GYRO_RATE_HZ, rng=np.random.default_rng((1, 1)))
    with closing(twin), closing(port):
        trace = fly(twin, port, Scenario("shakes", (Segment(0.8, throttle=0.3),)))
        safety = records.safety(Client(inner.reference).request(Msp.SAFETY))
    assert safety.fallback_cause == ALONE
    assert np.abs(np.diff(trace.motors, axis=0)).mean() > OSCILLATION_MOTORS


@pytest.mark.parametrize("name", ["roll", "flip", "sim/scenarios/split_s.toml"])
def test_the_shipped_policy_is_left_alone_when_it_turns_over(fly_changed: Fly, name: str) -> None:
    assert fly_changed(load_scenario(name, 1))[1].safety().fallback_cause == ALONE


@pytest.mark.parametrize("count", [6, pytest.param(1000, marks=pytest.mark.slow)])
def test_the_shipped_policy_is_left_alone_in_pulses(fly_changed: Fly, count: int) -> None:
    assert fly_changed(pulses(1, count))[1].safety().fallback_cause == ALONE


@pytest.mark.parametrize("seeds", [range(4), pytest.param(range(200), marks=pytest.mark.slow)], ids=len)
def test_the_shipped_policy_is_left_alone_when_the_aircraft_differs_from_its_file(
    fly_changed: Fly, seeds: range
) -> None:
    """Up to the delay that it was trained with; beyond, it may ring, and then the PID takes over."""
    told = {}
    for seed in seeds:
        variation = drawn(seed)
        _, port = fly_changed(pulses(1000 + seed, 1), seed=seed, variation=variation)
        told[seed] = (float(variation.delay_s[0]) <= TRAINED_DELAY_S, port.safety().fallback_cause)
    assert sum(trained for trained, _ in told.values()) > len(told) / 2
    assert {cause for trained, cause in told.values() if trained} == {ALONE}
    assert {cause for _, cause in told.values()} <= {ALONE, FallbackCause.OSCILLATION}


@pytest.mark.parametrize("throttle", [0.0, 0.4])
@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("limit", sampled([1000, 1300, 1600], 1600))
def test_a_full_stick_is_flown_whatever_the_aircraft_can_reach(
    fly_changed: Fly, axis: int, limit: int, throttle: float
) -> None:
    """The NF1 yaws at 780 deg/s at most: from 1300 on, more is asked than it can give."""
    name, rates = ("roll", "pitch", "yaw")[axis], [0.0] * 3
    rates[axis] = 1000.0
    still = Segment(0.5, throttle=throttle)
    full = Segment(1.0, (rates[0], rates[1], rates[2]), throttle)
    settings = {f"{name}_max": limit}
    trace, port = fly_changed(Scenario("full", (still, full, still)), settings=settings)
    assert (trace.dshot > 0).all()
    assert (port.safety().stop_cause, port.safety().fallback_cause) == (StopCause.SWITCH, ALONE)
    assert np.rad2deg(trace.rate[:, axis].max()) > 600


def test_a_weak_yaw_is_no_crash_when_the_stick_is_full(fly_changed: Fly) -> None:
    nominal = Variation.nominal(1, 0.0)
    weak = replace(nominal, torque=np.array([0.3]))
    stick = Scenario("weak", (Segment(0.5), Segment(1.5, (0.0, 0.0, 1000.0)), Segment(1.0)))
    trace, port = fly_changed(stick, variation=weak)
    assert np.rad2deg(trace.rate[:, 2].max()) < 700, "it cannot turn so fast"
    assert (trace.dshot > 0).all()
    assert port.safety().stop_cause == StopCause.SWITCH


def test_the_policy_of_a_trial_flies_only_while_its_switch_is_held(fly_changed: Fly) -> None:
    """The scenario's switch of the PID, AUX 2, is the trial's."""
    settings = {"policy_trial": 1, "mode2": 0, "mode4": ModeRange(Mode.TRIAL, 2, 1700, 2100).packed}
    flights = {}
    for name, held in (
        ("never", (False,) * 4),
        ("held", (True,) * 4),
        ("released", (True, True, False, False)),
    ):
        parts = tuple(Segment(0.3, (100.0, 0.0, 0.0), pid=now) for now in held)
        trace, port = fly_changed(Scenario(name, parts), settings=settings)
        flights[name] = trace.dshot
        assert port.safety().fallback_cause == (ALONE if all(held) else FallbackCause.SWITCH)
        assert port.safety().refused_cause == ALONE, "the pilot's own choice refuses nothing"
    assert (flights["held"] != flights["never"]).any()
    np.testing.assert_array_equal(flights["released"][:600], flights["held"][:600])
    assert (flights["released"][700:] != flights["held"][700:]).any()


def test_the_pid_takes_over_from_a_trial_when_the_receiver_falls_silent(fly_changed: Fly) -> None:
    settings = {"policy_trial": 1, "mode2": 0, "mode4": ModeRange(Mode.TRIAL, 2, 1700, 2100).packed}
    turning = (100.0, 0.0, 0.0)
    flights = {}
    for heard in (True, False):
        parts = (
            Segment(0.5, pid=True),
            Segment(0.05, turning, pid=True),
            Segment(0.5, turning, 0.0, heard, True),
        )
        flights[heard] = fly_changed(Scenario("gap", parts), settings=settings)[0]
    silent_from, held_until = 550, 550 + RECEIVER_HOLD_MS - 10  # the last frame may be 10 ms old
    same = (flights[True].dshot == flights[False].dshot).all(axis=1)
    assert same[:held_until].all()
    assert not same[silent_from + RECEIVER_HOLD_MS :].all()
    _, port = fly_changed(
        Scenario("end", (Segment(0.5, pid=True), Segment(0.3, pid=False))), settings=settings
    )
    assert port.safety().fallback_cause == FallbackCause.SWITCH
