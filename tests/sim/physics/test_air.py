"""Drag and wind against closed forms.

Statistical bounds are five standard errors: a right model fails one of them in about two million seeds.
"""

import math
from dataclasses import replace

import numpy as np
import pytest

from neuroflight.sim.aircraft.mass import Vector
from neuroflight.sim.aircraft.model import Body, load_aircraft
from neuroflight.sim.arrays import Array
from neuroflight.sim.physics.air import Wind, turbulence_intensity, turbulence_scale
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.physics.world import Mount
from tests.sim.physics.flying import repeat

GUST, AIRSPEED = 10.0, 12.0  # [m/s]
MEAN = np.array([3.0, 4.0, 0.0])
SIGMAS = 5.0


def along(wind: Wind, mean: Array) -> Array:
    """Gusts as u, v, w [m/s], (N, 3): along the mean wind, across it to the left, up."""
    u = mean / np.linalg.norm(mean)
    axes = np.array([u, [-u[1], u[0], 0.0], [0.0, 0.0, 1.0]])
    return np.asarray((wind.velocity - mean) @ axes.T)


def correlation(lag: Array, scale: Array) -> Array:
    """Autocorrelation of Dryden u, v, w at `lag` [s] for time scales `scale` [s], (lags, 3)."""
    ratio = lag[:, None] / scale
    return np.asarray(np.exp(-ratio) * (1 - ratio / 2 * np.array([0.0, 1.0, 1.0])))


@pytest.mark.parametrize("wind", [(3.0, 0.0, 4.0), (6.0, 0.0, 8.0), (-10.0, 0.0, 0.0), (2.0, -3.0, 6.0)])
def test_drag_is_quadratic_along_the_air_by_each_axis_own_area(wind: Vector) -> None:
    area = (0.01, 0.02, 0.05)
    nf1 = load_aircraft("nf1")
    still = replace(nf1.propulsion, speed_curve=(0.0, 1e-9, 0.0), drag_coefficient=0.0)
    body = Body((0.2, 0.2, 0.1), (0.0, 0.0, 0.0), area)
    rng, bare = np.random.default_rng(0), replace(nf1, propulsion=still, body=body)
    twin = Twin(bare, rng=rng, wind=wind, mount=Mount.FREE, gravity=False, noise=False)
    twin.step(np.zeros((1, 4)))
    force = twin.specific_force[0] * nf1.mass_properties.mass
    assert force == pytest.approx(0.5 * 1.225 * np.linalg.norm(wind) * np.array(area) * wind, rel=1e-9)


def test_turbulence_is_the_standards_when_at_100_and_1000_feet() -> None:
    # By hand from MIL-F-8785C, feet: 100 / 0.2593^1.2 = 505.1, 0.1 / 0.2593^0.4 = 0.1716.
    assert turbulence_scale(30.48) == pytest.approx([505.1 * 0.3048, 505.1 * 0.3048, 30.48], rel=1e-3)
    assert turbulence_intensity(30.48, 10.0) == pytest.approx([1.716, 1.716, 1.0], rel=1e-3)
    # At 1000 ft the model meets the isotropic one above: all scales 1000 ft, all intensities equal.
    assert turbulence_scale(304.8) == pytest.approx([304.8] * 3, rel=1e-3)
    assert turbulence_intensity(304.8, 10.0) == pytest.approx([1.0] * 3, rel=1e-3)


@pytest.mark.parametrize(("altitude", "edge"), [(0.5, 3.048), (2000.0, 304.8)])
def test_turbulence_is_that_of_the_edge_when_outside_the_model(altitude: float, edge: float) -> None:
    assert turbulence_scale(altitude).tolist() == turbulence_scale(edge).tolist()
    assert turbulence_intensity(altitude, 5.0).tolist() == turbulence_intensity(edge, 5.0).tolist()


