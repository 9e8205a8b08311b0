"""Sticks: a pilot's command as receiver channels, and channels as the firmware's setpoint and throttle.

Full stick is 1000 deg/s, so one microsecond is 2 deg/s: a command is rounded to the nearest whole
microsecond, for every controller alike. Channel high is roll right, pitch forward, yaw right; the body's
yaw is positive to the left, hence the sign.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from neuroflight.sim.arrays import Array32
from neuroflight.toolchain.contract import (
    CHANNEL_ARM,
    CHANNEL_COUNT,
    CHANNEL_MAX_US,
    CHANNEL_MID_US,
    CHANNEL_MIN_US,
    CHANNEL_PID,
    CHANNEL_PITCH,
    CHANNEL_ROLL,
    CHANNEL_THROTTLE,
    CHANNEL_YAW,
    RATE_FULL_STICK_DEG_S,
    SWITCH_ON_US,
)
from neuroflight.toolchain.errors import ScenarioError

# Float32 constants and their order of use are the firmware's (rates.c).
_FULL_STICK = np.float32(math.radians(RATE_FULL_STICK_DEG_S))  # [rad/s]
_STICK_PER_US = np.float32(1 / (CHANNEL_MAX_US - CHANNEL_MID_US))
_THROTTLE_PER_US = np.float32(1 / (CHANNEL_MAX_US - CHANNEL_MIN_US))
_RATE_CHANNELS = (CHANNEL_ROLL, CHANNEL_PITCH, CHANNEL_YAW)
_SIGNS = np.array([1, 1, -1], np.float32)
_US_PER_DEG_S = (CHANNEL_MAX_US - CHANNEL_MID_US) / RATE_FULL_STICK_DEG_S


def setpoint(channels_us: ArrayLike) -> Array32:
    """Compute the rates [rad/s] commanded by the sticks, body frame, shape (..., 3), as the firmware does.

    channels_us: whole pulse widths [us], shape (..., CHANNEL_COUNT).
    """
    channels = np.asarray(channels_us, np.int32)[..., _RATE_CHANNELS]
    stick = (channels - CHANNEL_MID_US).astype(np.float32) * _STICK_PER_US
    rates: Array32 = np.clip(stick, np.float32(-1), np.float32(1)) * (_FULL_STICK * _SIGNS)
    return rates


def throttle(channels_us: ArrayLike) -> Array32:
    """Compute the pilot's thrust 0..1, shape (...), from channels of shape (..., CHANNEL_COUNT)."""
    channel = np.asarray(channels_us, np.int32)[..., CHANNEL_THROTTLE]
    fraction = (channel - CHANNEL_MIN_US).astype(np.float32) * _THROTTLE_PER_US
    clipped: Array32 = np.clip(fraction, np.float32(0), np.float32(1))
    return clipped


def channels(
    setpoint_deg_s: ArrayLike, thrust: ArrayLike, armed: bool, pid: ArrayLike = False
) -> NDArray[np.uint16]:
    """Compute the nearest channels [us] to a command, shape (..., CHANNEL_COUNT).

    setpoint_deg_s: roll, pitch, yaw [deg/s] in the body frame, shape (..., 3); thrust: 0..1, shape (...);
    pid: True if the switch chooses the PID, shape (...). Raises ScenarioError beyond full stick.
    """
    rates, power = np.asarray(setpoint_deg_s, np.float64), np.asarray(thrust, np.float64)
    if not (np.abs(rates) <= RATE_FULL_STICK_DEG_S).all():
        raise ScenarioError(
            f"setpoint_deg_s: got {rates[~(np.abs(rates) <= RATE_FULL_STICK_DEG_S)].flat[0]:g}, "
            f"full stick is {RATE_FULL_STICK_DEG_S} deg/s; ask for less"
        )
    if not ((power >= 0) & (power <= 1)).all():
        raise ScenarioError(f"throttle: got {power}, expected 0 to 1")
    us = np.full((*rates.shape[:-1], CHANNEL_COUNT), CHANNEL_MIN_US, np.uint16)
    us[..., _RATE_CHANNELS] = np.rint(CHANNEL_MID_US + rates * _SIGNS * _US_PER_DEG_S)
    us[..., CHANNEL_THROTTLE] = np.rint(CHANNEL_MIN_US + power * (CHANNEL_MAX_US - CHANNEL_MIN_US))
    us[..., CHANNEL_ARM] = SWITCH_US if armed else CHANNEL_MIN_US
    us[..., CHANNEL_PID] = np.where(pid, SWITCH_US, CHANNEL_MIN_US)
    return us


# A switch that is on, well past the begin of its mode's range.
SWITCH_US = (SWITCH_ON_US + CHANNEL_MAX_US) // 2
