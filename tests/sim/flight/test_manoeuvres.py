"""Manoeuvres: whole turns by sticks, throttles of equal thrust, and the files that `fly` takes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from neuroflight.sim.control import sticks
from neuroflight.sim.flight.manoeuvres import (
    DESCENT,
    FULL,
    MANOEUVRES,
    STAIR,
    STAIR_S,
    Manoeuvre,
    ThrustCurve,
    stairs,
)
from neuroflight.sim.flight.scenario import load_scenario
from neuroflight.sim.physics.world import Mount

FILES = Path(__file__).parents[3] / "sim" / "scenarios"
CURVE = ThrustCurve((0.0, 0.2, 1.0), (0.25, 1.0, 4.0))
TURNED = {  # degrees about roll, pitch, yaw
    "roll": (360, 0, 0),
    "flip": (0, 360, 0),
    "split-s": (180, -180, 0),
    "punch-out": (360, 0, 0),
    "dive-recovery": (0, 0, 0),
    "wash": (0, 0, 0),
}


@pytest.mark.parametrize("manoeuvre", MANOEUVRES, ids=lambda each: each.name)
def test_the_sticks_turn_as_far_as_the_manoeuvre_says(manoeuvre: Manoeuvre) -> None:
    scenario = manoeuvre.scenario(CURVE.throttle_of)
    assert scenario.mount is Mount.FREE
    channels, heard = scenario.timeline(1000)
    turned = np.rad2deg(sticks.setpoint(channels)).sum(axis=0) / 1000
    assert turned == pytest.approx(TURNED[manoeuvre.name], abs=0.1)
    assert heard.all()
    moved = np.abs(sticks.setpoint(channels)).max(axis=0) > 0
    assert tuple(moved) == manoeuvre.commanded
    assert not all(manoeuvre.commanded), "an axis is left alone"


@pytest.mark.parametrize(
    ("thrust", "throttle"),
    [(0.0, 0.0), (0.25, 0.0), (0.5625, 0.1), (1.0, 0.2), (2.25, 0.6), (4.0, 1.0), (FULL, 1.0)],
)
def test_the_throttle_of_a_thrust_is_the_one_that_gives_it_or_the_nearest(
    thrust: float, throttle: float
) -> None:
    assert CURVE.throttle_of(thrust) == pytest.approx(throttle)


def test_a_curve_is_the_mean_of_each_stairs_end() -> None:
    rate_hz = 100
    steps = np.repeat(np.arange(len(STAIR), dtype=float), round(STAIR_S * rate_hz))
    steps[:: round(STAIR_S * rate_hz)] = 99.0  # what the rotors do just behind a change
    curve = ThrustCurve.of_steps(steps.tolist(), rate_hz)
    assert curve.throttle == STAIR
    assert curve.thrust == pytest.approx(range(len(STAIR)))
    assert len(stairs().timeline(rate_hz)[0]) == len(steps)


@pytest.mark.parametrize("name", ["punch-out", "dive-recovery"])
def test_the_file_of_a_manoeuvre_has_its_legs(name: str) -> None:
    manoeuvre = next(each for each in MANOEUVRES if each.name == name)
    scenario = load_scenario(str(FILES / f"{name.replace('-', '_')}.toml"), 1)
    made = manoeuvre.scenario(ThrustCurve((0.0, 0.3, 1.0), (0.06, 1.2, 6.0)).throttle_of)
    assert scenario.mount is made.mount
    for segment, leg in zip(scenario.segments, made.segments, strict=True):
        assert segment.duration_s == pytest.approx(leg.duration_s)
        assert segment.setpoint_deg_s == leg.setpoint_deg_s
        assert (segment.throttle in (0.0, 1.0)) == (leg.throttle in (0.0, 1.0))


def test_the_descent_closes_the_throttle_at_no_command() -> None:
    segments = DESCENT.scenario(CURVE.throttle_of).segments
    assert [segment.throttle for segment in segments] == [0.2, 0.0]
    assert {segment.setpoint_deg_s for segment in segments} == {(0.0, 0.0, 0.0)}
