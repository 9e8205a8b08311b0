"""Mass properties against closed forms."""

import math

import numpy as np
import pytest

from sim.aircraft import load_aircraft
from sim.mass import Part, mass_properties


def part(mass: float, position: tuple[float, float, float], **changes: object) -> Part:
    values = {
        "name": "p",
        "mass": mass,
        "position": position,
        "yaw": 0.0,
        "centre": (0.0, 0.0, 0.0),
        "inertia": (1e-9, 1e-9, 1e-9),
    }
    return Part(**{**values, **changes})  # type: ignore[arg-type]


def test_inertia_is_that_of_a_dumbbell_when_two_points_lie_on_an_axis() -> None:
    found = mass_properties([part(1.0, (0.3, 0.0, 0.0)), part(1.0, (-0.3, 0.0, 0.0))])
    assert found.mass == 2.0
    assert found.centre == pytest.approx(np.zeros(3))
    assert np.diag(found.inertia) == pytest.approx([0.0, 2 * 0.09, 2 * 0.09], abs=1e-8)


def test_centre_is_weighted_when_masses_differ() -> None:
    found = mass_properties([part(3.0, (0.0, 0.0, 0.0)), part(1.0, (0.0, 0.4, 0.0))])
    assert found.centre == pytest.approx([0.0, 0.1, 0.0])


def test_moments_and_offset_turn_with_the_part_when_it_is_yawed() -> None:
    turned = part(1.0, (0.0, 0.0, 0.0), yaw=math.pi / 2, centre=(0.1, 0.0, 0.0), inertia=(1e-3, 2e-3, 3e-3))
    found = mass_properties([turned])
    assert found.centre == pytest.approx([0.0, 0.1, 0.0])
    assert np.diag(found.inertia) == pytest.approx([2e-3, 1e-3, 3e-3])


def test_nf1_weighs_what_its_parts_sum_to() -> None:
    found = load_aircraft("nf1").mass_properties
    assert found.mass == pytest.approx(0.066 + 0.194 + 0.0305 + 4 * (0.020 + 0.00511))
    # The centre of mass hangs about 24 mm below the centre of thrust (facts of the published twin).
    assert 0.058 - found.centre[2] == pytest.approx(0.024, abs=0.001)
    assert found.centre[:2] == pytest.approx([0.0, 0.0], abs=1e-6)
