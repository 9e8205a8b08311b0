"""Comparison of controllers on the same commands and noise, with paired differences.

Most of the spread of errors over commands comes from the commands, not from the controllers. So differences
are taken within each episode, and their confidence from these differences (paired t): they show a tenth of a
deg/s where the means alone would need ten times as many episodes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.analysis.confidence import Mean, mean_of, paired, share_of
from neuroflight.sim.analysis.holding import settled
from neuroflight.sim.analysis.response import Hold, large, mean_figures, progress, together
from neuroflight.sim.arrays import Array
from neuroflight.training.evaluation.controllers import AnyController, Conditions
from neuroflight.training.evaluation.evaluation import Evaluation, Flights, Scores, summary
from neuroflight.training.evaluation.floor import scored

CHUNK = 128  # episodes whose errors are computed at a time
PERCENTILES = (5, 50, 95)  # over commands, of the drawn curves
STEP_S = 0.6  # drawn part of a held command
REST_S = 0.5  # a point of the curve of rests
SUMS = ("mae", "mse", "iae", "ise", "itae", "itse")
ERRORS = (*SUMS, "error")
RESPONSES = (
    *("success", "success_bare", "rise_ms", "peak", "error", "all_in_band_500", "all_in_band_750"),
    *(
        "all_in_band_500_bare",
        "all_in_band_750_bare",
        "steady",
        "steady_bare",
        "steady_750",
        "steady_750_bare",
    ),
)
SHARES = ("steady", "steady_bare", "steady_750", "steady_750_bare")  # shares of episodes, each 0 or 1


@dataclass(frozen=True, eq=False)
class Example:
    """The first command of an entry, as it was flown."""

    setpoint: Array  # (T, 3) [deg/s]
    rate: Array  # (T, 3) [deg/s], true
    motors: Array | None  # (T, M), motor fractions after mix and idle


@dataclass(frozen=True, eq=False)
class Curves:
    """The drawn curves of an entry: percentiles over its commands, and the first of them."""

    t: Array  # (T,) [s], of the example
    error_t: Array  # (B,) [s]
    error: Array  # (3, B) [deg/s], of |error|, mean of the axes; of flights of a minute, at rest by age
    step_t: Array  # (L,) [s] since the command; empty where none is held
    step: Array  # (3, 3, L) percentile, axis: rate in % of the command, NaN where none is above the floor
    example: Example


@dataclass(frozen=True, eq=False)
class Entry:
    """A controller and its results."""

    controller: AnyController
    throttle: float | None  # None: as recorded
    scores: Scores
    evaluation: Evaluation
    curves: Curves
    commands: Array | None = None  # (E, 3) [deg/s], held, one an episode; None where the task has no such


def enter(
    controller: AnyController,
    conditions: Conditions,
    throttle: float | None,
    on_step: Callable[[int, int], None] | None = None,
) -> Entry:
    """Fly a controller; throttle: see Conditions.fly; on_step: called with steps done and to do."""
    return entered(conditions.fly(controller, throttle, on_step), controller, conditions, throttle)


def entered(
    flights: Flights, controller: AnyController, conditions: Conditions, throttle: float | None
) -> Entry:
    """Return the entry of flights that were flown."""
    each = scored(flights, controller, conditions)
    held = flights.hold()
    asked = None
    if held is not None and flights.course is None:
        asked = np.asarray(np.rad2deg(held.error[:, 0] + held.rate[:, 0]))
    return Entry(controller, throttle, each, summary(each), curves(flights), asked)


def values(each: Scores) -> dict[str, Array]:
    """Return each figure of each episode, (E,), or (E, 3) for roll, pitch, yaw; NaN where undefined.

    A flight counts with the mean of its commands: they depend on each other.
    """
    found = {name: getattr(each.tracking, name) for name in SUMS}
    found |= {"output": each.output, "change": each.change, "smoothness": each.smoothness}
    if each.floors is not None:
        found |= {"mae_least": each.floors.mae, "mse_least": each.floors.mse}
        found |= {
            f"{name}_above": found[name].mean(axis=1) - found[f"{name}_least"] for name in ("mae", "mse")
        }
    if each.motor_change is not None:
        found["motor_change"] = each.motor_change
    if each.holding is not None:
        found |= {
            "rest_early": each.holding.early,
            "rest_late": each.holding.late,
            "hover": each.holding.hover,
            "drift": np.abs(each.holding.drift),
        }
    response = each.response
    if response is None:
        return found
    single = {name: np.asarray(getattr(response, name), np.float64) for name in RESPONSES}
    single["rise_ms"] = np.where(response.rose, response.rise_ms, np.nan)
    single["peak"] = np.where(response.large, response.peak, np.nan)
    return found | {name: _by_flight(rows, each.commands) for name, rows in single.items()}


def _by_flight(rows: Array, commands: int) -> Array:
    """Return the mean of each flight's commands that have a number; NaN where none has."""
    if commands == 1:
        return rows
    parts = rows.reshape(-1, commands, *rows.shape[1:])
    count = np.isfinite(parts).sum(axis=1)
    mean: Array = np.where(count > 0, np.nansum(parts, axis=1) / np.maximum(count, 1), np.nan)
    return mean


