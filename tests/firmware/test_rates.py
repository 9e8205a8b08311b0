"""rates.c: sticks to setpoint and throttle."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from toolchain.contract import CHANNEL_PITCH, CHANNEL_ROLL, CHANNEL_THROTTLE, CHANNEL_YAW

CHANNELS = (CHANNEL_ROLL, CHANNEL_PITCH, CHANNEL_YAW)
SIGNS = (1, 1, -1)  # yaw: channel high turns right, body yaw is positive to the left


def setpoint(core: Any, channels: list[int]) -> list[float]:
    out = core.new("float[3]")
    core.lib.rates_setpoint(channels, out)
    return list(out)


@pytest.mark.parametrize("axis", range(3))
def test_setpoint_is_linear_when_the_stick_moves_from_end_to_end(puppet: Any, axis: int) -> None:
    for us in range(1000, 2001):
        channels = [1500] * 16
        channels[CHANNELS[axis]] = us
        expected = np.zeros(3)
        expected[axis] = SIGNS[axis] * math.radians(1000) * (us - 1500) / 500
        np.testing.assert_allclose(setpoint(puppet, channels), expected, rtol=2.5e-7, atol=0)


@pytest.mark.parametrize("us", [0, 880, 999, 2001, 2159, 65535])
def test_setpoint_is_at_its_end_when_the_stick_is_beyond_it(puppet: Any, us: int) -> None:
    end = 1000 if us < 1500 else 2000
    assert setpoint(puppet, [us] * 16) == setpoint(puppet, [end] * 16)
    assert abs(setpoint(puppet, [us] * 16)[0]) == pytest.approx(math.radians(1000), rel=1e-7)


def test_throttle_is_linear_and_clamped_when_the_stick_moves(puppet: Any) -> None:
    for us in [0, 880, *range(1000, 2001), 2159, 65535]:
        channels = [1500] * 16
        channels[CHANNEL_THROTTLE] = us
        expected = min(max((us - 1000) / 1000, 0), 1)
        assert puppet.lib.rates_throttle(channels) == pytest.approx(expected, rel=2.5e-7, abs=0)
