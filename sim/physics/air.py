"""Drag of the body, wind with the Dryden model's gusts, and prop wash, of N aircraft. Computed by air.c."""

from __future__ import annotations

import math

import numpy as np

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.arrays import Array, Indices
from neuroflight.sim.physics.library import library, pointer, random_source, struct
from neuroflight.toolchain.contract import GRAVITY

AIR_DENSITY = 1.225  # [kg/m^3], ISO 2533 standard atmosphere at sea level
FOOT = 0.3048  # [m]
# Prop wash: a rotor that sinks about as fast as the air that it drives down is in the vortex ring state: its
# thrust fluctuates; v_i = sqrt(T / (2 rho A)) is what it induces in hover with its thrust T. How much: up
# to 95 % from peak to peak (Stack, Caradonna, Savas 2004), six standard deviations of 0.16. How slow: rings
# leave every 20 to 50 revolutions, so the 3 Hz of an NF1 are 0.075 of its v_i / D. Where: up to sink rates of
# 1.2 to 1.3 v_i (Veismann, Dougherty, Gharib 2023), over at 2 v_i by momentum theory. Held against one public
# log of a 5-inch (docs/explanation/decisions/simulation.md), on which the band's upper end rests alone; from
# memory of Johnson 2005, NASA/TP-2005-213477: that sideways motion at 0.95 v_i leaves the wake behind.
WASH_SHARE = 0.15  # standard deviation over the thrust, in the worst descent
WASH_SINK = (0.1, 2.0)  # over v_i, beyond which it ends; a parabola between
WASH_SIDEWAYS = 0.95  # over v_i, where it ends
WASH_BAND = (0.075, 1.8)  # frequencies of half power, over v_i / D of the hover
ALTITUDE_MIN, ALTITUDE_MAX = 10 * FOOT, 1000 * FOOT  # [m], where MIL-F-8785C's low-altitude model holds


def turbulence_scale(altitude: float) -> Array:
    """Compute the scale lengths L_u, L_v, L_w of the gusts [m], (3,), at `altitude` [m] above the ground.

    Source: MIL-F-8785C (1980), 3.7.3.4: L_w = h, L_u = L_v = h / (0.177 + 0.000823 h)^1.2, h in feet from
    10 to 1000; an altitude outside is taken as the nearer end.
    """
    feet = _feet(altitude)
    across = feet / (0.177 + 0.000823 * feet) ** 1.2
    return np.array([across, across, feet]) * FOOT


def turbulence_intensity(altitude: float, wind_speed: float) -> Array:
    """Compute the standard deviations s_u, s_v, s_w of the gusts [m/s], (3,), at `altitude` [m].

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

    def reset(self, index: Indices) -> None:
        """Draw new gusts around the aircraft of `index` from the turbulence's own distribution."""
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


class Wash:
    """Prop wash around the rotors of N aircraft: noise of their thrust, each rotor's own, while they sink.

    It is white noise behind a band-pass of second order, whose half-power frequencies are `wash_band`'s, and
    stepped exactly. All random numbers come from `rng`.

    noise: of each rotor as it is, variance 1, (N, M).
    """

    def __init__(self, aircraft: Aircraft, count: int, dt: float, rng: np.random.Generator) -> None:
        """Draw the noise of each rotor as `reset` does; the aircraft's propellers have a diameter."""
        diameter = aircraft.propulsion.propeller_diameter
        assert diameter is not None
        shape = (count, aircraft.motor_count)
        self._rng = rng
        self._lag, self.noise = np.zeros(shape), np.zeros(shape)
        self._draws = np.zeros((2, *shape))
        turn, gain = _band_pass(wash_band(aircraft), dt)
        self.state = struct(
            "wash",
            random=random_source(rng),
            turn=turn.ravel().tolist(),
            gain=(gain[0, 0], gain[1, 0], gain[1, 1]),
            root=_induced_velocity(1.0, diameter),
            share=WASH_SHARE,
            begin=WASH_SINK[0],
            end=WASH_SINK[1],
            sideways=WASH_SIDEWAYS,
            draws=self._draws,
            lag=self._lag,
            noise=self.noise,
        )
        self.reset(np.arange(count))

    def reset(self, index: Indices) -> None:
        """Draw new noise for the rotors of the aircraft of `index` from its own distribution."""
        self._lag[index], self.noise[index] = self._rng.standard_normal((2, len(index), self._lag.shape[1]))


def wash_band(aircraft: Aircraft) -> tuple[float, float]:
    """Compute the half-power frequencies of an aircraft's prop wash [Hz]; its propellers have a diameter."""
    diameter = aircraft.propulsion.propeller_diameter
    assert diameter is not None
    thrust = aircraft.mass_properties.mass * GRAVITY / aircraft.motor_count
    eddies = _induced_velocity(thrust, diameter) / diameter
    return WASH_BAND[0] * eddies, WASH_BAND[1] * eddies


def _induced_velocity(thrust: float, diameter: float) -> float:
    """Compute the velocity [m/s] that a hovering rotor induces with `thrust` [N]: momentum theory."""
    return math.sqrt(thrust / (2.0 * AIR_DENSITY * math.pi * (diameter / 2.0) ** 2))


def _band_pass(band: tuple[float, float], dt: float) -> tuple[Array, Array]:
    """Compute matrices (2, 2) of s' = turn s + gain n for white noise n; s[1], variance 1, is the output.

    dp/dt = w v, dv/dt = -w p - 2 z w v + noise, over `dt` [s]: `turn` is the exponential without the noise,
    which adds what `turn` takes from the stationary covariance, the unit matrix.
    """
    low, high = band
    w = 2.0 * math.pi * math.sqrt(low * high)
    z = (high - low) / (2.0 * math.sqrt(low * high))  # above 1 for bands wider than a factor of 5.8
    apart = math.sqrt(z * z - 1.0)
    kept, c, s = math.exp(-z * w * dt), math.cosh(apart * w * dt), math.sinh(apart * w * dt) / apart
    turn = kept * np.array([[c + z * s, s], [-s, c - z * s]])
    added: Array = np.linalg.cholesky(np.eye(2) - turn @ turn.T).astype(np.float64)
    return turn, added


def _feet(altitude: float) -> float:
    return min(max(altitude, ALTITUDE_MIN), ALTITUDE_MAX) / FOOT
