"""Robust least squares with a soft-L1 loss."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from neuroflight.sim.arrays import Array

TOLERANCE = 1e-7  # of cost and parameters: with 1e5 rows still a small part of a standard error


@dataclass(frozen=True)
class Estimate:
    """A fitted number and its standard error."""

    value: float
    error: float


def polynomial(terms: tuple[Estimate, ...], at: Array) -> Array:
    """Evaluate a polynomial, its lowest power first, any shape."""
    return np.asarray(np.polynomial.polynomial.polyval(at, [term.value for term in terms]), np.float64)


def robust_fit(
    residuals: Callable[[Array], Array],
    start: Array,
    scale: float,
    bounds: tuple[Array, Array] | None = None,
    evaluations: int = 60,
) -> tuple[Array, float, Array]:
    """Minimise the soft-L1 loss of residuals whose noise is `scale`: parameters, cost and covariance."""
    result = least_squares(
        residuals,
        start,
        bounds=bounds or (-np.inf, np.inf),
        loss="soft_l1",
        f_scale=scale,
        x_scale="jac",
        max_nfev=evaluations,
        xtol=TOLERANCE,
        ftol=TOLERANCE,
    )
    # result.jac is weighted such that J'J is the Hessian, the sum of psi' x x'.
    grown = 1.0 + (result.fun / scale) ** 2
    spread = np.mean(result.fun**2 / grown) / np.mean(grown**-1.5)
    covariance: Array = spread * np.linalg.pinv(result.jac.T @ result.jac)
    return result.x, float(result.cost), covariance
