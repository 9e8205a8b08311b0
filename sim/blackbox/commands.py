"""The pilot's commands in a flight: the distribution of the commanded rates.

Training draws commands from a distribution (Koch 2019, chapter 5); a flown log says what pilots really ask
for: the dissertation's had 786,022 samples with a standard deviation of 12.4 deg/s.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.arrays import Array, Array32
from neuroflight.sim.blackbox.flight import WHOLE, Part, armed_rows, check_sticks, cut
from neuroflight.sim.blackbox.log import Log
from neuroflight.sim.blackbox.units import channels
from neuroflight.sim.flight.trace import Trace
from neuroflight.toolchain.errors import TraceError

ASKED_DEG_S = 5.0  # smaller commands count as a stick at rest: 0.5 % of a full stick of 1000 deg/s
EDGES_DEG_S = (0, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000)  # of the histogram of sizes
DIGITS = 3  # of a command in deg/s
QUANTILES = (50.0, 90.0, 99.0, 99.9)  # [%]
BINS = 21  # of a signed histogram: the dissertation's 20 and one, so that the middle one lies about 0


@dataclass(frozen=True)
class Overall:
    """All samples of all axes together, as a normal distribution."""

    mean: float  # [deg/s]
    sigma: float  # [deg/s]


@dataclass(frozen=True, eq=False)
class Histograms:
    """Signed histograms of the axes, each beside the normal distribution of that axis' mean and sigma."""

    edges_deg_s: Array  # (3, BINS + 1), symmetric about 0; bins are a whole number of deg/s wide
    counts: NDArray[np.int64]  # (3, BINS) samples
    normal: Array  # (3, BINS) samples that the normal distribution puts into each bin


@dataclass(frozen=True, eq=False)
class Commands:
    """Commanded rates of N samples; arrays per axis are (3,): roll, pitch, yaw."""

    samples: int  # rows of the log, all three axes in each
    seconds: float
    rate_hz: float
    overall: Overall
    axis_sigma: Array  # [deg/s]
    mean: Array  # [deg/s]
    largest: Array  # [deg/s] of the size
    quantiles: Array  # (Q, 3) [deg/s] of the size, at QUANTILES
    change_sigma: Array  # [deg/s^2] of the change from sample to sample
    asked: Array  # part of the time that an axis is asked to turn, 0..1
    together: Array  # (4,) part of the time that 0, 1, 2, 3 axes are asked to turn
    histogram: NDArray[np.int64]  # (B, 3) samples whose size lies from EDGES_DEG_S[b] to below the next
    signed: Histograms
    throttle: Array  # (3,) mean, least, largest, 0..1


@dataclass(frozen=True, eq=False)
class Sticks:
    """The pilot's sticks in one flight of N rows."""

    setpoint: Array32  # (N, 3) [rad/s]
    throttle: Array32  # (N,) 0..1
    t: Array  # (N,) [s]


def log_sticks(log: Log, part: Part = WHOLE) -> Sticks:
    """Return the commands in a log's armed rows. Raises TraceError if it has no setpoint."""
    told = channels(log)
    if told.setpoint is None:
        raise TraceError(f"{log.where} has {told.pilot.lacks}")
    if told.throttle is None:
        raise TraceError(f"{log.where} has no throttle (setpoint[3] or rcCommand[3])")
    rows = armed_rows(log, told, part)
    check_sticks(log, told, rows)
    t = told.time(rows.start)[: rows.stop - rows.start]
    sticks = Sticks(told.setpoint[rows], told.throttle[rows], t)
    if not (np.isfinite(sticks.setpoint).all() and np.isfinite(sticks.throttle).all()):
        raise TraceError(f"{log.where} has a setpoint that is no number; it is damaged")
    if not (np.diff(t) > 0).all():
        raise TraceError(f"{log.where} has times that do not rise; it is damaged")
    return sticks


def trace_sticks(trace: Trace, part: Part = WHOLE) -> Sticks:
    """Return the commands in a trace. Raises TraceError if `part` holds no row of it."""
    taken = cut(trace, part)
    return Sticks(taken.setpoint, taken.throttle, taken.t)


def commands(flights: Sequence[Sticks]) -> Commands:
    """Compute the distribution of the commands in all flights together; there is at least one."""
    asked = np.concatenate([_deg_s(one) for one in flights])
    size = np.abs(asked)
    turning = size >= ASKED_DEG_S
    seconds = sum(float(one.t[-1] - one.t[0]) for one in flights)
    steps = sum(len(one.t) - 1 for one in flights)
    changes = np.concatenate([_changes(one) for one in flights])
    throttle = np.concatenate([one.throttle for one in flights])
    edges = np.array((*EDGES_DEG_S[:-1], np.inf))
    return Commands(
        samples=len(asked),
        seconds=seconds,
        rate_hz=steps / seconds if seconds > 0 else 0.0,
        overall=Overall(float(asked.mean()), float(asked.std())),
        axis_sigma=asked.std(axis=0),
        mean=asked.mean(axis=0),
        largest=size.max(axis=0),
        quantiles=np.percentile(size, QUANTILES, axis=0),
        change_sigma=changes.std(axis=0) if len(changes) else np.zeros(3),
        asked=turning.mean(axis=0),
        together=np.bincount(turning.sum(axis=1), minlength=4) / len(asked),
        histogram=np.stack([np.histogram(size[:, axis], edges)[0] for axis in range(3)], axis=1),
        signed=_histograms(asked),
        throttle=np.array((throttle.mean(), throttle.min(), throttle.max()), np.float64),
    )


def _histograms(asked: Array) -> Histograms:
    """Count the histograms of commands (N, 3) [deg/s]."""
    edges, counts, normal = [], [], []
    for axis in asked.T:
        # Odd widths put the edges between whole numbers: many logs count whole deg/s, and a command on an
        # edge would fall to one side.
        width = math.ceil(2.0 * np.abs(axis).max() / BINS) // 2 * 2 + 1
        bounds = width * (np.arange(BINS + 1) - BINS / 2)
        edges.append(bounds)
        counts.append(np.histogram(axis, bounds)[0])
        below = [_normal_below(float(bound), float(axis.mean()), float(axis.std())) for bound in bounds]
        normal.append(len(axis) * np.diff(below))
    return Histograms(np.array(edges), np.array(counts), np.round(normal, DIGITS))


def _normal_below(value: float, mean: float, sigma: float) -> float:
    """Return the share of a normal distribution below `value`; without a width all of it lies at the mean."""
    if sigma == 0.0:
        return float(value > mean)
    return 0.5 * math.erfc((mean - value) / (sigma * math.sqrt(2.0)))


def _deg_s(flight: Sticks) -> Array:
    """Return setpoints (N, 3) [deg/s], rounded to remove float32's error."""
    return np.asarray(np.round(np.rad2deg(flight.setpoint.astype(np.float64)), DIGITS), np.float64)


def _changes(flight: Sticks) -> Array:
    """Compute the change from row to row (N - 1, 3) [deg/s^2]."""
    return np.asarray(np.diff(_deg_s(flight), axis=0) / np.diff(flight.t)[:, None])
