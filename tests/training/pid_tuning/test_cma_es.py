"""CMA-ES on functions whose minimum is known."""

import numpy as np
import pytest
from numpy.typing import NDArray

from neuroflight.training.pid_tuning.cma_es import CmaEs

Array = NDArray[np.float64]
MINIMUM = np.array([3.0, -2.0, 0.5, 8.0, 0.0, -5.0])
TURN = np.linalg.qr(np.random.default_rng(0).standard_normal((6, 6)))[0]


def valley(points: Array) -> Array:
    """A quadratic 1e4 times as steep along one axis as along another; its axes are rotated."""
    across = (points - MINIMUM) @ TURN
    costs: Array = (across**2 * np.geomspace(1.0, 1e4, 6)).sum(axis=1)
    return costs


def search(seed: int, generations: int) -> Array:
    cma_es = CmaEs(np.zeros(6), np.full(6, 0.5), 16, np.random.default_rng(seed))
    points = np.zeros((16, 6))
    for _ in range(generations):
        points = cma_es.ask()
        cma_es.tell(points, valley(points))
    return points


@pytest.mark.parametrize("seed", range(3))
def test_minimum_is_found_when_the_valley_is_narrow_and_turned(seed: int) -> None:
    points = search(seed, 200)
    assert points == pytest.approx(np.tile(MINIMUM, (16, 1)), abs=1e-3)


def test_first_candidates_have_the_given_mean_and_spread() -> None:
    spread = np.array([0.1, 3.0])
    points = CmaEs(np.array([1.0, 2.0]), spread, 4000, np.random.default_rng(1)).ask()
    assert points.mean(axis=0) == pytest.approx(np.array([1.0, 2.0]), abs=0.15)
    assert points.std(axis=0) == pytest.approx(spread, rel=0.05)


def test_search_repeats_when_the_seed_is_the_same() -> None:
    assert np.array_equal(search(5, 10), search(5, 10))
    assert not np.array_equal(search(5, 10), search(6, 10))
