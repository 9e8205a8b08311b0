"""What a flight tells of an aircraft's moments."""

from dataclasses import replace

import numpy as np
import pytest

from neuroflight.sim.aircraft.model import Aircraft, load_aircraft, parse_aircraft
from neuroflight.sim.identification.moments import Factors, Turning, adapted_text, turning_factors
from neuroflight.sim.physics.twin import Twin
from neuroflight.toolchain.errors import AircraftError, TraceError

NF1 = load_aircraft("nf1")


def flight(aircraft: Aircraft, spread: float = 0.1) -> Turning:
    """Motors moved at random around 0.4 and as far the other way, so that rates stay small; 1 kHz, noise."""
    rng = np.random.default_rng(2)
    moved = np.repeat(spread * rng.uniform(-1, 1, (20, 1, 4)), 4, axis=1) * [[[1.0], [-1.0], [-1.0], [1.0]]]
    motors = np.repeat(0.4 + moved.reshape(-1, 4), 50, axis=0)
    twin = Twin(aircraft, 1, rng=np.random.default_rng(3))
    try:
        gyro = []
        for command in motors:
            gyro.append(twin.gyro[0])
            twin.step(command[None])
    finally:
        twin.close()
    return Turning(1000.0, motors, np.array(gyro))


@pytest.mark.parametrize("factors", [(1.0, 1.0, 1.0), (1.6, 1.4, 1.3)])
def test_factors_are_those_of_the_inertia_when_it_is_another(factors: tuple[float, ...]) -> None:
    turn = np.diag(np.sqrt(factors))
    properties = NF1.mass_properties
    heavy = replace(NF1, mass_properties=replace(properties, inertia=turn @ properties.inertia @ turn))
    found = turning_factors(flight(heavy), NF1, "log")
    assert found.value == pytest.approx(1.0 / np.array(factors), rel=0.02)


def test_log_is_refused_when_nothing_is_steered() -> None:
    with pytest.raises(TraceError, match="fly steps"):
        turning_factors(flight(NF1, 0.0), NF1, "log")


def test_file_is_refused_when_no_body_has_the_moments() -> None:
    none = np.zeros(3)
    with pytest.raises(AircraftError, match="no rigid body has"):
        adapted_text("nf1", NF1, Factors(np.array([1.3, 1.1, 0.5]), none, none, none, 1))


@pytest.mark.parametrize("value", [(0.6, 0.7, 0.7), (1.2, 1.2, 1.1), (0.5, 1.0, 1.0)])
def test_adapted_file_turns_by_the_factors(value: tuple[float, ...]) -> None:
    wanted, none = np.array(value), np.zeros(3)
    text = adapted_text("nf1", NF1, Factors(wanted, none, none, none, 1))
    adapted = parse_aircraft(text, "adapted")
    thrust = adapted.propulsion.thrust_coefficient[0] / NF1.propulsion.thrust_coefficient[0]
    turns = thrust * np.diag(NF1.mass_properties.inertia) / np.diag(adapted.mass_properties.inertia)
    assert turns == pytest.approx(wanted, rel=1e-3)
    assert adapted.mass_properties.centre == pytest.approx(NF1.mass_properties.centre, abs=1e-6)
