"""Coefficients of a propeller over the advance ratio, for [propulsion.advance_ratio], and those at rest."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from neuroflight.sim.aircraft.advance import AdvanceRatio, Terms, read_advance
from neuroflight.sim.arrays import Array
from neuroflight.sim.identification.propeller_tables import Measurements, Static
from neuroflight.toolchain.errors import DynoError
from neuroflight.toolchain.strict_toml import StrictTable

DIGITS = 4  # significant, of a coefficient
LEFT_MAX = 0.3  # part of the thrust at J = 0 at the largest J measured, above which the rest is a guess
END_MAX = 0.02  # part of it where the curve ends, above which the curve never reaches 0


@dataclass(frozen=True, eq=False)
class Curve:
    """A coefficient over J, fitted: static (1 + a1 J + a2 J^2)."""

    static: float  # at J = 0
    terms: Terms
    errors: Terms  # standard errors of the terms; NaN: not known, from as many rows as terms
    residual: float  # RMS of what the fit leaves, in parts of `static`


@dataclass(frozen=True, eq=False)
class PropellerFit:
    """Both coefficients, and what they were fitted to."""

    thrust: Curve
    torque: Curve
    advance: AdvanceRatio  # rounded, as a file has it
    used: Measurements
    left: float  # part of the thrust at J = 0 that is left in the fastest air used


def at_rest(measured: Static) -> tuple[float, float]:
    """Return C_T and C_Q at rest, each averaged over all speeds. Raises DynoError unless both are above 0."""
    thrust, torque = float(measured.thrust.mean()), float(measured.torque.mean())
    for name, value in (("CT", thrust), ("CQ", torque)):
        if not value > 0.0:
            raise DynoError(f"{name} is {value:.3g} at rest, expected above 0; is a column swapped?")
    return thrust, torque


def fit_propeller(measured: Measurements, degree: int = 2) -> PropellerFit:
    """Fit both coefficients by least squares where the propeller pulls, J >= 0 and C_T > 0.

    degree: 1 leaves a2 at 0, for measurements that end long before the thrust does. Raises DynoError for
    measurements that show no curve, or an impossible one.
    """
    pulls = (measured.ratio >= 0.0) & (measured.thrust > 0.0)
    used = Measurements(measured.ratio[pulls], measured.thrust[pulls], measured.torque[pulls])
    different = len(np.unique(used.ratio))
    if different < degree + 1:
        raise DynoError(
            f"{different} different advance ratios with thrust, expected at least {degree + 1} for "
            f"{'a parabola; --degree 1 fits a line' if degree == 2 else 'a line'}"
        )
    thrust = _fit(used.ratio, used.thrust, degree, "CT")
    torque = _fit(used.ratio, used.torque, degree, "CQ")
    table = {"thrust": list(map(_rounded, thrust.terms)), "torque": list(map(_rounded, torque.terms))}
    advance = read_advance(StrictTable(table, "the fit", DynoError))
    left = float(advance.factors(used.ratio.max())[0])
    return PropellerFit(thrust, torque, advance, used, left)


def doubts(fit: PropellerFit) -> list[str]:
    """List what the measurements do not show, a line each."""
    found = []
    last, end = float(fit.used.ratio.max()), fit.advance.ratio_max
    if fit.left > LEFT_MAX:
        found.append(
            f"{100 * fit.left:.0f} % of the thrust is left at the largest J measured, {last:.3g}: from there "
            f"to {end:.3g} the curve is a guess"
        )
    at_end = float(fit.advance.factors(end)[0])
    if at_end > END_MAX:
        found.append(
            f"the curve of the thrust never reaches 0: {100 * at_end:.0f} % stay from J = {end:.3g} on; give "
            f"measurements up to where the propeller stops pulling, or --degree 1"
        )
    return found


def _fit(ratio: Array, values: Array, degree: int, name: str) -> Curve:
    columns = np.vander(ratio, degree + 1, increasing=True)
    best, *_ = np.linalg.lstsq(columns, values, rcond=None)
    static = float(best[0])
    if not static > 0.0:
        raise DynoError(f"{name} is {static:.3g} at J = 0 by the fit, expected above 0; is a column swapped?")
    residuals = values - columns @ best
    freedom = len(values) - degree - 1
    variance = float(residuals @ residuals) / freedom if freedom else math.nan
    covariance = np.linalg.inv(columns.T @ columns) * variance
    terms, errors = [0.0, 0.0], [0.0, 0.0]
    for k in range(1, degree + 1):
        slope = np.zeros(degree + 1)  # of best[k] / best[0]
        slope[k], slope[0] = 1.0 / static, -best[k] / static**2
        terms[k - 1] = float(best[k]) / static
        errors[k - 1] = math.sqrt(float(slope @ covariance @ slope))
    residual = float(np.sqrt(np.mean(residuals**2))) / static
    return Curve(static, (terms[0], terms[1]), (errors[0], errors[1]), residual)


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")
