"""Response to a held command: success, rise time, peak, drift. Pure functions.

The figures of Koch 2019, chapters 3 and 5. The initial error is setpoint - rate where the command begins,
and an axis has settled when its error stays within 10 % of that. The figures are given for two bands: bare,
as in the text, and no narrower than a floor, as in the author's published reward: a tenth of a small
command is less than the gyro's noise. Percentages leave out axes whose initial error is below the floor;
the count of a mean says how many are left.

Axes last: roll, pitch, yaw. E is a number of episodes, L one of samples of the held command.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike

from neuroflight.sim.analysis.confidence import Mean, mean_of, share_of
from neuroflight.sim.arrays import Array, Flags, Indices

BAND = 0.10  # half width of the band, part of the initial error
FLOOR_DEG_S = 5.0  # least half width of the band [deg/s]
LATE_S = 0.50  # after the command: settled by then, or late
LATER_S = 0.75
STEADY_S = 1.50  # to hold steady: in the band from LATE_S to then, at every sample
STAY_S = 0.10  # from settling to the end of the command, at least: a rate that only crosses the band is out
HOLD_S = 1.0  # the shortest command these figures are taken of
RISE = (0.1, 0.9)  # of the initial error
SAMPLES_PER_S = 1000.0  # the 1 ms samples of the summed error


@dataclass(frozen=True)
class Hold:
    """The part of each episode in which its command is held."""

    error: Array  # (E, L, 3) [rad/s], setpoint - rate
    rate: Array  # (E, L, 3) [rad/s]
    step_s: float  # [s] between samples

    @property
    def t(self) -> Array:
        """Time since the command began [s], (L,)."""
        return np.asarray(np.arange(self.error.shape[1]) * self.step_s, np.float64)

    @property
    def initial(self) -> Array:
        """Initial error [rad/s], (E, 3)."""
        first: Array = self.error[:, 0]
        return first


@dataclass(frozen=True)
class Response:
    """Each axis of each episode, (E, 3) unless said."""

    success: Flags  # settled in the band with the floor, and stayed
    success_bare: Flags  # the same without the floor
    settling_ms: Array  # until it stays in the band with the floor; where `success`
    late_error: Array  # mean |error| after LATE_S in % of the initial error; where `large`
    large: Flags  # initial error of at least the floor
    rose: Flags  # large, and reached 90 %
    rise_ms: Array  # from 10 % to 90 % of the initial error; where `rose`
    peak: Array  # largest rate towards the command, in % of the initial error; where `large`
    error: Array  # sum of |error| over 1 ms samples [rad/s]
    stability: Array  # |slope| of the rate's linear regression after LATE_S [deg/s^2]
    slope: Array  # the same with its sign [rad/s^2], as Koch reports it: opposite drifts cancel in a mean
    in_band_500: Array  # share of the time after 500 ms in the band with the floor, 0..1
    in_band_750: Array
    in_band_500_bare: Array  # the same without the floor
    in_band_750_bare: Array
    all_in_band_500: Array  # (E,), share of that time in which all three axes are
    all_in_band_750: Array
    all_in_band_500_bare: Array
    all_in_band_750_bare: Array
    steady: Flags  # (E,), all three axes in the band at every sample from LATE_S to STEADY_S, or to the end
    steady_bare: Flags
    steady_750: Flags  # the same from LATER_S on
    steady_750_bare: Flags


@dataclass(frozen=True)
class ResponseFigures:
    """Means over episodes; shares are 0..1. What a mean's `count` lacks to `episodes` was left out."""

    episodes: int
    floor_deg_s: float
    success: Mean
    success_bare: Mean
    settling_ms: Mean  # of those that settled
    failure: Mean  # late error [%] of the large ones that did not settle
    failure_bare: Mean
    rise_ms: Mean
    peak: Mean
    error: Mean
    stability: Mean
    slope: Mean
    in_band_500: Mean
    in_band_750: Mean
    in_band_500_bare: Mean
    in_band_750_bare: Mean
    all_in_band_500: Mean  # of all axes at once: single values
    all_in_band_750: Mean
    all_in_band_500_bare: Mean
    all_in_band_750_bare: Mean
    steady: Mean  # likewise
    steady_bare: Mean
    steady_750: Mean
    steady_750_bare: Mean


