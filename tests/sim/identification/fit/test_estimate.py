"""The mean of what commands and what all that moved tell."""

from __future__ import annotations

import numpy as np
import pytest

from neuroflight.sim.identification.fit.estimate import Estimate, combined

NUMBERS = 12


def estimate(theta: np.ndarray, sigma: float) -> Estimate:
    nothing = np.zeros(0)
    covariance = sigma**2 * np.eye(NUMBERS)
    return Estimate(theta, covariance, 0.0, nothing, nothing, 1, 9, nothing)


def test_the_sharper_estimate_holds_when_both_differ_by_chance() -> None:
    rng = np.random.default_rng(3)
    sharp = rng.normal(0.0, 0.1, NUMBERS)
    found = combined(estimate(sharp + rng.normal(0.0, 0.9, NUMBERS), 1.0), estimate(sharp, 0.1))
    assert found.theta == pytest.approx(sharp, abs=0.05)
    assert np.sqrt(np.diag(found.covariance)) == pytest.approx(0.1, rel=0.5)


def test_commands_decide_when_the_sharper_estimate_is_off_by_more_than_its_interval() -> None:
    rng = np.random.default_rng(4)
    off = 3.0 * rng.choice([-1.0, 1.0], NUMBERS)
    found = combined(estimate(rng.normal(0.0, 0.3, NUMBERS), 0.3), estimate(off, 0.05))
    assert np.abs(found.theta).max() < 1.0
    assert (np.abs(found.theta) < 2.6 * np.sqrt(np.diag(found.covariance))).all()
    assert found.wider > 100.0
