"""Estimated rotor speeds and rates against the twin's, and the equations against a second writing of them."""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

from neuroflight.sim.aircraft.model import Aircraft, FirstOrderResponse, load_aircraft
from neuroflight.sim.arrays import Array, Array32
from neuroflight.sim.control.estimator import Estimator, model_constants
from neuroflight.sim.control.motors import dshot_values, motor_fractions, throttle_mix
from neuroflight.sim.control.pid import aircraft_pid
from neuroflight.sim.physics.rotor import target_speed
from neuroflight.sim.physics.twin import Twin
from neuroflight.toolchain.errors import AircraftError
from neuroflight.toolchain.policy.model_constants import UNLIMITED, ModelConstants

EVERYONE = slice(None)
IDLE, RATE_HZ, STEPS, COUNT = 0.055, 1000, 2000, 6
# Four rotors, numbers that are exact in float32 and easy to follow.
MODEL = ModelConstants(
    delay_steps=2,
    speed_curve=(0.0, 1024.0, 0.0),
    rise=0.5,
    fall=0.25,
    gain_max=128.0,
    loss_max=64.0,
    correction=0.25,
    turn=((0.0, 0.0, 0.0, 0.0), (2.0**-12, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)),
    reaction=((0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 2.0**-6)),
)


@dataclass(frozen=True)
class Flown:
    """T control steps of N aircraft, true and estimated."""

    speed: Array  # (T, N, M) [rad/s]
    rate: Array  # (T, N, 3) [rad/s]
    estimated_speed: Array
    estimated_rate: Array


def speeds(estimator: Estimator, model: ModelConstants, count: int, idle: float = IDLE) -> Array:
    """The estimated speeds themselves: at throttle 0 those above rest at idle, whose speed is added."""
    a, b, c = model.speed_curve
    rest = (a * idle + b) * idle + c
    return estimator.rotor_estimate(EVERYONE, np.zeros(count, np.float32)).astype(np.float64) + rest


