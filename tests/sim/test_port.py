from __future__ import annotations

import numpy as np
import pytest

from sim.port import control_divider, motor_fractions
from toolchain.errors import LinkError


def test_motor_fractions_are_the_escs_when_values_are_throttle() -> None:
    values = np.array([[0, 48], [1047, 2047]], np.uint16)
    assert motor_fractions(values).tolist() == [[0.0, 0.0], [999 / 1999, 1.0]]


@pytest.mark.parametrize("value", [1, 47, 2048, 65535])
def test_motor_fractions_refuse_when_a_value_is_no_throttle(value: int) -> None:
    with pytest.raises(LinkError, match=f"DShot value {value} is no throttle"):
        motor_fractions(np.array([100, value], np.uint16))


def test_control_divider_is_whole_when_the_rates_fit() -> None:
    assert control_divider(4000, 1000) == 4


@pytest.mark.parametrize(("gyro", "control"), [(4000, 3000), (1000, 2000), (4000, 0)])
def test_control_divider_refuses_when_the_rates_do_not_fit(gyro: int, control: int) -> None:
    with pytest.raises(LinkError, match="does not divide"):
        control_divider(gyro, control)
