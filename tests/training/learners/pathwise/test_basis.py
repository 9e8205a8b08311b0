"""Parameters as they are learned and as the network has them."""

from __future__ import annotations

import numpy as np
import pytest

from toolchain.contract import observation_blocks
from training.config.training_config import OutputMap
from training.learners.network.shape import Shape
from training.learners.pathwise.basis import LARGER, Basis

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
