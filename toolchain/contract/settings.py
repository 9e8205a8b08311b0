"""Every setting that a pilot may change."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum

from toolchain.contract.frame_time_sensors import AXES, GYRO_EDGE_RATE_HZ, GYRO_RATE_DEFAULT_HZ
from toolchain.contract.msp import MSP_BAUD_DEFAULT, MSP_BAUDS
from toolchain.contract.receiver import (
    CHANNEL_ARM,
    CHANNEL_BEEPER,
    CHANNEL_COUNT,
    CHANNEL_PID,
    CHANNEL_PITCH,
    CHANNEL_ROLL,
    CHANNEL_THROTTLE,
    CHANNEL_TRIAL,
    CHANNEL_YAW,
)
from toolchain.contract.safety import (
    ARMING_DELAY_MS,
    BOOT_GRACE_MS,
    GYRO_BAD_MS,
    RECEIVER_HOLD_MS,
    RECEIVER_LOST_MS,
)


@dataclass(frozen=True)
class Span:
    """Other limits that a setting has."""

    low: float
    high: float
    default: float
    unit: str


@dataclass(frozen=True)
class Setting:
    """One number that a pilot may change: kept in flash, flown from the next boot on."""

    name: str
    kind: str  # "uint32_t" or "float"; four bytes either way
    low: float
    high: float
    default: float
    unit: str
    meaning: str
    choices: tuple[str, ...] = ()  # names of 0, 1, ...
    betaflight: Span | None = None  # instead, where rates_style is betaflight; the same kind


def _choice(name: str, default: str, choices: tuple[str, ...], meaning: str) -> Setting:
    return Setting(name, "uint32_t", 0, len(choices) - 1, choices.index(default), "", meaning, choices)


def _whole(name: str, low: int, high: int, default: int, unit: str, meaning: str) -> Setting:
    return Setting(name, "uint32_t", low, high, default, unit, meaning)


def _number(name: str, low: float, high: float, default: float, unit: str, meaning: str) -> Setting:
    return Setting(name, "float", low, high, default, unit, meaning)


class FilterKind(IntEnum):
    """A stage of the gyro's filter chain."""

    NONE = 0
    PT1 = 1
    PT2 = 2
    PT3 = 3
    BIQUAD = 4  # low-pass of second order
    NOTCH = 5


