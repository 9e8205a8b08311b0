"""Observations that no C has, and of many aircraft; the rest is C's to the bit: tests/firmware/control."""

import numpy as np
import pytest

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.control.estimator import Estimator, model_constants
from neuroflight.sim.control.observation import Observer, limits
from neuroflight.toolchain.contract import OBSERVATION_BLOCKS, ObservationTerm, observation_blocks

EVERYONE = slice(None)


def look(observer: Observer, setpoint: float, rate: float, count: int = 1) -> np.ndarray:
    return observer.observe(
        EVERYONE,
        np.full((count, 3), setpoint, np.float32),
        np.full((count, 3), rate, np.float32),
        np.full((count, 4), 0.25, np.float32),
        np.full(count, 0.5, np.float32),
    )


def test_limits_cover_every_block_of_the_contract() -> None:
    low, high = limits(tuple(map(ObservationTerm, OBSERVATION_BLOCKS)), 4)
    assert len(low) == sum(block.count(4) for block in OBSERVATION_BLOCKS)
    assert (low < high).all()
    assert np.isfinite([low, high]).all()


def test_rotor_speed_and_gravity_are_observed_when_given_and_missed_when_not() -> None:
    observer = Observer(observation_blocks("gravity,rotor_speed"), 1, 4, 1000)
    with pytest.raises(ValueError, match="needs gravity"):
        look(observer, 0.0, 0.0)
    one = np.zeros((1, 3), np.float32)
    speed, down = np.array([[1, 2, 3, 4]], np.float32), np.array([[0, 0, -1]], np.float32)
    throttle = np.zeros(1, np.float32)
    seen = observer.observe(EVERYONE, one, one, speed, throttle, rotor_speed=speed, gravity=down)
    assert seen[0].tolist() == [0, 0, -1, 1, 2, 3, 4]


ESTIMATED = "previous_motors,rotor_estimate,rate_estimate,rate_estimate_error"


def test_estimates_are_those_of_the_model_at_the_policys_idle() -> None:
    model = model_constants(load_aircraft("nf1"), 1000)
    terms = observation_blocks(ESTIMATED + ",rate_estimate@2")
    observer, estimator = Observer(terms, 3, 4, 1000, model=model, idle=0.055), Estimator(model, 3, 0.055)
    rng, estimates = np.random.default_rng(3), [np.zeros((3, 3), np.float32)] * 2
    throttle = rng.random(3, np.float32)
    for k in range(20):
        setpoint, gyro = rng.normal(size=(2, 3, 3)).astype(np.float32)
        seen = observer.observe(EVERYONE, setpoint, gyro, np.zeros((3, 4), np.float32), throttle)
        estimator.observe(EVERYONE, np.full((3, 1), k == 0), gyro)
        estimates.append(estimator.rate_estimate(EVERYONE).copy())
        assert seen[:, 4:8].tobytes() == estimator.rotor_estimate(EVERYONE, throttle).tobytes()
        assert seen[:, 8:11].tobytes() == estimates[-1].tobytes()
        assert seen[:, 11:14].tobytes() == (setpoint - estimates[-1]).tobytes()
        assert seen[:, 14:].tobytes() == estimates[-3].tobytes()
        fractions = rng.random((3, 4), np.float32)
        observer.commanded(EVERYONE, fractions, throttle)
        estimator.command(EVERYONE, fractions)


def test_an_observation_is_refused_when_its_model_is_missing() -> None:
    for name in ("rotor_estimate", "rate_estimate", "rate_estimate_error"):
        with pytest.raises(ValueError, match="needs a model of the aircraft, got none"):
            Observer(observation_blocks(f"rate,{name}"), 1, 4, 1000)


def flown(observer: Observer, which: slice, *given: np.ndarray) -> np.ndarray:
    setpoint, rate, previous, fractions, throttle = given
    observation = observer.observe(which, setpoint, rate, previous, throttle)
    observer.commanded(which, fractions, throttle)
    return observation


def test_an_aircraft_that_is_reset_or_observed_alone_leaves_the_others_as_they_are() -> None:
    model = model_constants(load_aircraft("nf1"), 1000)
    terms = observation_blocks(f"{ESTIMATED},rate_error_delta,rate_error_integral,rate~15Hz,rate@2")
    together, alone, fresh = (Observer(terms, n, 4, 1000, model=model, idle=0.055) for n in (2, 1, 1))
    rng = np.random.default_rng(4)
    for step in range(60):
        setpoint, gyro = rng.normal(size=(2, 2, 3)).astype(np.float32)
        fractions, throttle = rng.random((2, 4), np.float32), rng.random(2, np.float32)
        if step == 20:
            together.reset(np.array([1]))
        row = slice(1) if 30 <= step < 40 else EVERYONE  # for a while only the first is observed

        given = setpoint, gyro, fractions, fractions, throttle
        seen = flown(together, row, *(each[row] for each in given))
        assert seen[0].tobytes() == flown(alone, EVERYONE, *(each[:1] for each in given))[0].tobytes()
        if step >= 20 and row == EVERYONE:
            assert seen[1].tobytes() == flown(fresh, EVERYONE, *(each[1:] for each in given))[0].tobytes()
