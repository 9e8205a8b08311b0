"""Observation blocks by their definitions."""

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


def test_blocks_stand_in_the_order_of_their_names() -> None:
    names = "throttle,rate,previous_action,rate_error"
    observer = Observer(observation_blocks(names), 1, 4, 1000)
    assert look(observer, 3.0, 1.0)[0].tolist() == [0.5, 1, 1, 1, 0.25, 0.25, 0.25, 0.25, 2, 2, 2]


def test_delta_is_zero_on_the_first_step_and_after_a_reset() -> None:
    observer = Observer(observation_blocks("rate_error_delta"), 2, 4, 1000)
    assert look(observer, 3.0, 1.0, 2)[0].tolist() == [0, 0, 0]
    assert look(observer, 3.0, 2.5, 2)[0].tolist() == [-1.5, -1.5, -1.5]
    observer.reset(np.array([1]))
    assert look(observer, 3.0, 2.0, 2).tolist() == [[0.5] * 3, [0.0] * 3]


def test_integral_sums_error_over_time_and_stops_at_its_limit() -> None:
    observer = Observer(observation_blocks("rate_error_integral"), 1, 4, 1000)
    for _ in range(100):
        seen = look(observer, 1.0, 0.0)
    assert seen[0] == pytest.approx([0.1] * 3, rel=1e-5)
    for _ in range(1000):
        seen = look(observer, 1.0, 0.0)
    assert seen[0] == pytest.approx([0.6] * 3)


def test_part_of_the_aircraft_can_be_observed_without_touching_the_others() -> None:
    observer = Observer(observation_blocks("rate_error_delta,rate_error_integral"), 2, 4, 1000)
    look(observer, 1.0, 0.0, 2)
    one = np.ones((1, 3), np.float32)
    observer.observe(np.array([0]), 2 * one, 0 * one, np.zeros((1, 4), np.float32), np.zeros(1, np.float32))
    after = look(observer, 3.0, 0.0, 2)
    assert after[:, 0].tolist() == [1.0, 2.0]
    assert after[:, 3] == pytest.approx([0.006, 0.004], rel=1e-5)


def test_limits_cover_every_block_of_the_contract() -> None:
    low, high = limits(tuple(map(ObservationTerm, OBSERVATION_BLOCKS)), 4)
    assert len(low) == sum(block.count(4) for block in OBSERVATION_BLOCKS)
    assert (low < high).all()
    assert np.isfinite([low, high]).all()


def test_low_pass_starts_at_its_first_value_and_follows_by_its_gain() -> None:
    (term,) = observation_blocks("rate~15Hz")
    gain = term.gain(1000)
    assert gain == pytest.approx(1.0 - np.exp(-2 * np.pi * 15 / 1000), rel=1e-7)
    observer = Observer((term,), 2, 4, 1000)
    assert look(observer, 0.0, 3.0, 2)[:, 0].tolist() == [3.0, 3.0]
    assert look(observer, 0.0, 5.0, 2)[:, 0] == pytest.approx([3.0 + 2.0 * gain] * 2, rel=1e-6)
    observer.reset(np.array([1]))
    assert look(observer, 0.0, 5.0, 2)[:, 0] == pytest.approx([5.0 - 2.0 * (1 - gain) ** 2, 5.0], rel=1e-6)


def test_delayed_values_come_after_their_delay_and_are_zero_before_the_reset() -> None:
    observer = Observer(observation_blocks("rate@2,rate"), 2, 4, 1000)
    seen = [look(observer, 0.0, value, 2)[0, [0, 3]].tolist() for value in (1.0, 2.0, 3.0, 4.0)]
    assert seen == [[0, 1], [0, 2], [1, 3], [2, 4]]
    observer.reset(np.array([1]))
    assert [look(observer, 0.0, value, 2)[:, 0].tolist() for value in (5.0, 6.0, 7.0)] == [
        [3, 0],
        [4, 0],
        [5, 5],
    ]


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


def test_previous_motors_are_the_last_fractions_less_the_throttle_of_their_step() -> None:
    observer = Observer(observation_blocks("previous_motors"), 2, 4, 1000)
    assert look(observer, 0.0, 0.0, 2).tolist() == [[0.0] * 4] * 2
    fractions = np.array([[0.5, 0.75, 0.25, 1.0], [0.0, 0.5, 0.5, 0.0]], np.float32)
    observer.commanded(EVERYONE, fractions, np.array([0.5, 0.25], np.float32))
    assert look(observer, 0.0, 0.0, 2).tolist() == [[0, 0.25, -0.25, 0.5], [-0.25, 0.25, 0.25, -0.25]]
    observer.reset(np.array([0]))
    assert look(observer, 0.0, 0.0, 2)[:, 0].tolist() == [0.0, -0.25]


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


def test_estimates_of_part_of_the_aircraft_begin_anew_without_touching_the_others() -> None:
    model = model_constants(load_aircraft("nf1"), 1000)
    observer = Observer(observation_blocks(ESTIMATED), 2, 4, 1000, model=model, idle=0.055)
    fractions, throttle = np.full((2, 4), 0.5, np.float32), np.full(2, 0.25, np.float32)

    def run(steps: int) -> np.ndarray:
        for _ in range(steps):
            seen = look(observer, 1.0, 0.5, 2)
            observer.commanded(EVERYONE, fractions, throttle)
        return seen

    begun = run(1)
    later = run(30)
    assert not np.array_equal(begun, later)
    observer.reset(np.array([1]))
    again = run(1)
    assert again[1].tobytes() == begun[1].tobytes()
    assert (again[0, 4:8] > later[0, 4:8]).all()  # its rotors gain speed still


def test_an_observation_is_refused_when_its_model_is_missing() -> None:
    for name in ("rotor_estimate", "rate_estimate", "rate_estimate_error"):
        with pytest.raises(ValueError, match="needs a model of the aircraft, got none"):
            Observer(observation_blocks(f"rate,{name}"), 1, 4, 1000)
