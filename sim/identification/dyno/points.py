"""Thrust and torque coefficients from steady points of a stand, and the speed curve where throttle is known.

Plain least squares through zero: T = K_T w^2, and Q = K_Q T with the thrust of that fit. A stand's averages
have little noise, so no robust fit is needed; only slips of the speed sensor are left out, and counted.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from neuroflight.sim.arrays import Array, Flags
from neuroflight.sim.identification.dyno.fit import NO_TORQUE, fit_polynomial, static_slopes
from neuroflight.sim.identification.dyno.model import quadratic, quadratic_errors
from neuroflight.sim.identification.dyno.robust_fit import Estimate, polynomial
from neuroflight.sim.identification.dyno.signal import JUMP, NOISE_FLOOR, deviation
from neuroflight.sim.identification.dyno.stand import POINTS_MIN, Stand
from neuroflight.toolchain.errors import DynoError

STRONG = 0.25  # part of the greatest thrust: rows above it give a first estimate
SLIP = 0.2  # of the greatest thrust: a row this far off, and SLIPS_OFF times the others' distance, is a slip
SLIPS_OFF = 6.0
SLIPS_MAX = 0.1  # part of the rows: if more are off, thrust is not proportional to speed squared
LEFT_MAX = 0.15  # greatest rms residual, in parts of the greatest thrust or torque


@dataclass(frozen=True, eq=False)
class PointsFit:
    """Coefficients of steady points; no response, because points do not show one."""

    speed: Array  # (N,) [rad/s], of the rows with a turning rotor, slips included
    thrust: Array  # (N,) [N]
    torque: Array | None  # (N,) [N m]
    slips: int  # of them, left out
    speed_max: float  # [rad/s], greatest of the points
    speed_curve: tuple[Estimate, Estimate, Estimate] | None  # a, b, c of H(u) [rad/s]; None: throttle unknown
    thrust_coefficient: tuple[Estimate, ...]  # polynomial of speed, lowest power first
    torque_ratio: tuple[Estimate, ...]  # likewise; empty: no torque was measured
    thrust_left: float  # rms residual in parts of the greatest thrust
    torque_left: float  # likewise of the torque; 0 without one
    reason: str  # why no response is known
    doubts: tuple[str, ...]  # why these are not coefficients of a rotor at rest: they are not to be written
    notes: tuple[str, ...]

    @property
    def response(self) -> None:
        """None, as for a recording without a usable response."""
        return


def fit_points(stands: Sequence[Stand], reason: str, *, speed_dependent: bool = False) -> PointsFit:
    """Fit the rows of all `stands` in which the rotor turns. Raises DynoError where they are too few.

    reason: why the response is not known. speed_dependent: K_T and K_Q may be polynomials of speed.
    """
    speed, thrust = (np.concatenate([getattr(one, name) for one in stands]) for name in ("speed", "thrust"))
    torque = _all(stands, "torque")
    throttle = _all(stands, "throttle")
    where = ", ".join(str(one.path) for one in stands)
    turning = (speed > 0.0) & np.isfinite(thrust)
    if turning.sum() < POINTS_MIN:
        raise DynoError(
            f"{where}: {int(turning.sum())} rows with a turning rotor, expected at least {POINTS_MIN}; "
            "record more levels"
        )
    notes = [note for one in stands for note in one.notes]
    if torque is None:
        notes.append(NO_TORQUE)
    top = float(thrust[turning].max())
    rough = turning & (thrust > STRONG * top)
    if top <= 0.0 or not rough.any():
        raise DynoError(
            f"{where}: thrust is not above 0 in any row, expected it to rise with speed; is the sensor "
            "connected?"
        )
    off = np.abs(thrust - float(np.median(thrust[rough] / speed[rough] ** 2)) * speed**2)
    slips = turning & (off > max(SLIP * top, SLIPS_OFF * deviation(off[turning])))
    used = turning & ~slips
    doubts = []
    if slips.sum() > SLIPS_MAX * turning.sum():
        used, slips = turning, np.zeros_like(slips)
    elif slips.any():
        notes.append(
            f"{int(slips.sum())} rows with a speed that cannot be, by the thrust of the others: left out"
        )

    def terms(w: Array, load: Array, values: Array, name: str) -> tuple[tuple[Estimate, ...], float]:
        """Return the coefficient of `values` over `load` at speeds `w`, and the rms of what it leaves."""
        found: tuple[Estimate, ...] = (_through_zero(load, values),)
        if speed_dependent:
            found = fit_polynomial(w, load, values, float(w.max()), True, name)
        rest = values - polynomial(found, w) * load
        return found, float(np.sqrt(np.mean(rest**2)) / np.abs(values).max())

    thrust_terms, thrust_left = terms(speed[used], speed[used] ** 2, thrust[used], "thrust")
    torque_terms: tuple[Estimate, ...] = ()
    torque_left = 0.0
    if torque is not None:  # torque may be in other rows than thrust, if the stand reads its sensors in turns
        braked = (speed > 0.0) & np.isfinite(torque) & ~slips
        w = speed[braked]
        if len(w) < POINTS_MIN:
            raise DynoError(
                f"{where}: {len(w)} rows with a torque, expected at least {POINTS_MIN}; record more levels"
            )
        load = polynomial(thrust_terms, w) * w**2
        torque_terms, torque_left = terms(w, load, torque[braked], "torque")
    against = int((thrust[used] < -SLIP * top).sum())
    if thrust_left > LEFT_MAX:
        wind = f", in {against} rows it pulls the other way: was it in wind?" if against else "."
        doubts.append(
            f"thrust does not follow the square of the speed, {100 * thrust_left:.0f} % of the greatest are "
            f"left (rms){wind} These are not the coefficients of a rotor at rest"
        )
    if torque_left > LEFT_MAX:
        doubts.append(
            f"torque does not follow the thrust, {100 * torque_left:.0f} % of the greatest are left (rms)"
        )
    curve = None
    if throttle is not None:
        curve = _curve(throttle, speed, used, notes)
    return PointsFit(
        speed=speed[turning],
        thrust=thrust[turning],
        torque=None if torque is None else torque[turning],
        slips=int(slips.sum()),
        speed_max=float(speed[used].max()),
        speed_curve=curve,
        thrust_coefficient=thrust_terms,
        torque_ratio=torque_terms,
        thrust_left=thrust_left,
        torque_left=torque_left,
        reason=reason,
        doubts=tuple(doubts),
        notes=tuple(dict.fromkeys(notes)),
    )


def _all(stands: Sequence[Stand], name: str) -> Array | None:
    """Join a column of all logs; None if one of them lacks it."""
    columns = [getattr(one, name) for one in stands]
    return None if any(column is None for column in columns) else np.concatenate(columns)


def _through_zero(load: Array, values: Array) -> Estimate:
    """Return the factor k of values = k load by least squares, with its standard error."""
    square = float(load @ load)
    factor = float(load @ values) / square
    rest = values - factor * load
    return Estimate(factor, math.sqrt(float(rest @ rest) / (len(values) - 1) / square))


def _curve(
    throttle: Array, speed: Array, turning: Flags, notes: list[str]
) -> tuple[Estimate, Estimate, Estimate] | None:
    levels = np.unique(np.round(throttle[turning] / JUMP))
    if len(levels) < 3:
        notes.append(f"throttle has fewer than three levels {JUMP:g} apart: no speed curve")
        return None
    if (most := float(throttle[turning].max())) < 0.9:
        notes.append(f"throttle ends at {most:.2f}: H, and the top speed with it, is extrapolated")
    full = float(speed.max())
    slopes, errors = static_slopes(throttle[turning], speed[turning], full, NOISE_FLOOR * full)
    a, b, c = (Estimate(*pair) for pair in zip(quadratic(slopes), quadratic_errors(errors), strict=True))
    return a, b, c
