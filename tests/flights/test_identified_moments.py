"""What `policy adapt` finds in flights of aircraft that differ from their file: factors of moments."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from neuroflight.sim.aircraft.model import FOLDER, load_aircraft
from neuroflight.sim.flight.scenario import pulses
from neuroflight.sim.flight.trace import Trace, save_trace
from neuroflight.sim.identification.moments import Factors, read_turning, turning_factors
from neuroflight.sim.ports.library import ReferencePort
from tests.sampling import sampled

NF1 = load_aircraft("nf1")
Flown = Callable[..., Trace]
Identify = Callable[[str], tuple[Factors, Path]]
# Of a factor in roll, pitch and yaw. 18 flights of six aircraft, ten pulses each, were off by at most 0.4,
# 0.4 and 0.9 %.
OFF_MAX = np.array([0.006, 0.006, 0.012])


@pytest.fixture
def identify(reference: ReferencePort, flown: Flown, tmp_path: Path) -> Identify:
    """Flies ten pulses with an aircraft of this file's text; what the NF1's file and the trace tell of it."""

    def run(text: str) -> tuple[Factors, Path]:
        file, trace = tmp_path / "another.toml", tmp_path / "flight.npz"
        file.write_text(text)
        save_trace(trace, flown(reference, pulses(1, 10), aircraft=str(file)))
        return turning_factors(read_turning(trace, NF1.motor_count), NF1, "flight"), file

    return run


BALLAST = [
    (1e-9, 1e-9, 1e-9),
    (5.2e-4, 4.2e-4, 6.0e-4),
    (3e-4, 9e-4, 8e-4),  # roll and pitch couple into yaw more than twice as much as the file says
    (9e-4, 2e-4, 9e-4),  # and the other way round
]


@pytest.mark.parametrize("added", sampled(BALLAST, BALLAST[3]))
def test_factors_are_the_inertia_s_when_a_policy_flies_ballast(
    added: tuple[float, ...], identify: Identify
) -> None:
    centre = NF1.mass_properties.centre.tolist()
    ballast = (
        '\n[[part]]\nname = "ballast"\nmass_kg = 0.1\nposition_m = [0.0, 0.0, 0.0]\nyaw_rad = 0.0\n'
        f"centre_of_mass_m = {centre}\ninertia_kg_m2 = {list(added)}\n"
    )
    found, file = identify((FOLDER / "nf1.toml").read_text() + ballast)
    truth = np.diag(NF1.mass_properties.inertia) / np.diag(load_aircraft(file).mass_properties.inertia)
    off = found.value / truth - 1.0
    assert (np.abs(off) < OFF_MAX).all(), off
    assert (np.abs(found.value - truth) < found.margin).all(), found.margin


def test_factors_of_roll_and_pitch_are_the_thrust_s_when_rotors_are_weak(identify: Identify) -> None:
    weak, text = 0.9, (FOLDER / "nf1.toml").read_text()
    (thrust,) = NF1.propulsion.thrust_coefficient
    told = f"thrust_coefficient = {1e7 * thrust:.2f}e-7"
    assert text.count(told) == 1
    found, file = identify(text.replace(told, f"thrust_coefficient = {weak * thrust:.6g}"))
    assert load_aircraft(file).propulsion.thrust_coefficient == pytest.approx((weak * thrust,))
    assert found.value[:2] == pytest.approx(weak, rel=OFF_MAX[0])
    # Most of a yaw moment is the reaction to rotors that gain speed, whose inertia is the file's.
    assert found.value[2] == pytest.approx(1.0, rel=OFF_MAX[2])
