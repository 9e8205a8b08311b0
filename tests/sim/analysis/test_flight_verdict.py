"""The verdict on a flight names what is wrong with it, and nothing where nothing is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from neuroflight.sim.analysis.flight_report import Flight
from neuroflight.sim.analysis.flight_verdict import faults, verdict, verdict_of_several
from neuroflight.sim.analysis.holding import holding
from neuroflight.sim.analysis.metrics import figures
from neuroflight.sim.arrays import Array
from neuroflight.sim.flight.scenario import HOVER_S, flight
from tests.sim.flight.traces import trace_of

SCENARIO = flight(3, 5, 0.25)
T = np.arange(round(1000 * SCENARIO.duration_s)) / 1000
HOVER = round(1000 * HOVER_S)
SETPOINT = np.repeat(
    np.deg2rad([segment.setpoint_deg_s for segment in SCENARIO.segments]), SCENARIO.steps(1000), axis=0
)
NOISE = np.where(np.arange(len(T)) % 2, 0.2, -0.2)[:, None] * np.ones(3)  # [deg/s]: an error at rest of 0.2


def flown(name: str, error_deg_s: Array | float = NOISE, motors: Array | float = 0.25) -> Flight:
    """A flight of five commands and a hover, each row with that error and those motor values."""
    values = np.asarray(motors, float).reshape(-1, 1)
    trace = trace_of(SETPOINT, SETPOINT - np.deg2rad(error_deg_s), SETPOINT, values)
    trace = replace(trace, throttle=np.full(len(T), 0.25, np.float32))
    before = len(T) - HOVER
    held = holding(trace.setpoint[None], trace.rate[None], 0.001, 5, before)
    return Flight(name, trace, figures(trace.first(before), 5), held, HOVER)


def in_hover(value: float, axis: int = 0) -> Array:
    """An error about one axis in the hover alone [deg/s]."""
    error = NOISE.copy()
    error[-HOVER:, axis] -= value
    return error


def swinging(rows: slice, amplitude: float, hertz: float) -> Array:
    """Motor values that swing in these rows."""
    values = np.full(len(T), 0.25)
    values[rows] += amplitude * np.sin(2 * np.pi * hertz * T[rows])
    return values


PID = flown("PID flying", 2 * NOISE)
COMMAND = slice(4500 + 500, 4500 + 2500)  # rows of the second one


def test_a_sound_flight_is_told_with_its_figures_and_no_but() -> None:
    assert verdict("5 commands at hover", flown("policy nf1"), PID) == (
        "Policy nf1 followed 5 commands at hover with 0.20 deg/s of mean error (PID flying: 0.40) and then "
        "held: at rest 0.20 deg/s, turned by 0 deg in 10 s of centred sticks."
    )


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        (flown("policy nf1", in_hover(4.6)), ["DRIFTS: 46 deg in roll in 10 s of centred sticks"]),
        (flown("policy nf1", in_hover(-1.2, 2)), ["DRIFTS: 12 deg in yaw"]),
        (flown("policy nf1", np.where(T[-HOVER] < T, 8.0, 1.0)[:, None] * NOISE), ["does not rest: with"]),
        (flown("policy nf1", in_hover(0.9, 1)), ["holds worse the longer it flies: in pitch 0.2 deg/s"]),
        (flown("policy nf1", 2.6 * NOISE), ["follows the sticks worse than PID flying"]),
        (
            flown("policy nf1", motors=swinging(COMMAND, 0.2, 65.0)),
            ["SWINGS at 65 Hz from 5.2 s on: the motors change by 5.2 % of their range in 1 ms", "1.2 %"],
        ),
        (
            flown("policy nf1", motors=swinging(slice(len(T) - HOVER, None), 0.03, 80.0)),
            ["SWINGS at 80 Hz from 22.5 s on", "0.6 %"],
        ),
    ],
)
def test_what_is_wrong_is_told_and_nothing_else(bad: Flight, words: list[str]) -> None:
    found = faults(bad, PID)
    assert len(found) == 1
    for part in words:
        assert part in found[0]
    assert f", but it {found[0]}." in verdict("5 commands", bad, PID)


@pytest.mark.parametrize(
    "good",
    [
        flown("policy nf1", in_hover(0.4)),  # 4 deg in 10 s: half a step of the stick takes more away
        flown("policy nf1", motors=swinging(COMMAND, 0.04, 65.0)),
        flown("policy nf1", 2.2 * NOISE),
    ],
)
def test_what_the_check_would_let_pass_is_no_fault(good: Flight) -> None:
    assert faults(good, PID) == []


def test_a_reference_that_drifts_or_swings_as_much_excuses_it() -> None:
    turning = np.array([4.2, 0.0, 0.0])  # [deg/s], from the first row to the last
    assert faults(flown("a", NOISE + turning), flown("PID", NOISE - turning)) == []
    assert faults(flown("a", NOISE + turning), PID)
    rough = swinging(COMMAND, 0.2, 65.0)
    assert faults(flown("a", motors=rough), flown("PID", motors=rough)) == []


def test_motors_that_stop_are_told_with_their_time() -> None:
    whole = flown("policy nf1")
    dshot = whole.trace.dshot.copy()
    dshot[12_000:] = 0
    stopped = replace(whole, trace=replace(whole.trace, dshot=dshot))
    assert faults(stopped, PID) == ["stopped its motors at 12.00 s, for 68 % of the flight"]
    told = ["was REFUSED in flight (wrong way), and the PID flew on"]
    assert (
        ", but it was REFUSED in flight (wrong way), and the PID flew on; it stopped its motors"
        in verdict("5 commands", stopped, PID, told)
    )


def test_the_sentence_on_several_names_the_flights_that_went_wrong() -> None:
    good, bad = flown("policy nf1"), flown("policy nf1", in_hover(4.6))
    assert verdict_of_several([("flight", good, ()), ("roll", flown("policy nf1", 3 * NOISE), ())]) == (
        "Policy nf1 flew all 2 to their end without drift or swing; the most mean error was 0.6 deg/s, in "
        "roll."
    )
    blind = replace(good, holding=None, hover_rows=0)
    assert " to their end without swing; " in verdict_of_several([("roll", blind, ()), ("flip", blind, ())])
    told = verdict_of_several([("roll", good, ()), ("flight", bad, ()), ("flip", good, ("was REFUSED",))])
    assert told.startswith("Policy nf1: 2 of 3 flights went wrong: in flight it DRIFTS: 46 deg")
    assert told.endswith("; in flip it was REFUSED.")