def means(scores: Scores) -> dict[str, Mean]:
    """Return each figure over episodes, averaged over axes, with its 95 % confidence."""
    return {name: _mean_of(name, each, scores.commands) for name, each in values(scores).items()}


def by_axis(scores: Scores) -> dict[str, Mean]:
    """Return each figure that has three axes, (3,), over episodes with its 95 % confidence."""
    three = {name: each for name, each in values(scores).items() if each.ndim == 2}
    return {name: mean_of(each, np.isfinite(each)) for name, each in three.items()}


def differences(first: Scores, other: Scores) -> dict[str, Mean]:
    """Return each figure of `other` minus that of `first` on the same commands, with its 95 % confidence."""
    before, after = values(first), values(other)
    return {name: paired(before[name], after[name]) for name in before if name in after}


def percent(first: Scores, other: Scores) -> dict[str, Mean]:
    """Return by how much the means of ERRORS are larger in `other` than in `first`, same commands [%].

    The mean of all axes, of which each episode counts its own mean; see `change_percent`. NaN where the first
    has no error at all.
    """
    before, after = values(first), values(other)
    return {
        name: change_percent(before[name].mean(axis=1), after[name].mean(axis=1))
        for name in ERRORS
        if name in before
    }


def change_percent(first: Array, other: Array) -> Mean:
    """Return 100 (mean of other / mean of first - 1) of paired values (E,), with its 95 % confidence.

    The interval is that of the ratio's linearisation: of other - ratio * first, over the mean of first.
    """
    base = float(first.mean())
    if base == 0.0:
        unknown = np.array(np.nan)
        return Mean(unknown, unknown, unknown, np.array(0, np.int64))
    ratio = float(other.mean()) / base
    each = 100.0 * ((ratio - 1.0) + (other - ratio * first) / base)
    return mean_of(each)


def times_faster(first: Evaluation, other: Evaluation) -> list[float | None]:
    """Return the mean rise time of `first` over that of `other`, by axis; None where one never rose."""
    if first.response is None or other.response is None:
        return [None] * 3
    before, after = first.response.rise_ms, other.response.rise_ms
    known = (before.count > 0) & (after.count > 0) & (after.value > 0)
    return [
        float(before.value[axis] / after.value[axis]) if known[axis] else None for axis in range(len(known))
    ]


