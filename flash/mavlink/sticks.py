"""The inverse of the firmware's sticks: the channels for a rate, a thrust and an arm switch.

`firmware/src/receiver/rates.c` has the curves. A channel is whole microseconds, so the nearest of 1001 rates
is flown.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from neuroflight.flash.channels.layout import read_layout
from neuroflight.flash.settings.rules import steep_rc_rate
from neuroflight.flash.settings.text import STYLE, STYLE_BETAFLIGHT, Value
from neuroflight.toolchain.contract import (
    CHANNEL_AUX1,
    CHANNEL_COUNT,
    CHANNEL_MAX_US,
    CHANNEL_MID_US,
    CHANNEL_MIN_US,
    CHANNEL_PITCH,
    CHANNEL_ROLL,
    CHANNEL_UNTOLD_US,
    CHANNEL_YAW,
    RATE_MAX_DEG_S,
    RC_RATE_DEG_S,
    SUPER_ROOM_MIN,
    ModeRange,
)

HALF_STICK_US = CHANNEL_MAX_US - CHANNEL_MID_US
AXES = ("roll", "pitch", "yaw")
CHANNELS = (CHANNEL_ROLL, CHANNEL_PITCH, CHANNEL_YAW)
SIGNS = (1, 1, -1)  # of the rate about the house's axes, for the upper half of the channel
ROUNDING = 1e-6  # relative difference of the firmware's float32 from this float64


@dataclass(frozen=True)
class Sticks:
    """The meaning of channels under a firmware's settings."""

    curves: tuple[tuple[float, ...], ...]  # for roll, pitch, yaw: |rate| [rad/s] at 0..500 us off the centre
    wire: tuple[int, ...]  # place in SET_RAW_RC of each channel
    arm: Mapping[int, int]  # channels [us] that switch the mode ARM on; empty where no range does
    arming: frozenset[int]  # all channels that any range of ARM looks at

    @property
    def limits(self) -> tuple[float, ...]:
        """The largest rates about roll, pitch and yaw [rad/s]."""
        return tuple(curve[-1] for curve in self.curves)

    def rate_channels(self, rates: tuple[float, float, float]) -> tuple[dict[int, int], bool]:
        """Return the channels [us] whose setpoint is nearest to `rates` [rad/s] about the house's axes, and
        whether a rate is beyond the end of its stick."""
        channels = {}
        beyond = False
        for curve, channel, sign, rate in zip(self.curves, CHANNELS, SIGNS, rates, strict=True):
            offset = nearest(curve, abs(rate))
            channels[channel] = CHANNEL_MID_US + (offset if rate * sign > 0 else -offset)
            beyond |= abs(rate) > curve[-1] * (1 + ROUNDING)
        return channels, beyond

    def setpoint(self, channels_us: Mapping[int, int]) -> tuple[float, ...]:
        """Return the rates [rad/s] about the house's axes that the firmware makes of `channels_us`."""
        return tuple(
            math.copysign(curve[min(abs(offset), HALF_STICK_US)], offset * sign)
            for curve, channel, sign in zip(self.curves, CHANNELS, SIGNS, strict=True)
            for offset in (channels_us[channel] - CHANNEL_MID_US,)
        )

    def frame(self, channels_us: Mapping[int, int], *, armed: bool) -> tuple[int, ...]:
        """Return SET_RAW_RC's channels in wire order. Channels that are not given are sent as untold, which
        switches no mode on; those that could arm are set by `armed`, whatever was given."""
        told = {channel: us for channel, us in channels_us.items() if channel not in self.arming}
        told |= self.arm if armed else {}
        frame = [CHANNEL_UNTOLD_US] * CHANNEL_COUNT
        for channel, us in told.items():
            frame[self.wire[channel]] = us
        return tuple(frame)


def thrust_channel(thrust: float) -> tuple[int, bool]:
    """Return the throttle channel [us] for a thrust 0..1, and whether the thrust was out of range."""
    kept = min(max(thrust, 0.0), 1.0)
    return CHANNEL_MIN_US + round(kept * (CHANNEL_MAX_US - CHANNEL_MIN_US)), kept != thrust


def nearest(curve: tuple[float, ...], rate: float) -> int:
    """Return the smallest stick deflection [us] whose rate is nearest to `rate`, both >= 0."""
    above = bisect_left(curve, rate)
    if above == len(curve):
        return bisect_left(curve, curve[-1])
    if above > 0 and rate - curve[above - 1] <= curve[above] - rate:
        return bisect_left(curve, curve[above - 1])
    return above


def sticks_of(settings: Mapping[str, Value]) -> Sticks:
    """Derive the meaning of channels from `settings`. Raises LinkError for an invalid map or arm switch."""
    layout = read_layout(settings.__getitem__)
    return Sticks(
        curves=tuple(_curve(settings, axis) for axis in AXES),
        wire=layout.wire,
        arm=_arm_channels(layout.arm),
        arming=frozenset(map(_channel, layout.arm)),
    )


def _curve(settings: Mapping[str, Value], axis: str) -> tuple[float, ...]:
    rate, top, expo = (float(settings[f"{axis}_{name}"]) for name in ("rate", "max", "expo"))
    deadband = int(settings["yaw_deadband_us" if axis == "yaw" else "deadband_us"])
    betaflight = settings[STYLE] == STYLE_BETAFLIGHT
    curve = []
    for offset in range(HALF_STICK_US + 1):
        x = max(offset - deadband, 0) / (HALF_STICK_US - deadband)
        rate_deg_s = _betaflight(x, rate, top, expo) if betaflight else _actual(x, rate, top, expo)
        curve.append(math.radians(min(rate_deg_s, RATE_MAX_DEG_S)))
    return tuple(curve)


def _actual(x: float, rate: float, top: float, expo: float) -> float:
    return x * rate + max(top - rate, 0.0) * x * (x**5 * expo + x * (1 - expo))


def _betaflight(x: float, rate: float, top: float, expo: float) -> float:
    command = x * (x**3 * expo + 1 - expo)
    return RC_RATE_DEG_S * steep_rc_rate(rate) * command / max(1 - x * top, SUPER_ROOM_MIN)


def _channel(found: ModeRange) -> int:
    return CHANNEL_AUX1 + found.aux - 1


def _arm_channels(ranges: Sequence[ModeRange]) -> dict[int, int]:
    """Return the channels [us] that arm: the middle of the first range that suffices alone, otherwise of all
    ranges that must hold together."""
    alone = [found for found in ranges if not found.and_others][:1]
    spans: dict[int, tuple[int, int]] = {}
    for found in alone or ranges:
        low, high = spans.get(_channel(found), (0, 1 << 16))
        spans[_channel(found)] = max(low, found.low_us), min(high, found.high_us)
    if any(low >= high for low, high in spans.values()):
        return {}
    return {channel: (low + high) // 2 for channel, (low, high) in spans.items()}
