"""Messages that steer, as channels."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from neuroflight.flash.mavlink.setpoints import attitude_target, channels_override, manual_control
from neuroflight.flash.mavlink.sticks import sticks_of
from neuroflight.toolchain.contract import (
    CHANNEL_AUX1,
    CHANNEL_COUNT,
    CHANNEL_PITCH,
    CHANNEL_ROLL,
    CHANNEL_THROTTLE,
    CHANNEL_YAW,
    SETTINGS,
)

STICKS = sticks_of({setting.name: setting.default for setting in SETTINGS})
RATES = 0x80
FULL = math.radians(670)
# Three quarters of a stick by Betaflight's rates "actual" 70/670/0: 70 x + (670 - 70) x^2 deg/s.
PART = math.radians(70 * 0.75 + 600 * 0.75**2)


def target(
    roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0, thrust: float = 0.0, mask: int = RATES
) -> Any:
    return mavlink.MAVLink_set_attitude_target_message(0, 1, 1, mask, [1, 0, 0, 0], roll, pitch, yaw, thrust)


def manual(x: int = 0, y: int = 0, z: int = 0, r: int = 0) -> Any:
    return mavlink.MAVLink_manual_control_message(1, x, y, z, r, 0)


def override(*channels: int) -> Any:
    return mavlink.MAVLink_rc_channels_override_message(1, 1, *[*channels, *[0] * 18][:18])


def told(channels: dict[int, int]) -> tuple[int, ...]:
    return tuple(channels[one] for one in (CHANNEL_ROLL, CHANNEL_PITCH, CHANNEL_YAW, CHANNEL_THROTTLE))


@pytest.mark.parametrize(
    ("message", "channels"),
    [
        (target(roll=PART), (1875, 1500, 1500, 1000)),  # right: the channel's upper half
        (target(pitch=PART), (1500, 1125, 1500, 1000)),  # nose up: the lower half
        (target(yaw=PART), (1500, 1500, 1875, 1000)),  # clockwise: the upper half
        (target(thrust=0.25), (1500, 1500, 1500, 1250)),
    ],
)
def test_rates_about_forward_right_and_down_become_sticks(message: Any, channels: tuple[int, ...]) -> None:
    setpoint = attitude_target(message, STICKS)
    assert told(dict(setpoint.channels_us)) == channels
    assert not setpoint.beyond


@pytest.mark.parametrize(
    ("message", "channels"),
    [
        (target(roll=2 * FULL, thrust=0.5), (2000, 1500, 1500, 1500)),
        (target(yaw=-1e30, thrust=0.5), (1500, 1500, 1000, 1500)),
        (target(thrust=1.5), (1500, 1500, 1500, 2000)),
        (target(thrust=-1.0), (1500, 1500, 1500, 1000)),
    ],
)
def test_more_than_the_sticks_can_say_is_their_end(message: Any, channels: tuple[int, ...]) -> None:
    setpoint = attitude_target(message, STICKS)
    assert told(dict(setpoint.channels_us)) == channels
    assert setpoint.beyond


@pytest.mark.parametrize("mask", [0, 1, 0x40, 0x81, 0x82, 0x84, 0xC0, 0xA0, 0xFF, 0x7F])
def test_a_target_is_refused_unless_it_is_all_rates_and_a_thrust(mask: int) -> None:
    with pytest.raises(ValueError, match="type_mask"):
        attitude_target(target(mask=mask), STICKS)


@pytest.mark.parametrize("axis", ["roll", "pitch", "yaw", "thrust"])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_target_is_refused_when_it_is_no_number(axis: str, value: float) -> None:
    with pytest.raises(ValueError, match="no number"):
        attitude_target(target(**{"mask": RATES, axis: value}), STICKS)  # type: ignore[arg-type]


def test_a_joystick_moves_the_sticks_themselves() -> None:
    setpoint = manual_control(manual(x=1000, y=-500, z=300, r=250), STICKS)
    assert told(dict(setpoint.channels_us)) == (1250, 2000, 1625, 1300)
    assert not setpoint.beyond


@pytest.mark.parametrize("axis", ["x", "y", "z", "r"])
@pytest.mark.parametrize("value", [0x7FFF, -0x8000, 1001])
def test_a_joystick_that_lacks_an_axis_is_refused(axis: str, value: int) -> None:
    with pytest.raises(ValueError, match="lacks an axis"):
        manual_control(manual(**{axis: value}), STICKS)


def test_channels_are_taken_as_they_are_in_mavlinks_order() -> None:
    setpoint = channels_override(
        override(1100, 1200, 1300, 1400, 0, 1600, 0xFFFF, 1800, 0xFFFE, 1234), STICKS
    )
    assert dict(setpoint.channels_us) == {
        CHANNEL_ROLL: 1100,
        CHANNEL_PITCH: 1200,
        CHANNEL_THROTTLE: 1300,
        CHANNEL_YAW: 1400,
        CHANNEL_AUX1 + 1: 1600,
        CHANNEL_AUX1 + 3: 1800,
        CHANNEL_AUX1 + 5: 1234,
    }
    every = channels_override(override(*[1500] * 18), STICKS).channels_us
    assert sorted(every) == list(range(CHANNEL_COUNT))


@pytest.mark.parametrize(
    "channels",
    [
        *((0, 1500, 1500, 1500), (1500, 0xFFFF, 1500, 1500), (1500, 1500, 0, 1500), (1500, 1500, 1500, 0)),
        *((999, 1500, 1500, 1500), (1500, 1500, 2001, 1500), (1500, 1500, 1500, 1500, 5000)),
    ],
)
def test_channels_are_refused_when_a_stick_lacks_or_one_is_beyond(channels: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="expected"):
        channels_override(override(*channels), STICKS)


@pytest.mark.parametrize("read", [attitude_target, manual_control, channels_override])
def test_messages_of_steering_are_those_of_the_table(read: Callable[..., object]) -> None:
    from neuroflight.flash.mavlink.setpoints import STEERING

    assert read in STEERING.values() and len(STEERING) == 3
