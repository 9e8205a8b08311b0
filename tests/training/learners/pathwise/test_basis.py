"""Parameters as they are learned and as the network has them."""

from __future__ import annotations

import numpy as np
import pytest

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.physics.rotor import rotor_geometry
from neuroflight.toolchain.contract import observation_blocks
from neuroflight.training.config.training_config import OutputMap
from neuroflight.training.learners.network.shape import Shape
from neuroflight.training.learners.pathwise.basis import LARGER, Basis, steering

TERMS = "rate_estimate,rate_error,rate~15Hz,rate,rate_estimate~15Hz,rate_estimate~5Hz,throttle"
INPUTS = 19
SHAPE = Shape((INPUTS, 6, 4), "tanh", OutputMap())


def parameters(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(SHAPE.count).astype(np.float32)


def basis(terms: str = TERMS) -> Basis:
    return Basis(SHAPE, observation_blocks(terms), 4)


def test_a_low_passed_or_predicted_rate_weighs_as_its_difference() -> None:
    seen = np.random.default_rng(5).standard_normal(INPUTS).astype(np.float32)
    estimate, error, slow, rate, slow_estimate, slower, throttle = np.split(seen, range(3, INPUTS, 3))
    units = (
        LARGER * (estimate - rate),
        error,
        LARGER * (slow - rate),
        rate,
        LARGER * (slow_estimate - slow),
        LARGER * (slower - rate),
        throttle,
    )
    first, bias, *rest = SHAPE.split(learned := parameters(1))
    flown, *others = SHAPE.split(basis().network(learned))
    assert flown @ seen == pytest.approx(first @ np.concatenate(units), abs=1e-3)
    assert all(np.array_equal(*pair) for pair in zip(others, (bias, *rest), strict=True))


def test_conversions_are_inverse() -> None:
    learned = parameters(1)
    assert basis().learned(basis().network(learned)) == pytest.approx(learned, abs=1e-4)


def test_the_gradient_is_the_slope_along_what_is_learned() -> None:
    by_network, direction = parameters(2), parameters(3)
    rise = basis().network(parameters(1) + direction) - basis().network(parameters(1))
    assert basis().gradient(by_network) @ direction == pytest.approx(by_network @ rise, rel=1e-4)


@pytest.mark.parametrize("terms", ["rate_error,rate_estimate", "rate_error,throttle", "rate~15Hz,throttle"])
def test_nothing_is_converted_where_no_rate_is_observed(terms: str) -> None:
    assert np.array_equal(basis(terms).network(parameters(1)), parameters(1))


def test_six_motors_keep_what_turns_the_aircraft_or_lifts_it_evenly_and_nothing_else() -> None:
    hexa, values = load_aircraft("hexa"), np.random.default_rng(1).standard_normal(6)
    kept = steering(hexa)
    assert kept is not None and np.linalg.matrix_rank(kept, tol=1e-4) == 4
    geometry = rotor_geometry(hexa)
    moments = np.hstack([geometry.thrust_wrench[:, 3:5], geometry.torque_wrench[:, 5:], np.ones((6, 1))])
    assert moments.T @ (kept @ values) == pytest.approx(moments.T @ values, abs=1e-5)
    assert kept @ kept == pytest.approx(kept, abs=1e-6)
    assert steering(load_aircraft("nf1")) is None and steering(load_aircraft("iris")) is None


def test_the_last_layer_of_a_network_only_steers_and_learns_only_that() -> None:
    shape, kept = Shape((INPUTS, 6, 6), "tanh", OutputMap()), steering(load_aircraft("hexa"))
    assert kept is not None
    converted = Basis(shape, observation_blocks(TERMS), 6, kept)
    rng = np.random.default_rng(1)
    learned, by_network, direction = rng.standard_normal((3, shape.count)).astype(np.float32)
    flown = converted.network(learned)
    for part in shape.split(flown)[-2:]:
        assert kept @ part == pytest.approx(part, abs=1e-5)
    rise = converted.network(learned + direction) - flown
    assert converted.gradient(by_network) @ direction == pytest.approx(by_network @ rise, rel=1e-3)