_SWITCH = ("off", "on")
_FILTERS = tuple(kind.name.lower() for kind in FilterKind)
FILTER_STAGES = 4
# Of the whole chain of gyro filters, for slow motion. Flown in the twin, the NF1's PID swings from 4.5 ms on
# behind a biquad, from 6 ms on behind the others.
FILTER_DELAY_MAX_MS = 4.0
_MSP_BAUD_MEANING = f"{', '.join(str(baud) for baud in MSP_BAUDS[:-1])} or {MSP_BAUDS[-1]}, on UART1"
_STYLE_MEANING = "what the nine numbers below mean; changing it sets them to the new style's defaults"
_RATE_MEANING = "actual: slope at the centre; betaflight: RC rate"
_MAX_MEANING = "actual: at full stick; betaflight: super rate"
_DELAY_MEANING = f"silence of the receiver until the stage begins; held from {RECEIVER_HOLD_MS} ms on"
_ARMING_DELAY_MEANING = "from power-up until arming is allowed: longer than the ESCs' start-up tunes"
SETTINGS = (
    _whole("gyro_rate_hz", 1000, GYRO_EDGE_RATE_HZ, GYRO_RATE_DEFAULT_HZ, "Hz", "1000, 2000, 4000 or 8000"),
    _choice("gyro_alignment", "board", ("board", "cw0", "cw90", "cw180", "cw270"), "how the chip is turned"),
    _whole("gyro_stuck_ms", 0, 1000, GYRO_BAD_MS, "ms", "the same sample for longer is a fault; 0: never"),
    *(
        setting
        for stage in range(1, FILTER_STAGES + 1)
        for setting in (
            _choice(f"filter{stage}_kind", "none", _FILTERS, "of the gyro's filter chain, in order"),
            _number(f"filter{stage}_hz", 30.0, 4000.0, 100.0, "Hz", "cutoff, or centre of the notch"),
            _number(f"filter{stage}_q", 0.1, 100.0, 0.70710678, "1", "quality of biquad and notch"),
        )
    ),
    _whole("dynamic_notch_count", 0, 3, 0, "notches", "that follow the peaks of each axis; 0: none"),
    _number("dynamic_notch_low_hz", 30.0, 1000.0, 100.0, "Hz", "lowest centre"),
    _number("dynamic_notch_high_hz", 60.0, 2000.0, 600.0, "Hz", "highest centre"),
    _number("dynamic_notch_q", 0.5, 20.0, 3.0, "1", "quality"),
    _choice("receiver_protocol", "sbus", ("sbus", "crsf", "msp"), "what speaks on the receiver's line"),
    _whole("msp_baud", MSP_BAUDS[0], MSP_BAUDS[-1], MSP_BAUD_DEFAULT, "baud", _MSP_BAUD_MEANING),
    *(
        _whole(f"map_{name}", 0, CHANNEL_COUNT - 1, channel, "channel", f"of the receiver that is {name}")
        for name, channel in (
            ("roll", CHANNEL_ROLL),
            ("pitch", CHANNEL_PITCH),
            ("throttle", CHANNEL_THROTTLE),
            ("yaw", CHANNEL_YAW),
            ("arm", CHANNEL_ARM),
            ("pid", CHANNEL_PID),
            ("beeper", CHANNEL_BEEPER),
            ("trial", CHANNEL_TRIAL),
        )
    ),
    _choice("rates_style", "actual", ("actual", "betaflight"), _STYLE_MEANING),
    *(
        setting
        for axis in AXES
        for setting in (
            replace(
                _number(f"{axis}_rate", 0.01, 1000.0, 1000.0, "deg/s", _RATE_MEANING),
                betaflight=Span(0.01, 2.55, 1.0, "1"),
            ),
            replace(
                _number(f"{axis}_max", 0.0, 1998.0, 1000.0, "deg/s", _MAX_MEANING),
                betaflight=Span(0.0, 1.0, 0.7, "1"),
            ),
            replace(
                _number(f"{axis}_expo", 0.0, 1.0, 0.0, "1", "0: none"), betaflight=Span(0.0, 1.0, 0.0, "1")
            ),
        )
    ),
    _whole("deadband_us", 0, 100, 0, "us", "of roll and pitch"),
    _whole("yaw_deadband_us", 0, 100, 0, "us", "of yaw"),
    _choice("interpolation", "off", _SWITCH, "a ramp between two receiver frames"),
    _choice("failsafe_stage", "drop", ("drop", "descend"), "after the hold"),
    _number("failsafe_throttle", 0.0, 1.0, 0.2, "1", "while descending"),
    _whole("failsafe_descend_ms", 0, 60_000, 3000, "ms", "then the motors stop"),
    _whole("failsafe_delay_ms", 200, 20_000, RECEIVER_LOST_MS, "ms", _DELAY_MEANING),
    _number("level_limit_deg", 0.0, 180.0, 25.0, "deg", "tilt that arming allows; 0: any, known or not"),
    _whole("arming_delay_ms", BOOT_GRACE_MS, 10_000, ARMING_DELAY_MS, "ms", _ARMING_DELAY_MEANING),
    # Less leaves the motors too little room above their idle: the NF1 needs more than a second to stop.
    _number("motor_limit", 0.4, 1.0, 1.0, "1", "largest motor fraction"),
    _choice("motor_stop", "off", _SWITCH, "armed with the throttle low, motors stand still"),
    _choice("motor_protocol", "dshot600", ("dshot300", "dshot600"), "to the ESCs"),
    _whole("battery_cells", 0, 6, 0, "cells", "0: found from the voltage at boot"),
    _number("battery_scale", 1.0, 100.0, 11.0, "1", "volts at the pack for one at the pin"),
    _number("current_scale", 1.0, 1000.0, 17.9, "mV/A", "of the sensor"),
    _number("battery_warn_v", 2.5, 4.4, 3.5, "V", "a cell: warning"),
    _number("battery_low_v", 2.5, 4.4, 3.3, "V", "a cell: land now"),
    _choice("crash_detection", "on", _SWITCH, "motors stop when the aircraft does what no pilot asked for"),
    _choice("runaway_detection", "on", _SWITCH, "the same right after arming"),
    _choice("plausibility_detection", "on", _SWITCH, "the PID takes over from a policy that steers wrongly"),
    _choice("policy_trial", "off", _SWITCH, "the policy flies only while the switch of map_trial is held"),
)