def hold(setpoint: ArrayLike, rate: ArrayLike, step_s: float) -> Hold | None:
    """Find the held command of each episode in the setpoints; None if one is shorter than HOLD_S.

    setpoint, rate: (E, T, 3) [rad/s], rows `step_s` apart. A command begins where the setpoint leaves zero
    and lasts until it changes again; all are cut to the shortest.
    """
    wanted, flown = np.asarray(setpoint), np.asarray(rate)
    if wanted.shape != flown.shape or wanted.ndim != 3 or wanted.shape[2] != 3 or not wanted.shape[1]:
        raise ValueError(f"setpoint {wanted.shape} and rate {flown.shape}: expected equal (E, T, 3), T > 0")
    steps = wanted.shape[1]
    at = np.arange(steps)
    begin = (wanted != 0).any(axis=2).argmax(axis=1)  # 0 where nothing is asked for
    changed = np.zeros((len(wanted), steps), bool)
    changed[:, 1:] = (wanted[:, 1:] != wanted[:, :-1]).any(axis=2)
    changed &= at > begin[:, None]
    end = np.where(changed.any(axis=1), changed.argmax(axis=1), steps)
    length = int((end - begin).min())
    if round(HOLD_S / step_s) > length:
        return None
    rows = (begin[:, None] + at[:length])[:, :, None]
    held = np.take_along_axis(flown, rows, axis=1).astype(np.float64)
    error = np.take_along_axis(wanted, rows, axis=1).astype(np.float64) - held
    return Hold(error, held, step_s)


def progress(held: Hold) -> Array:
    """Compute the progress of the rate, (E, L, 3): 0 at its beginning, 1 at the setpoint."""
    initial = held.initial[:, None]
    part: Array = 1.0 - held.error / np.where(initial == 0.0, 1.0, initial)
    return np.where(initial == 0.0, 0.0, part)


def in_band(held: Hold, floor_deg_s: float = FLOOR_DEG_S) -> Flags:
    """Return True for each sample in the band, (E, L, 3)."""
    band = np.maximum(BAND * np.abs(held.initial), np.deg2rad(floor_deg_s))
    inside: Flags = np.abs(held.error) <= band[:, None]
    return inside


def large(held: Hold, floor_deg_s: float = FLOOR_DEG_S) -> Flags:
    """Return True for axes whose initial error is large enough for percentages, (E, 3)."""
    size = np.abs(held.initial)
    enough: Flags = (size >= np.deg2rad(floor_deg_s)) & (size > 0.0)
    return enough


def response(held: Hold, floor_deg_s: float = FLOOR_DEG_S) -> Response:
    """Compute the figures of each axis of each episode."""
    late, later, end = (round(s / held.step_s) for s in (LATE_S, LATER_S, STEADY_S))
    size = np.abs(held.initial)
    error = np.abs(held.error)
    inside, bare = in_band(held, floor_deg_s), in_band(held, 0.0)
    success, settled_at = _settled(inside, held.step_s)
    success_bare, _ = _settled(bare, held.step_s)
    part, enough = progress(held), large(held, floor_deg_s)
    (began, _), (ended, reached) = (_first_crossing(part, level) for level in RISE)
    slope = _slope(held.rate[:, late:], held.step_s)
    bands = {}
    for ending, within in (("", inside), ("_bare", bare)):
        for name, first in (("500", late), ("750", later)):
            bands[f"in_band_{name}{ending}"] = within[:, first:].mean(axis=1)
            bands[f"all_in_band_{name}{ending}"] = within[:, first:].all(axis=2).mean(axis=1)
        bands[f"steady{ending}"] = within[:, late:end].all(axis=(1, 2))
        bands[f"steady_750{ending}"] = within[:, later:end].all(axis=(1, 2))
    return Response(
        success=success,
        success_bare=success_bare,
        settling_ms=np.where(success, settled_at * held.step_s * 1e3, 0.0),
        late_error=np.where(enough, 100 * error[:, late:].mean(axis=1) / np.where(enough, size, 1.0), 0.0),
        large=enough,
        rose=enough & reached,
        rise_ms=np.where(enough & reached, (ended - began) * held.step_s * 1e3, 0.0),
        peak=np.where(enough, 100 * part.max(axis=1), 0.0),
        error=error.sum(axis=1) * (held.step_s * SAMPLES_PER_S),
        stability=np.rad2deg(np.abs(slope)),
        slope=slope,
        **bands,
    )