def average(entries: Sequence[Entry]) -> dict[str, object]:
    """Merge all episodes of several entries, agents of several seeds, into one, as JSON data.

    `best` is the one with the lowest sum of the errors of the three axes (Koch 2019, chapter 3): of `error`
    where commands are held, else of the integrated absolute error.
    """
    responses = [entry.scores.response for entry in entries]
    held = [response for response in responses if response is not None]
    commands = entries[0].scores.commands
    pooled = [values(entry.scores) for entry in entries]
    joined = {name: np.concatenate([each[name] for each in pooled]) for name in pooled[0]}
    sums = [float(each["error" if "error" in each else "iae"].mean(axis=0).sum()) for each in pooled]
    return {
        "controllers": [entry.controller.name for entry in entries],
        "episodes": sum(len(entry.scores.output) for entry in entries),
        "sum_of_errors": sums,
        "best": entries[int(np.argmin(sums))].controller.name,
        "means": {name: _mean_of(name, each, commands).document() for name, each in joined.items()},
        "response": (
            asdict(mean_figures(together(held), commands=commands)) if len(held) == len(entries) else None
        ),
    }


def curves(flights: Flights) -> Curves:
    """Return the percentiles over the commands; of flights of a minute, over the flights and at rest."""
    held = flights.hold()
    step_t, step = (np.empty(0), np.empty((3, 3, 0))) if held is None else _steps(held)
    t, example = as_flown(flights)
    error_t, error = _errors(flights) if flights.course is None else _rests(flights)
    return Curves(t, error_t, np.percentile(error, PERCENTILES, axis=0), step_t, step, example)


def _errors(flights: Flights) -> tuple[Array, NDArray[np.floating]]:
    """Return the times [s], (T,), and |error| [deg/s], mean of the axes, (E, T)."""
    episodes, steps = flights.rate.shape[:2]
    error = np.empty((episodes, steps), np.float32)
    for start in range(0, episodes, CHUNK):
        part = slice(start, start + CHUNK)
        error[part] = np.abs(flights.setpoint[part] - flights.rate[part]).mean(axis=2)
    return np.asarray(np.arange(steps) * flights.step_s, np.float64), np.rad2deg(error)


def _rests(flights: Flights) -> tuple[Array, Array]:
    """Return middles of the pieces of REST_S in which no stick moves, (B,), and |rate| there, (E, B)."""
    length = round(REST_S / flights.step_s)
    pieces = flights.rate.shape[1] // length
    resting = np.all([settled(one, flights.step_s) for one in flights.setpoint], axis=0)
    whole = np.flatnonzero(resting[: pieces * length].reshape(pieces, length).all(axis=1))
    rate = np.abs(flights.rate[:, : pieces * length]).reshape(len(flights.rate), pieces, -1)
    found: Array = np.rad2deg(rate.mean(axis=2, dtype=np.float64)[:, whole]).astype(np.float64)
    middles: Array = np.asarray((whole + 0.5) * length * flights.step_s, np.float64)
    return middles, found


def as_flown(flights: Flights) -> tuple[Array, Example]:
    """Return the first episode: times [s], (T,), and what was flown."""
    steps = flights.rate.shape[1]
    return np.asarray(np.arange(steps) * flights.step_s, np.float64), Example(
        setpoint=np.rad2deg(flights.setpoint[0], dtype=np.float64),
        rate=np.rad2deg(flights.rate[0], dtype=np.float64),
        motors=None if flights.motors is None else flights.motors[0].astype(np.float64),
    )


def _steps(held: Hold) -> tuple[Array, Array]:
    shown = held.t < STEP_S
    part, enough = 100 * progress(held)[:, shown], large(held)
    drawn = np.full((len(PERCENTILES), 3, int(shown.sum())), np.nan)
    for axis in range(3):
        if enough[:, axis].any():
            drawn[:, axis] = np.percentile(part[enough[:, axis], :, axis], PERCENTILES, axis=0)
    return held.t[shown], drawn


def _mean_of(name: str, each: Array, commands: int) -> Mean:
    if name in SHARES and commands == 1:
        return share_of(each == 1.0)
    return paired(np.zeros_like(each), each)
