"""Means over episodes with their 95 % confidence intervals. Pure functions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.arrays import Array, Flags

NORMAL = 1.959964  # 97.5 % quantile of the normal distribution
# The same of Student's t with 1 to 10 degrees of freedom.
STUDENT = (12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228)


@dataclass(frozen=True)
class Mean:
    """A mean with its 95 % confidence interval; (3,) each where there is one per axis.

    Where `count` is 0 there was nothing to take a mean of, and the others are 0.
    """

    value: Array
    low: Array
    high: Array
    count: NDArray[np.int64]  # how many episodes it is the mean of

    @property
    def significant(self) -> bool:
        """True if the interval excludes zero."""
        return bool(self.low > 0.0 or self.high < 0.0)

    def document(self) -> dict[str, float]:
        """Return the mean and its interval as JSON data."""
        return {name: float(getattr(self, name)) for name in ("value", "low", "high")}


def mean_of(values: Array, valid: Flags | None = None, each: int = 1) -> Mean:
    """Compute the mean of the `valid` values (E, ...) with Student's t interval, of a single one no width.

    valid: None: all of them.
    each: how many values one after another are of one flight. They depend on each other, so that the
    interval is that of as many independent values as there are flights: of the sums over a flight of what
    its values differ from the mean, the linearised ratio of two sums.
    """
    valid = np.ones(values.shape, bool) if valid is None else valid
    count = valid.sum(axis=0)
    some = np.maximum(count, 1)
    mean = np.where(valid, values, 0.0).sum(axis=0) / some
    residual = np.where(valid, values - mean, 0.0)
    flown = valid
    if each > 1:
        shape = (-1, each, *residual.shape[1:])
        residual = residual.reshape(shape).sum(axis=1)
        flown = np.asarray(valid.reshape(shape).any(axis=1))
    flights = np.maximum(flown.sum(axis=0), 1)
    freedom = np.maximum(flights - 1, 1)
    share = flights / some  # of a flight in its sum
    margin = student(freedom) * np.sqrt((residual**2).sum(axis=0) / freedom / flights) * share
    margin = np.where(flights > 1, margin, 0.0)  # else what rounding leaves of it
    return Mean(mean, mean - margin, mean + margin, count.astype(np.int64))


def paired(first: Array, second: Array) -> Mean:
    """Compute the mean of second - first with Student's t interval.

    first, second: (E,), or (E, A), of whose A differences each episode counts the mean. Pairs that lack a
    number (NaN) are left out.
    """
    difference = (second - first).reshape(len(first), -1)
    known = np.isfinite(difference)
    count = known.sum(axis=1)
    each = np.where(known, difference, 0.0).sum(axis=1) / np.maximum(count, 1)
    return mean_of(each, count > 0)


def share_of(hits: Flags, each: int = 1) -> Mean:
    """Compute the share of hits (E, ...), 0..1, with Wilson's interval, which has a width at 0 and at 1 too.

    each: see `mean_of`; the interval is that of as many hits and misses as there are flights.
    """
    count = len(hits)
    share = hits.mean(axis=0)
    z = NORMAL * NORMAL / (count / each)
    centre = (share + z / 2) / (1 + z)
    half = np.sqrt(z * share * (1 - share) + z * z / 4) / (1 + z)
    bounds = np.clip([centre - half, centre + half], 0.0, 1.0)
    return Mean(share, bounds[0], bounds[1], np.full(share.shape, count, np.int64))


def student(freedom: NDArray[np.integer]) -> Array:
    """Compute the 97.5 % quantile of Student's t; above 10 degrees of freedom by Cornish and Fisher."""
    z, n = NORMAL, np.maximum(freedom, 1).astype(np.float64)
    first, second = (z**3 + z) / 4, (5 * z**5 + 16 * z**3 + 3 * z) / 96
    third = (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / 384
    series = z + first / n + second / n**2 + third / n**3
    few = np.array(STUDENT)[np.clip(freedom, 1, len(STUDENT)) - 1]
    quantile: Array = np.where(freedom <= len(STUDENT), few, series)
    return quantile