def together(each: Sequence[Response]) -> Response:
    """Join the episodes of several responses."""
    joined = {
        field.name: np.concatenate([getattr(one, field.name) for one in each]) for field in fields(Response)
    }
    return Response(**joined)


def response_figures(held: Hold, floor_deg_s: float = FLOOR_DEG_S) -> ResponseFigures:
    """Average over the episodes, with 95 % confidence."""
    return mean_figures(response(held, floor_deg_s), floor_deg_s)


def mean_figures(each: Response, floor_deg_s: float = FLOOR_DEG_S, commands: int = 1) -> ResponseFigures:
    """Average responses taken with that floor, with 95 % confidence.

    commands: how many one after another are of one flight; see `mean_of`.
    """
    judged = {"settling_ms": each.success, "rise_ms": each.rose, "peak": each.large}

    def mean(name: str) -> Mean:
        values = getattr(each, name)
        if values.dtype == np.bool_:
            return share_of(values, commands)
        return mean_of(values, judged.get(name, np.ones(values.shape, np.bool_)), commands)

    both = {field.name for field in fields(Response)} & {field.name for field in fields(ResponseFigures)}
    return ResponseFigures(
        episodes=len(each.large),
        floor_deg_s=floor_deg_s,
        failure=mean_of(each.late_error, each.large & ~each.success, commands),
        failure_bare=mean_of(each.late_error, each.large & ~each.success_bare, commands),
        **{name: mean(name) for name in both},
    )


def _settled(inside: Flags, step_s: float) -> tuple[Flags, Indices]:
    """Return True for axes that settle (E, 3), and the first sample from which each stays in the band."""
    steps = inside.shape[1]
    outside_last = np.where(inside.all(axis=1), 0, steps - (~inside[:, ::-1]).argmax(axis=1))
    return outside_last <= steps - round(STAY_S / step_s), outside_last


def _first_crossing(part: Array, level: float) -> tuple[Array, Flags]:
    """Return the sample (E, 3) at which `part` (E, L, 3) first reaches `level`, and whether it does."""
    above = part >= level
    reached: Flags = np.asarray(above.any(axis=1))
    after = above.argmax(axis=1)[:, None]
    high = np.take_along_axis(part, after, axis=1)[:, 0]
    low = np.take_along_axis(part, np.maximum(after - 1, 0), axis=1)[:, 0]
    # `low` is below the level wherever `after` is not the first sample, which is never above it: part is 0.
    fraction = (level - low) / np.where(reached, high - low, 1.0)
    return np.asarray(np.where(reached, after[:, 0] - 1 + fraction, 0.0), np.float64), reached


def _slope(values: Array, step_s: float) -> Array:
    """Fit the slope (E, 3) of the least-squares line through values (E, K, 3)."""
    t = np.arange(values.shape[1]) * step_s
    t -= t.mean()
    return np.asarray(np.einsum("k,ekj->ej", t, values) / (t @ t))
