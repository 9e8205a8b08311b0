"""Fit a rotor's H, K_T, K_Q, response and latency to a dynamometer's recording.

The whole recording is simulated and fitted at once by a soft-L1 loss, which limits the weight of outliers.
Thrust and torque are fitted where the rotor hardly accelerates, against a speed cleaned of its noise.
Standard errors are those of an M-estimator and assume noise without memory: where the model itself does not
fit, or an uneven log leaves open when throttle jumped, they are too small.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from neuroflight.sim.aircraft.model import COEFFICIENT_TERMS_MAX
from neuroflight.sim.arrays import Array, Flags, Indices
from neuroflight.sim.identification.dyno.model import curve, make_schedule, quadratic, quadratic_errors
from neuroflight.sim.identification.dyno.recording import THROTTLE_SLACK, Recording
from neuroflight.sim.identification.dyno.response import (
    EXACT,
    KINDS,
    SLOPE_MIN,
    ResponseFit,
    fit_response,
    limits,
    why_better,
    why_none,
)
from neuroflight.sim.identification.dyno.robust_fit import Estimate, polynomial, robust_fit
from neuroflight.sim.identification.dyno.signal import (
    JUMP,
    NOISE_FLOOR,
    average,
    commanded,
    deviation,
    jumps,
    noise_of,
    outliers,
    settled_rows,
    steady_rows,
)
from neuroflight.toolchain.errors import DynoError

Progress = Callable[[str], None]

NO_TORQUE = "no torque was measured: K_Q stays unknown; take it from another stand or the propeller's table"


@dataclass(frozen=True)
class SpeedError:
    """Speed residuals of a part of the recording, outliers left out, as fractions of the top speed."""

    level: float | None  # throttle of the steps; None: everything outside them
    mae: float
    rms: float
    largest: float
    model_rms: float  # of the residuals averaged over SMOOTH_S
    model_largest: float


@dataclass(frozen=True, eq=False)
class Fit:
    """Everything fitted, and the model beside the data."""

    recording: Recording
    speed_curve: tuple[Estimate, Estimate, Estimate]  # a, b, c of H(u) = a u^2 + b u + c [rad/s]
    thrust_coefficient: tuple[Estimate, ...]  # polynomial of speed, lowest power first
    torque_ratio: tuple[Estimate, ...]  # likewise; empty: no torque was measured
    response: ResponseFit | None
    rejected: ResponseFit | None  # the response that was tried beside it and fits worse
    reason: str  # why this response, or why none
    notes: tuple[str, ...]  # what the recording does not show
    speed: Array  # (N,) [rad/s], of the model
    thrust: Array  # (N,) [N], of the model at its own speed
    torque: Array  # (N,) [N m]
    clean_speed: Array  # (N,) [rad/s], measured speed without its noise
    steady: Flags  # (N,) rows that thrust and torque were fitted on
    outliers: tuple[Flags, Flags, Flags]  # (N,) of speed, thrust, torque
    speed_errors: tuple[SpeedError, ...]  # one a level, rising, then the rest
    thrust_mae: float  # [N], model against data, outliers left out
    torque_mae: float  # [N m]; 0 without a torque

    @property
    def speed_max(self) -> float:
        """Speed at full throttle [rad/s]."""
        return sum(term.value for term in self.speed_curve)


def fit(
    recording: Recording,
    *,
    kind: str = "auto",
    delay: float | None = None,
    speed_dependent: bool = False,
    progress: Progress = lambda stage: None,
) -> Fit:
    """Fit a rotor to `recording`. Raises DynoError where the recording cannot show H.

    kind: "torque", "first_order" or "auto", which takes the better. delay: latency from command to rotor
    [s] where it is known, else it is fitted. speed_dependent: K_T and K_Q may be polynomials of speed.
    """
    notes: list[str] = []
    progress("speed curve")
    throttle = commanded(recording)
    slips = int((np.abs(recording.throttle - 0.5) > 0.5 + THROTTLE_SLACK).sum())
    if slips:
        notes.append(f"{slips} rows have a throttle outside 0 to 1: taken for slips of the logger")
    rows = jumps(recording)
    settled = settled_rows(recording, rows)
    _check_levels(throttle[settled])
    full = float(np.quantile(recording.speed, 0.97))
    if full <= 0:
        raise DynoError("rpm is 0 nearly everywhere, expected a rotor that turns; is the sensor connected?")
    noise = noise_of(recording.speed, recording.starts, full)
    slopes, errors = static_slopes(throttle[settled], recording.speed[settled], full, noise)
    if throttle.max() < 0.9:
        notes.append(f"throttle ends at {throttle.max():.2f}: H, and the top speed with it, is extrapolated")

    schedule = make_schedule(recording, throttle, noise)
    response = rejected = None
    reason = why_none(throttle, rows)
    if not reason:
        tried = []
        for name in KINDS if kind == "auto" else (kind,):
            progress(f"response: {name}")
            tried.append(fit_response(name, recording, schedule, rows, slopes, noise, full, delay))
        tried.sort(key=lambda item: item.criterion)
        best = tried[0]
        response, slopes, errors, speed = best.response, best.slopes, best.slope_errors, best.speed
        rejected = tried[1].response if len(tried) > 1 else None
        reason = why_better(tried) if rejected else f"{response.kind}: as asked"
        notes += limits(response)
    else:
        speed = curve(slopes, throttle)

    progress("thrust and torque")
    measured_torque = recording.torque if recording.has_torque else np.zeros(len(recording.time))
    speed_off, thrust_off, torque_off = (
        outliers(values, recording.starts) for values in (recording.speed, recording.thrust, measured_torque)
    )
    measured = recording.speed - speed
    clean = np.maximum(speed + average(np.where(speed_off, 0.0, measured), ~speed_off, recording), 0.0)
    steady = steady_rows(recording, speed, rows)
    a, b, c = quadratic(slopes)
    top = max(a + b + c, float(clean.max()))
    thrust_terms = fit_polynomial(
        clean[steady], clean[steady] ** 2, recording.thrust[steady], top, speed_dependent, "thrust"
    )
    loads = polynomial(thrust_terms, clean) * clean**2
    torque_terms: tuple[Estimate, ...] = ()
    if recording.has_torque:
        torque_terms = fit_polynomial(
            clean[steady], loads[steady], measured_torque[steady], top, speed_dependent, "torque"
        )
    else:
        notes.append(NO_TORQUE)
    thrust = polynomial(thrust_terms, speed) * speed**2
    torque = polynomial(torque_terms, speed) * thrust if torque_terms else np.zeros(len(speed))
    a_error, b_error, c_error = quadratic_errors(errors)
    return Fit(
        recording=recording,
        speed_curve=(Estimate(a, a_error), Estimate(b, b_error), Estimate(c, c_error)),
        thrust_coefficient=thrust_terms,
        torque_ratio=torque_terms,
        response=response,
        rejected=rejected,
        reason=reason,
        notes=tuple(notes),
        speed=speed,
        thrust=thrust,
        torque=torque,
        clean_speed=clean,
        steady=steady,
        outliers=(speed_off, thrust_off, torque_off),
        speed_errors=_speed_errors(recording, throttle, rows, speed, speed_off, a + b + c),
        thrust_mae=float(np.abs(recording.thrust - thrust)[~thrust_off].mean()),
        torque_mae=float(np.abs(measured_torque - torque)[~torque_off].mean()),
    )


def static_slopes(throttle: Array, speed: Array, full: float, noise: float) -> tuple[Array, Array]:
    """Fit H to rows at which the rotor has settled; return it with its covariance."""
    bounds = np.array([0.0, SLOPE_MIN, SLOPE_MIN]), np.array([2.0, 50.0, 50.0])
    found, _, covariance = robust_fit(
        lambda p: curve(p * full, throttle) - speed, np.array([0.01, 1.0, 1.0]), noise, bounds
    )
    return found * full, covariance * full**2


def fit_polynomial(
    speed: Array, load: Array, values: Array, top: float, speed_dependent: bool, name: str
) -> tuple[Estimate, ...]:
    """Fit the coefficient k(speed) of values = k load, all (n,): a constant, or the polynomial that BIC
    prefers among those above zero up to `top` [rad/s]. Raises DynoError if there is none."""
    strong = load > 0.25 * load.max()
    middle = float(np.median(values[strong] / load[strong]))
    if middle <= 0:
        raise DynoError(
            f"{name} is {'negative' if middle < 0 else 'zero'} while the rotor turns, expected it above 0; "
            f"turn the sensor's sign"
        )
    size = middle * float(load.max())

    def solve(terms: int, scale: float) -> tuple[Array, float, Array, Array]:
        columns = (load / load.max())[:, None] * (speed[:, None] / top) ** np.arange(terms)
        start = np.zeros(terms)
        start[0] = 1.0
        p, cost, covariance = robust_fit(lambda p: columns @ p * size - values, start, scale)
        return p, cost, covariance, values - columns @ p * size

    most = COEFFICIENT_TERMS_MAX if speed_dependent else 1
    rough = solve(most, 0.02 * size)[3]
    scale = max(deviation(rough), NOISE_FLOOR * size)
    choices = []
    for terms in range(1, most + 1):
        p, cost, covariance, _ = solve(terms, scale)
        over = np.polynomial.polynomial.polyval(np.linspace(0.0, 1.0, 101), p)
        if over.min() > 0:
            cost += len(values) * (EXACT * scale) ** 2
            choices.append((len(values) * math.log(cost) + terms * math.log(len(values)), p, covariance))
    if not choices:
        raise DynoError(
            f"{name} does not rise with the rotor's speed; is the sensor connected and its sign right?"
        )
    _, p, covariance = min(choices, key=lambda choice: choice[0])
    units = middle / top ** np.arange(len(p))
    errors = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return tuple(
        Estimate(float(value), float(error)) for value, error in zip(p * units, errors * units, strict=True)
    )


def _check_levels(throttle: Array) -> None:
    """Raise DynoError unless throttle settled at three levels, as H has three numbers."""
    levels = np.unique(np.round(throttle / JUMP))
    if len(levels) < 3:
        places = ", ".join(f"{level * JUMP:g}" for level in levels)
        raise DynoError(
            f"throttle settles near {places} only, expected at least three levels {JUMP:g} apart or a ramp; "
            f"record more steps"
        )


def _speed_errors(
    recording: Recording,
    throttle: Array,
    rows: Indices,
    speed: Array,
    off: Flags,
    top: float,
) -> tuple[SpeedError, ...]:
    """Return the residuals by the level that throttle steps up to, then those of all other rows."""
    residual = (recording.speed - speed) / top
    smooth = average(np.where(off, 0.0, residual), ~off, recording)
    levels = np.full(len(speed), np.nan)
    bounds = np.union1d(rows, recording.starts).astype(int)
    for row, end in zip(bounds, np.append(bounds[1:], len(speed)), strict=True):
        held = throttle[row:end]
        if row in rows and held[0] > throttle[row - 1] and np.ptp(held) < JUMP:
            levels[row:end] = round(float(np.median(held)), 2)

    def error(level: float | None, part: Flags) -> SpeedError:
        kept, averaged = residual[part & ~off], smooth[part]
        return SpeedError(
            level,
            float(np.abs(kept).mean()),
            float(np.sqrt(np.mean(kept**2))),
            float(np.abs(kept).max()),
            float(np.sqrt(np.mean(averaged**2))),
            float(np.abs(averaged).max()),
        )

    known = np.unique(levels[~np.isnan(levels)])
    errors = [error(float(level), levels == level) for level in known]
    rest = np.isnan(levels) & ~off
    return (*errors, error(None, rest)) if rest.any() else tuple(errors)
