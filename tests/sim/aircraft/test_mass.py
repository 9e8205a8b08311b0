"""Mass properties against closed forms."""

import math

import numpy as np
import pytest

from neuroflight.sim.aircraft.mass import Part, Tensor, mass_properties, principal, rotation_matrix
from neuroflight.sim.aircraft.model import load_aircraft


def diagonal(x: float, y: float, z: float) -> Tensor:
    return ((x, 0.0, 0.0), (0.0, y, 0.0), (0.0, 0.0, z))


def part(mass: float, position: tuple[float, float, float], **changes: object) -> Part:
    values = {
        "name": "p",
        "mass": mass,
        "position": position,
        "rotation": (0.0, 0.0, 0.0),
        "centre": (0.0, 0.0, 0.0),
        "inertia": diagonal(1e-9, 1e-9, 1e-9),
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
    turned = part(
        1.0,
        (0.0, 0.0, 0.0),
        rotation=(0.0, 0.0, math.pi / 2),
        centre=(0.1, 0.0, 0.0),
        inertia=diagonal(1e-3, 2e-3, 3e-3),
    )
    found = mass_properties([turned])
    assert found.centre == pytest.approx([0.0, 0.1, 0.0])
    assert np.diag(found.inertia) == pytest.approx([2e-3, 1e-3, 3e-3])


def test_part_rolls_then_pitches_then_yaws_about_fixed_axes_when_turned() -> None:
    """x, y, z of the part by hand: each quarter turn sends axes to axes."""
    quarter = math.pi / 2
    assert rotation_matrix((quarter, 0.0, 0.0)) @ [0, 1, 0] == pytest.approx([0, 0, 1])
    assert rotation_matrix((0.0, quarter, 0.0)) @ [0, 0, 1] == pytest.approx([1, 0, 0])
    assert rotation_matrix((0.0, 0.0, quarter)) @ [1, 0, 0] == pytest.approx([0, 1, 0])
    assert rotation_matrix((quarter, 0.0, quarter)) @ [0, 1, 0] == pytest.approx([0, 0, 1])
    assert rotation_matrix((quarter, quarter, 0.0)) @ [0, 1, 0] == pytest.approx([1, 0, 0])


def test_principal_moments_are_the_parts_when_it_is_tilted() -> None:
    tilted = part(2.0, (0.1, 0.2, 0.3), rotation=(0.3, -0.2, 0.4), inertia=diagonal(1e-3, 2e-3, 2.5e-3))
    inertia = mass_properties([tilted]).inertia
    moments, axes = principal(inertia)
    assert moments == pytest.approx([1e-3, 2e-3, 2.5e-3])
    assert axes == pytest.approx(rotation_matrix((0.3, -0.2, 0.4)))


def test_products_of_inertia_add_when_parts_lie_off_the_axes() -> None:
    """Two points on the diagonal of x and y: Ixy is minus the sum of m x y."""
    found = mass_properties([part(1.0, (0.3, 0.2, 0.0)), part(1.0, (-0.3, -0.2, 0.0))])
    assert found.inertia[0, 1] == pytest.approx(-2 * 0.06)
    assert found.inertia[0, 0] == pytest.approx(2 * 0.04, rel=1e-6)


def test_nf1_weighs_what_its_parts_sum_to() -> None:
    found = load_aircraft("nf1").mass_properties
    assert found.mass == pytest.approx(0.066 + 0.194 + 0.0305 + 4 * (0.020 + 0.00511))
    # The centre of mass hangs about 24 mm below the centre of thrust (facts of the published twin).
    assert 0.058 - found.centre[2] == pytest.approx(0.024, abs=0.001)
    assert found.centre[:2] == pytest.approx([0.0, 0.0], abs=1e-6)