@pytest.mark.parametrize("dt", [0.05, 0.2])
def test_gusts_have_the_models_variance_and_correlation_when_steps_are_coarse(dt: float) -> None:
    """Over many aircraft, at every lag up to 3 s; a step is a fifth or most of the shortest time scale."""
    count, altitude = 20_000, 3.048
    airspeed = np.full(count, AIRSPEED)
    wind = Wind(MEAN, GUST, altitude, count, dt, np.random.default_rng(7))
    start = along(wind, MEAN)
    lags = dt * np.arange(1.0, round(3 / dt) + 1)
    sigma = turbulence_intensity(altitude, GUST)
    error = SIGMAS * math.sqrt(2 / count)
    for row in correlation(lags, turbulence_scale(altitude) / AIRSPEED):
        wind.step(airspeed)
        now = along(wind, MEAN)
        assert (now * now).mean(axis=0) == pytest.approx(sigma**2, rel=error)
        assert (start * now).mean(axis=0) / sigma**2 == pytest.approx(row, abs=error)
    cross = now.T @ now / count / np.outer(sigma, sigma)
    assert np.abs(cross[np.triu_indices(3, 1)]).max() < error


@pytest.mark.parametrize("dt", [0.001, 0.004])
def test_gusts_have_the_models_variance_and_correlation_when_stepped_as_in_flight(dt: float) -> None:
    """Over the record of 64 aircraft of 25 s each, seen every 0.1 s; the same model at 1 ms and at 4 ms."""
    count, every, altitude = 64, round(0.1 / dt), 3.048
    scale = turbulence_scale(altitude) / AIRSPEED
    wind = Wind(np.zeros(3), GUST, altitude, count, dt, np.random.default_rng(3))
    airspeed = np.full(count, AIRSPEED)
    record = np.empty((250, count, 3))
    for row in record:
        repeat(every, wind.step, airspeed)
        row[:] = wind.velocity
    record /= turbulence_intensity(altitude, GUST)
    # A record of length T of a process with time constant tau is worth about T / 2 tau independent draws.
    bound = SIGMAS * np.sqrt(2 / (count * 25.0 / (2 * scale)))
    assert (np.abs((record**2).mean(axis=(0, 1)) - 1.0) < bound).all()
    for lag in (2, 5, 20):
        seen = (record[lag:] * record[:-lag]).mean(axis=(0, 1))
        model = correlation(np.array([0.1 * lag]), scale)[0]
        assert (np.abs(seen - model) < bound).all()


def test_gusts_are_constant_when_the_aircraft_stands_in_the_air() -> None:
    wind = Wind(np.zeros(3), GUST, 2.0, 8, 0.001, np.random.default_rng(1))
    before = wind.velocity.copy()
    wind.step(np.zeros(8))
    assert wind.velocity.tolist() == before.tolist()


def test_variance_is_kept_when_the_airspeed_changes() -> None:
    count = 40_000
    rng = np.random.default_rng(5)
    wind = Wind(np.zeros(3), GUST, 3.048, count, 0.01, rng)
    for airspeed in (0.0, 3.0, 40.0, 0.5, 300.0, 20.0):
        wind.step(np.full(count, airspeed))
    sigma = turbulence_intensity(3.048, GUST)
    spread = wind.velocity.std(axis=0) / sigma
    assert spread == pytest.approx([1.0] * 3, rel=SIGMAS / math.sqrt(2 * count))


def test_wind_is_steady_when_there_are_no_gusts() -> None:
    rng = np.random.default_rng(1)
    wind = Wind(MEAN, 0.0, 10.0, 3, 0.001, rng)
    wind.step(np.full(3, 9.0))
    wind.reset(np.array([1]))
    assert wind.velocity.tolist() == [MEAN.tolist()] * 3
    assert rng.random() == np.random.default_rng(1).random()


def test_reset_draws_anew_only_for_those_named_when_given_an_index() -> None:
    wind = Wind(MEAN, GUST, 10.0, 4, 0.001, np.random.default_rng(1))
    before = wind.velocity.copy()
    wind.reset(np.array([0, 2]))
    same = (wind.velocity == before).all(axis=1)
    assert same.tolist() == [False, True, False, True]


@pytest.mark.parametrize(
    ("mean", "gust", "altitude"),
    [
        ([math.nan, 0, 0], 1.0, 1.0),
        ([0, 0, 0], -1.0, 1.0),
        ([0, 0, 0], math.inf, 1.0),
        ([0, 0, 0], 1.0, math.nan),
    ],
)
def test_wind_refuses_when_numbers_are_not_finite(mean: list[float], gust: float, altitude: float) -> None:
    with pytest.raises(ValueError, match="expected finite"):
        Wind(np.array(mean), gust, altitude, 1, 0.001, np.random.default_rng(0))
