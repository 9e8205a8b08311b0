"""Conversion of steering messages to channels: body rates, a joystick, channels themselves.

Each function returns the setpoint, or raises ValueError that says what is wrong with the message.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from neuroflight.flash.mavlink.frames import swap_frame
from neuroflight.flash.mavlink.offboard import Setpoint
from neuroflight.flash.mavlink.sticks import HALF_STICK_US, Sticks, thrust_channel
from neuroflight.toolchain.contract import (
    CHANNEL_AUX1,
    CHANNEL_COUNT,
    CHANNEL_MAX_US,
    CHANNEL_MID_US,
    CHANNEL_MIN_US,
    CHANNEL_PITCH,
    CHANNEL_ROLL,
    CHANNEL_THROTTLE,
    CHANNEL_YAW,
)

_MASK = mavlink.ATTITUDE_TARGET_TYPEMASK_ATTITUDE_IGNORE  # rates and thrust, and nothing else
MANUAL_FULL = 1000  # of an axis
# Channels of RC_CHANNELS and RC_CHANNELS_OVERRIDE, as MAVLink's pilots know them.
ORDER = (
    *(CHANNEL_ROLL, CHANNEL_PITCH, CHANNEL_THROTTLE, CHANNEL_YAW),
    *range(CHANNEL_AUX1, CHANNEL_COUNT),
)
_IGNORED = (0, 0xFFFF)  # of a channel of RC_CHANNELS_OVERRIDE: not told
_IGNORED_LATER = (*_IGNORED, 0xFFFE)  # of those behind the eighth


def attitude_target(message: Any, sticks: Sticks) -> Setpoint:  # noqa: ANN401 - pymavlink's are untyped
    """Convert body rates [rad/s] about forward, right, down, and a thrust 0..1."""
    if message.type_mask != _MASK:
        raise ValueError(
            f"SET_ATTITUDE_TARGET has type_mask {message.type_mask}, expected {_MASK}: body rates and thrust"
        )
    rates = message.body_roll_rate, message.body_pitch_rate, message.body_yaw_rate
    if not all(map(math.isfinite, (*rates, message.thrust))):
        raise ValueError("SET_ATTITUDE_TARGET holds no number")
    channels, beyond = sticks.rate_channels(swap_frame(rates))
    channels[CHANNEL_THROTTLE], outside = thrust_channel(message.thrust)
    return Setpoint(channels, beyond or outside)


def manual_control(message: Any, sticks: Sticks) -> Setpoint:  # noqa: ANN401
    """Convert a joystick to sticks, whose rate curves apply: x forward, y right, z thrust, r right."""
    axes = {CHANNEL_PITCH: message.x, CHANNEL_ROLL: message.y, CHANNEL_YAW: message.r}
    if not all(abs(value) <= MANUAL_FULL for value in (*axes.values(), message.z)):
        raise ValueError("MANUAL_CONTROL lacks an axis: expected x, y, z, r within 1000")
    channels = {c: CHANNEL_MID_US + round(v * HALF_STICK_US / MANUAL_FULL) for c, v in axes.items()}
    channels[CHANNEL_THROTTLE], beyond = thrust_channel(message.z / MANUAL_FULL)
    return Setpoint(channels, beyond)


def channels_override(message: Any, sticks: Sticks) -> Setpoint:  # noqa: ANN401
    """Convert channels as they are; the four sticks are required, others optional."""
    channels = {}
    for index, channel in enumerate(ORDER):
        us = getattr(message, f"chan{index + 1}_raw")
        if us not in (_IGNORED if index < 8 else _IGNORED_LATER):
            channels[channel] = us
    if not set(ORDER[:4]) <= set(channels):
        raise ValueError("RC_CHANNELS_OVERRIDE lacks a stick: expected channels 1 to 4")
    if not all(CHANNEL_MIN_US <= us <= CHANNEL_MAX_US for us in channels.values()):
        raise ValueError(f"RC_CHANNELS_OVERRIDE: expected {CHANNEL_MIN_US} to {CHANNEL_MAX_US} us")
    return Setpoint(channels)


STEERING: dict[str, Callable[[Any, Sticks], Setpoint]] = {
    "SET_ATTITUDE_TARGET": attitude_target,
    "MANUAL_CONTROL": manual_control,
    "RC_CHANNELS_OVERRIDE": channels_override,
}