def fly(aircraft: Aircraft, samples: int) -> Flown:
    """Random commands, flown by the PID in the nominal twin without noise; `samples` of the twin a step."""
    rng = np.random.default_rng(5)
    model = model_constants(aircraft, RATE_HZ)
    pid, estimator = aircraft_pid(aircraft, COUNT, RATE_HZ), Estimator(model, COUNT, IDLE)
    twin = Twin(aircraft, COUNT, rate_hz=samples * RATE_HZ, noise=False, rng=rng)
    throttle = rng.uniform(0.1, 0.6, COUNT).astype(np.float32)
    rows: list[tuple[NDArray[np.floating], ...]] = []
    setpoint = np.zeros((COUNT, 3), np.float32)
    try:
        for k in range(STEPS // samples):
            if k % 200 == 0:
                setpoint = np.deg2rad(rng.normal(0.0, 100.0, (COUNT, 3))).astype(np.float32)
            rate, speed = twin.rate, twin.rotor_speed
            gyro = rate.astype(np.float32)
            estimator.observe(EVERYONE, np.ones((COUNT, 1), bool) if k == 0 else None, gyro)
            rows.append(
                (speed, rate, speeds(estimator, model, COUNT), estimator.rate_estimate(EVERYONE).copy())
            )
            u = throttle_mix(pid.step(setpoint, gyro, throttle), throttle)
            estimator.command(EVERYONE, u)
            for _ in range(samples):
                twin.step(motor_fractions(dshot_values(u, IDLE)))
    finally:
        twin.close()
    return Flown(*(np.array(column, np.float64) for column in zip(*rows, strict=True)))


@functools.cache
def fly_shipped(name: str, samples: int) -> Flown:
    return fly(load_aircraft(name), samples)


@pytest.mark.parametrize(("name", "samples"), [("nf1", 1), ("nf1", 4), ("hexa", 1), ("iris", 1)])
def test_estimated_speeds_are_the_twins_but_for_dshots_rounding(name: str, samples: int) -> None:
    flown = fly_shipped(name, samples)
    curve = np.diff(target_speed(np.linspace(0.0, 1.0, 2000), load_aircraft(name).propulsion))
    assert np.ptp(flown.speed[200:]) > 0.2 * flown.speed.max()  # it does fly
    assert np.abs(flown.estimated_speed - flown.speed).max() < 0.51 * curve.max() + 0.01


@pytest.mark.parametrize(("name", "most_deg_s"), [("nf1", 2.2), ("hexa", 1.0), ("iris", 1.5)])
def test_estimated_rates_follow_the_twins_where_a_low_pass_of_the_gyro_is_late(
    name: str, most_deg_s: float
) -> None:
    """What is left is the drag of rotors that a turn moves, above all in yaw: the model has none."""
    flown = fly_shipped(name, 1)
    gain, begun = model_constants(load_aircraft(name), RATE_HZ).correction, flown.rate[0]
    late = begun + lfilter([gain], [1.0, gain - 1.0], flown.rate - begun, axis=0)
    error = np.rad2deg(np.abs(flown.estimated_rate - flown.rate)).mean(axis=(0, 1))
    assert error.mean() < most_deg_s
    assert (error < 0.4 * np.rad2deg(np.abs(late - flown.rate)).mean(axis=(0, 1))).all()


def step(estimator: Estimator, u: float, gyro: float, count: int = 1, *, first: bool = False) -> Array32:
    """A control step: what is estimated of rates, before `u` is commanded to every motor."""
    rate = np.full((count, 3), gyro, np.float32)
    estimator.observe(EVERYONE, np.full((count, 1), first), rate)
    estimate = estimator.rate_estimate(EVERYONE).copy()
    estimator.command(EVERYONE, np.full((count, 4), u, np.float32))
    return estimate


def test_rotors_follow_commands_after_the_delay_by_their_shares_and_limits() -> None:
    estimator = Estimator(MODEL, 1, 0.0)
    seen = []
    for u in (0.125, 0.125, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0):
        step(estimator, u, 0.0)
        seen.append(float(speeds(estimator, MODEL, 1, 0.0)[0, 0]))
    # Commands of the steps 0, 1, 2, .. act in the steps 3, 4, 5, ..: half of the way to 128, then 128 a step
    # towards 1024, then at most 64 a step down.
    assert seen == [0.0, 0.0, 0.0, 64.0, 96.0, 224.0, 352.0, 288.0]


def test_the_rate_is_the_gyros_at_first_and_then_predicted_and_corrected() -> None:
    estimator = Estimator(MODEL, 1, 0.0)
    assert step(estimator, 0.125, 4.0, first=True).tolist() == [[4.0, 4.0, 4.0]]
    assert step(estimator, 0.125, 8.0).tolist() == [[5.0, 5.0, 5.0]]  # nothing turns: 4 + (8 - 4) / 4
    assert step(estimator, 0.125, 5.0).tolist() == [[5.0, 5.0, 5.0]]
    # Rotors at 64 rad/s, gained in this step: pitch 5 + 64^2 / 4096 = 6, yaw 5 + 64 / 64 = 6.
    assert step(estimator, 0.125, 2.0).tolist() == [[4.25, 5.0, 5.0]]


def test_bits_do_not_depend_on_how_many_are_estimated_together_or_apart() -> None:
    model, rng = model_constants(load_aircraft("nf1"), RATE_HZ), np.random.default_rng(8)
    together, apart = Estimator(model, 5, IDLE), Estimator(model, 5, IDLE)
    alone = [Estimator(model, 1, IDLE) for _ in range(5)]
    throttle = rng.uniform(0, 1, 5).astype(np.float32)
    for k in range(200):
        gyro, u = rng.normal(size=(5, 3)).astype(np.float32), rng.random((5, 4), np.float32)
        first = np.full((5, 1), k == 0)
        together.observe(EVERYONE, first, gyro)
        together.command(EVERYONE, u)
        for part in (np.array([0, 3]), np.array([4, 2, 1])):
            apart.observe(part, first[part], gyro[part])
            apart.command(part, u[part])
        for i, one in enumerate(alone):
            one.observe(EVERYONE, first[:1], gyro[i : i + 1])
            one.command(EVERYONE, u[i : i + 1])
    wanted = together.rate_estimate(EVERYONE), together.rotor_estimate(EVERYONE, throttle)
    shown = apart.rate_estimate(EVERYONE), apart.rotor_estimate(EVERYONE, throttle)
    assert [a.tobytes() for a in shown] == [b.tobytes() for b in wanted]
    for i, one in enumerate(alone):
        assert one.rate_estimate(EVERYONE).tobytes() == wanted[0][i].tobytes()
        assert one.rotor_estimate(EVERYONE, throttle[i : i + 1]).tobytes() == wanted[1][i].tobytes()
    assert all(array.dtype == np.float32 for array in wanted)


def test_the_estimate_of_rotors_is_zero_where_they_rest_under_the_throttle() -> None:
    model = model_constants(load_aircraft("nf1"), RATE_HZ)
    estimator, throttle = Estimator(model, 1, IDLE), np.full(1, 0.3, np.float32)
    for _ in range(2000):
        estimator.observe(EVERYONE, None, np.zeros((1, 3), np.float32))
        estimator.command(EVERYONE, np.full((1, 4), 0.3, np.float32))
    assert np.abs(estimator.rotor_estimate(EVERYONE, throttle)).max() < 0.01
    assert (estimator.rotor_estimate(EVERYONE, throttle + np.float32(0.1)) < -50.0).all()


def test_rotors_with_a_lag_are_the_twins_too() -> None:
    response = FirstOrderResponse(time_constant_up=0.03, time_constant_down=0.06)
    lagging = replace(
        load_aircraft("nf1"), propulsion=replace(load_aircraft("nf1").propulsion, response=response)
    )
    model = model_constants(lagging, RATE_HZ)
    assert (model.gain_max, model.loss_max) == (UNLIMITED, UNLIMITED)
    assert (model.rise, model.fall) == pytest.approx((1 - np.exp(-1 / 30), 1 - np.exp(-1 / 60)))
    flown = fly(lagging, 1)
    assert np.abs(flown.estimated_speed - flown.speed).max() < 1.0


def test_an_aircraft_is_refused_when_no_model_can_say_it() -> None:
    with pytest.raises(AircraftError, match=r"aircraft nf1: its delay .* is 16 control steps, a model has"):
        model_constants(load_aircraft("nf1"), 8000)
