"""Two clocks of one log: the sensor's own and the host's, on which its lines arrive late, never early."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neuroflight.sim.arrays import Array, Indices
from neuroflight.toolchain.errors import DynoError

DRIFT_MAX = 0.05  # of a microcontroller's ceramic resonator: 0.005
LONG_S = 2.0  # shorter logs do not show a drift


@dataclass(frozen=True)
class Clock:
    """host = origin + rate (own - zero), of the earliest arrivals; all in seconds but the rate."""

    zero: float  # of the sensor's clock, to keep digits
    origin: float  # of the host's clock
    rate: float  # host seconds a second of the sensor's: 1 where it does not drift
    late: float  # mean time by which lines arrived after the earliest

    def host(self, own: Array) -> Array:
        """Convert to times of the host's clock, (N,)."""
        return self.origin + self.rate * (own - self.zero)


def fit_clock(own: Array, arrival: Array, drift_max: float = DRIFT_MAX) -> Clock:
    """Fit the host's clock to the sensor's, (N,) each [s], `own` rising.

    A line may be late by any time, so that the fit is the line below all points that lies closest to them:
    an edge of their lower hull. The shortest latency of the line cannot be told from an offset and stays in
    the times. Raises DynoError where the clocks differ by more than `drift_max`.
    """
    x, y = own - own[0], arrival - arrival[0]
    rate = 1.0
    if x[-1] >= LONG_S:
        low = _lower_hull(x, y)
        # The mean of the points lies above exactly one edge: the line that the sum of distances is least to.
        edge = int(np.clip(np.searchsorted(x[low], x.mean()), 1, len(low) - 1))
        first, last = low[edge - 1], low[edge]
        rate = float((y[last] - y[first]) / (x[last] - x[first]))
        if not abs(rate - 1.0) <= drift_max:
            raise DynoError(
                f"the sensor's clock runs {1 / rate if rate > 0 else np.inf:.4g} times as fast as this "
                f"computer's, expected within {drift_max:.0%}; is the unit in its column's name right?"
            )
    off = float((y - rate * x).min())
    late = float((y - rate * x - off).mean())
    return Clock(float(own[0]), float(arrival[0]) + off, rate, late)


def _lower_hull(x: Array, y: Array) -> Indices:
    """Return the indices of the lower convex hull of points whose x rises."""
    hull: list[int] = []
    for index in range(len(x)):
        while len(hull) > 1:
            a, b = hull[-2], hull[-1]
            if (y[b] - y[a]) * (x[index] - x[b]) < (y[index] - y[b]) * (x[b] - x[a]):
                break
            hull.pop()
        hull.append(index)
    return np.array(hull, np.intp)
