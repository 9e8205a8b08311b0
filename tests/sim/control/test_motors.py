"""Throttle mix and DShot values by their formulas."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from neuroflight.sim.control.motors import (
    dshot_values,
    each_fraction,
    motor_commands,
    motor_fractions,
    throttle_mix,
)
from neuroflight.toolchain.contract import Mix
from neuroflight.toolchain.errors import LinkError


def test_thrust_rides_on_top_within_bounds_for_any_output() -> None:
    rng = np.random.default_rng(3)
    y = rng.uniform(0, 1, (1000, 4)).astype(np.float32)
    throttle = rng.uniform(0, 1, 1000).astype(np.float32)
    u = throttle_mix(y, throttle)
    assert u.min() >= 0.0
    assert u.max() <= 1.0
    # Differences between motors, which make the moments, are the controller's alone.
    assert np.diff(u, axis=1) == pytest.approx(np.diff(y, axis=1), abs=1e-6)
    assert (u - y)[:, 0] == pytest.approx(throttle * (1 - y.max(axis=1)), abs=1e-6)


FRACTIONS = st.floats(0.0, 1.0, width=32)


@pytest.mark.parametrize("motors", [4, 6])
@given(data=st.data())
def test_centred_outputs_turn_only_when_nothing_is_at_its_end(motors: int, data: st.DataObject) -> None:
    y = np.array([data.draw(st.lists(FRACTIONS, min_size=motors, max_size=motors))], np.float32)
    throttle = np.array([data.draw(FRACTIONS)], np.float32)
    u = throttle_mix(y, throttle, Mix.CENTRED)
    away = y[0].astype(np.float64) - y.mean(dtype=np.float64)
    low, high = throttle[0] + away.min(), throttle[0] + away.max()
    assert u.dtype == np.float32
    assert u.min() >= 0.0
    assert u.max() <= 1.0
    if low >= 0.0 and high <= 1.0:
        assert u.mean() == pytest.approx(throttle[0], abs=1e-6)
    if np.ptp(y) <= 1.0 - 1e-6:  # which 0..1 has room for at any throttle
        assert np.diff(u) == pytest.approx(np.diff(y), abs=1e-6)
    if low < -1e-6:
        assert u.min() == pytest.approx(0.0, abs=1e-6)
    elif high > 1.0 + 1e-6:
        assert u.max() == pytest.approx(1.0, abs=1e-6)


def test_centred_outputs_are_summed_from_the_first_motor_on() -> None:
    y = np.array([[1.0, 2.0**-24, 2.0**-24, 0.5]], np.float32)
    u = throttle_mix(y, np.full(1, 0.5, np.float32), Mix.CENTRED)
    mean = np.float32(0.375)  # from the last motor on it would be 0.375 + 2^-25
    v = np.float32(0.5) + (y - mean)
    assert u.tobytes() == (v + (np.float32(1.0) - v.max())).tobytes()


def test_bits_of_a_mix_do_not_depend_on_the_batch() -> None:
    rng = np.random.default_rng(4)
    y, throttle = rng.random((40, 6), np.float32), rng.random(40, np.float32)
    for mix in Mix:
        u = throttle_mix(y, throttle, mix)
        alone = [throttle_mix(y[i : i + 1], throttle[i : i + 1], mix).tobytes() for i in range(40)]
        assert b"".join(alone) == u.tobytes()


def test_commands_are_mixed_as_the_controller_asks() -> None:
    y, throttle = np.array([[0.25, 0.75, 0.5, 0.5]], np.float32), np.full(1, 0.5, np.float32)
    for mix in Mix:
        expected = motor_fractions(dshot_values(throttle_mix(y, throttle, mix), 0.1))
        assert np.array_equal(motor_commands(y, throttle, 0.1, mix), expected)
    assert motor_commands(y, throttle, 0.0, Mix.CENTRED).mean() == pytest.approx(0.5, abs=1e-3)


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
