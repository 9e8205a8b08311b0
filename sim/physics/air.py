"""Drag of the body, and wind with the Dryden model's gusts, of N aircraft. Computed by air.c."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sim.physics.library import library, pointer, random_source, struct

Array = NDArray[np.float64]

AIR_DENSITY = 1.225  # [kg/m^3], ISO 2533 standard atmosphere at sea level
FOOT = 0.3048  # [m]
ALTITUDE_MIN, ALTITUDE_MAX = 10 * FOOT, 1000 * FOOT  # [m], where MIL-F-8785C's low-altitude model holds


def body_drag(air_velocity: Array, drag_area: Array) -> Array:
    """Drag force on the body [N], (N, 3): -1/2 rho |v| (C_D A) v, each axis with its own C_D A.

    air_velocity: of the body through the air [m/s], (N, 3), body axes. drag_area: C_D A [m^2], (3,).
    """
    velocity, area = (np.ascontiguousarray(rows, np.float64) for rows in (air_velocity, drag_area))
    force = np.empty_like(velocity)
    library().lib.air_drag(len(velocity), AIR_DENSITY, pointer(velocity), pointer(area), pointer(force))
    return force


def turbulence_scale(altitude: float) -> Array:
    """Scale lengths L_u, L_v, L_w of the gusts [m], (3,), at `altitude` [m] above the ground.

    Source: MIL-F-8785C (1980), 3.7.3.4: L_w = h, L_u = L_v = h / (0.177 + 0.000823 h)^1.2, h in feet from
    10 to 1000; an altitude outside is taken as the nearer end.
    """
    feet = _feet(altitude)
    across = feet / (0.177 + 0.000823 * feet) ** 1.2
    return np.array([across, across, feet]) * FOOT


def turbulence_intensity(altitude: float, wind_speed: float) -> Array:
    """Standard deviations s_u, s_v, s_w of the gusts [m/s], (3,), at `altitude` [m].

    wind_speed: mean wind 20 feet above the ground [m/s]; 7.7 is light turbulence, 15.4 moderate, 23.1
    severe. Source: MIL-F-8785C, 3.7.3.4: s_w = W_20 / 10, s_u = s_v = s_w / (0.177 + 0.000823 h)^0.4.
    """
    vertical = 0.1 * wind_speed
    across = vertical / (0.177 + 0.000823 * _feet(altitude)) ** 0.4
    return np.array([across, across, vertical])


class Wind:
    """Mean wind and Dryden gusts around N aircraft, each with gusts of its own.

    mean: (3,) world axes [m/s]. gust: wind speed 20 feet above the ground that sets the turbulence [m/s];
    0 is a steady wind. u of the gusts blows along the mean wind's horizontal part (along x without one), w
    along world z. The turbulence is frozen: an aircraft meets it as fast as it moves through the air, and
    one that stands still in it meets a constant wind.

    The spectra of MIL-F-8785C are those of white noise behind s sqrt(2 T) / (1 + T s) for u, T = L_u / V, and
    s sqrt(T) (1 + sqrt(3) T s) / (1 + T s)^2 for v and w. They are stepped exactly, so that variance and
    correlation depend neither on `dt` nor on changes of airspeed. All random numbers come from `rng`.
    """

    def __init__(
        self, mean: Array, gust: float, altitude: float, count: int, dt: float, rng: np.random.Generator
    ) -> None:
        if not (np.isfinite(mean).all() and math.isfinite(altitude) and 0.0 <= gust < math.inf):
            raise ValueError(
                f"wind {mean} m/s, gust {gust} m/s at {altitude} m: expected finite, gust 0 or more"
            )
        self.velocity = np.tile(np.asarray(mean, dtype=np.float64), (count, 1))  # of the air, world axes
        self._count, self._steady, self._rng = count, gust == 0.0, rng
        heading = math.atan2(mean[1], mean[0])
        c, s = math.cos(heading), math.sin(heading)
        # Two lags in a row, white noise into the first; variances 1 and 1/2, covariance 1/2.
        self._first = np.zeros((count, 3))
        self._second = np.zeros((count, 3))
        self._draws = np.zeros((2, count, 3))
        self.state = struct(
            "wind",
            steady=self._steady,
            random=random_source(rng),
            mean=np.asarray(mean, np.float64).tolist(),
            decay=(dt / turbulence_scale(altitude)).tolist(),  # of each axis, for each m/s of airspeed
            gain=turbulence_intensity(altitude, gust).tolist(),
            axes=(c, s, 0.0, -s, c, 0.0, 0.0, 0.0, 1.0),  # rows: u, v, w in the world
            draws=self._draws,
            first=self._first,
            second=self._second,
            velocity=self.velocity,
        )
        self.reset(np.arange(count))

    def reset(self, index: NDArray[np.intp]) -> None:
        """New gusts around the aircraft of `index`, drawn from the turbulence's own distribution."""
        if self._steady:
            return
        draws = self._rng.standard_normal((len(index), 2, 3))
        self._first[index] = draws[:, 0]
        self._second[index] = 0.5 * (draws[:, 0] + draws[:, 1])
        library().lib.wind_blow(self.state, self._count)

    def step(self, airspeed: Array) -> None:
        """Advance the gusts by `dt` around aircraft that move through the air at `airspeed` [m/s], (N,)."""
        speeds = np.ascontiguousarray(airspeed, np.float64)
        library().lib.wind_step(self.state, self._count, pointer(speeds))


def _feet(altitude: float) -> float:
    return min(max(altitude, ALTITUDE_MIN), ALTITUDE_MAX) / FOOT
