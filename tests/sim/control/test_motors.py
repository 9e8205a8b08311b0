"""Throttle mix and DShot values by their formulas."""

import numpy as np
import pytest

from sim.control.motors import dshot_values, each_fraction, motor_commands, motor_fractions, throttle_mix
from toolchain.errors import LinkError


def test_the_mix_is_the_output_itself_when_the_throttle_is_zero() -> None:
    y = np.array([[0.1, 0.5, 0.0, 1.0]], np.float32)
    assert np.array_equal(throttle_mix(y, np.zeros(1, np.float32)), y)


def test_attitude_comes_first_when_there_is_no_room_left() -> None:
    y = np.array([[0.0, 1.0, 0.25, 0.5]], np.float32)
    assert np.array_equal(throttle_mix(y, np.ones(1, np.float32)), y)


def test_thrust_rides_on_top_within_bounds_for_any_output() -> None:
    rng = np.random.default_rng(3)
    y = rng.uniform(0, 1, (1000, 4)).astype(np.float32)
    throttle = rng.uniform(0, 1, 1000).astype(np.float32)
    u = throttle_mix(y, throttle)
    assert u.min() >= 0.0
    assert u.max() <= 1.0 + 1e-6
    # Differences between motors, which make the moments, are the controller's alone.
    assert np.diff(u, axis=1) == pytest.approx(np.diff(y, axis=1), abs=1e-6)
    assert (u - y)[:, 0] == pytest.approx(throttle * (1 - y.max(axis=1)), abs=1e-6)


@pytest.mark.parametrize(
    ("u", "idle", "value"), [(0.0, 0.0, 48), (1.0, 0.0, 2047), (0.5, 0.0, 1048), (0.0, 0.1, 248)]
)
def test_dshot_value_of_a_fraction(u: float, idle: float, value: int) -> None:
    assert dshot_values(np.array([[u]], np.float32), idle)[0, 0] == value


def test_motor_fractions_are_the_escs_when_values_are_throttle() -> None:
    values = np.array([[0, 48], [1047, 2047]], np.uint16)
    assert motor_fractions(values).tolist() == [[0.0, 0.0], [999 / 1999, 1.0]]


@pytest.mark.parametrize("value", [1, 47, 2048, 65535])
def test_motor_fractions_refuse_when_a_value_is_no_throttle(value: int) -> None:
    with pytest.raises(LinkError, match=f"DShot value {value} is no throttle"):
        motor_fractions(np.array([100, value], np.uint16))
    with pytest.raises(LinkError, match=f"DShot value {value} is no throttle"):
        each_fraction(np.array([100, value], np.uint16))


def test_fractions_have_the_same_bits_when_they_are_looked_up() -> None:
    values = np.array([0, *range(48, 2048)], np.uint16)
    assert each_fraction(values) == motor_fractions(values).tolist()


def test_commands_are_the_outputs_within_a_step_of_dshot_when_the_throttle_is_closed() -> None:
    y = np.random.default_rng(5).uniform(0, 1, (50, 4)).astype(np.float32)
    still = np.zeros(50, np.float32)
    assert np.abs(motor_commands(y, still, 0.0) - y).max() <= 0.5001 / 1999
    raised = motor_commands(y, still, 0.1)
    assert raised.min() >= 0.1 - 0.5001 / 1999
