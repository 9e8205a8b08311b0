"""The pilot who flies by eye: late, slow, and back on the ground."""

from __future__ import annotations

from contextlib import closing

import numpy as np
import pytest

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.analysis.stick_flight import stick_figures
from neuroflight.sim.control import sticks
from neuroflight.sim.control.pid import aircraft_pid
from neuroflight.sim.flight.eye_pilot import CLIMB_M_S, REACTION_S, EyePilot
from neuroflight.sim.flight.loop import fly
from neuroflight.sim.flight.motion import Motion
from neuroflight.sim.flight.scenario import Scenario, Segment, load_scenario
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.physics.world import Mount
from neuroflight.sim.ports.python_controller import ControllerPort
from neuroflight.toolchain.contract import Mix

RATE_HZ = 1000
LEVEL = np.eye(3)


def rolled(angle: float) -> np.ndarray:
    """Attitude of an aircraft rolled to the right by `angle` [rad]."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def throttles(pilot: EyePilot, count: int, height: float, speed: float = 0.0) -> list[float]:
    """Throttles of `count` steps at a height and a vertical speed."""
    found = []
    for _ in range(count):
        pilot.see(np.array([0.0, 0.0, height]), np.array([0.0, 0.0, speed]), LEVEL)
        channels = pilot.channels(pilot._steps - 1)
        assert channels is not None
        found.append(float(sticks.throttle(channels)))
    return found


def test_he_pushes_until_it_lifts_and_sees_that_late() -> None:
    pilot = EyePilot(Scenario("up", (Segment(9.0, height_m=2.0),)), RATE_HZ)
    before = throttles(pilot, 2000, 0.0)
    assert np.all(np.diff(before) >= 0) and before[-1] == pytest.approx(0.24, abs=0.01)
    lifted = throttles(pilot, 1000, 0.2, CLIMB_M_S)
    late = int(np.argmax(np.diff(lifted) < 0))
    assert late == pytest.approx(REACTION_S * RATE_HZ, abs=25)


def test_he_closes_the_throttle_when_he_has_landed() -> None:
    pilot = EyePilot(Scenario("down", (Segment(2.0, height_m=1.0), Segment(9.0, height_m=0.0))), RATE_HZ)
    throttles(pilot, 1, 0.0)
    throttles(pilot, 3000, 1.0)
    assert throttles(pilot, 500, 1.0, -CLIMB_M_S)[-1] > 0
    assert throttles(pilot, 500, 0.0)[-1] == 0


@pytest.mark.parametrize(("angle", "velocity", "roll"), [(0.2, 0.0, -17), (0.0, 3.0, 10), (0.0, 0.0, 0)])
def test_he_levels_and_leans_against_a_drift(angle: float, velocity: float, roll: float) -> None:
    """A drift to the left asks for a lean to the right."""
    pilot = EyePilot(Scenario("level", (Segment(9.0, height_m=1.0),)), RATE_HZ)
    throttles(pilot, 1, 0.0)
    for _ in range(1000):
        pilot.see(np.array([0.0, 0.0, 1.0]), np.array([0.0, velocity, 0.0]), rolled(angle))
    channels = pilot.channels(1000)
    assert channels is not None
    assert np.rad2deg(sticks.setpoint(channels)) == pytest.approx([roll, 0, 0], abs=1.5)


def test_nothing_is_his_where_the_segment_says_the_sticks() -> None:
    pilot = EyePilot(Scenario("part", (Segment(0.1, throttle=0.3), Segment(0.1, height_m=1.0))), RATE_HZ)
    assert pilot.channels(99) is None
    assert pilot.channels(100) is not None


def test_a_flight_by_eye_takes_off_holds_its_height_and_lands() -> None:
    """Behind gains for another idle, in gusts, on a battery."""
    scenario = Scenario(
        "hop",
        (Segment(0.2), Segment(5.0, height_m=0.6), Segment(3.0, height_m=0.0), Segment(0.5)),
        Mount.FREE,
    )
    nf1 = load_aircraft("nf1")
    port = ControllerPort(aircraft_pid(nf1), 4, RATE_HZ, idle=0.055, mix=Mix.CENTRED)
    rng = np.random.default_rng(3)
    twin = Twin(nf1, rate_hz=RATE_HZ, mount=Mount.FREE, charge=0.9, gust=7.7, ground=True, rng=rng)
    with closing(port), closing(twin):
        motion = Motion(twin)
        trace = fly(twin, port, scenario, watch=motion)
        found = stick_figures(scenario, motion, RATE_HZ)
    assert len(motion.tilt) == len(trace.t)
    print(found)
    assert found.landed
    assert found.height_error_m < 0.5
    assert found.touchdown_m_s is not None and 0.1 < found.touchdown_m_s < 1.0
    assert found.tilt_max_deg < 20


def test_the_scenario_of_the_sticks_ends_on_the_ground() -> None:
    scenario = load_scenario("sticks", 1)
    assert scenario.by_eye and scenario.mount is Mount.FREE
    assert [segment.height_m for segment in scenario.segments][-2:] == [0.0, None]
