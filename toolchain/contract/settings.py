"""Every setting that a pilot may change."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import IntEnum

from neuroflight.toolchain.contract.blackbox import (
    LOG_BAUD_DEFAULT,
    LOG_BAUDS,
    LOG_DIVIDERS,
    LogDevice,
    LogGroup,
)
from neuroflight.toolchain.contract.chirp import CHIRP_RATE_PART
from neuroflight.toolchain.contract.frame_time_sensors import (
    AXES,
    GYRO_EDGE_RATE_HZ,
    GYRO_RATE_DEFAULT_HZ,
    MOTOR_COUNT_MAX,
    Alignment,
)
from neuroflight.toolchain.contract.modes import (
    MODE_LOW_US,
    MODE_SLOT_COUNT,
    MODE_STEP_US,
    MODE_STEPS,
    SWITCH_ON_US,
    Mode,
    ModeRange,
)
from neuroflight.toolchain.contract.motors import MOTOR_POLES_DEFAULT
from neuroflight.toolchain.contract.msp import MSP_BAUD_DEFAULT, MSP_BAUDS
from neuroflight.toolchain.contract.receiver import (
    CHANNEL_AUX1,
    CHANNEL_MAPPED_COUNT,
    CHANNEL_PITCH,
    CHANNEL_ROLL,
    CHANNEL_THROTTLE,
    CHANNEL_YAW,
    RATE_MAX_DEG_S,
)
from neuroflight.toolchain.contract.safety import (
    ARMING_DELAY_MS,
    BOOT_GRACE_MS,
    GYRO_BAD_MS,
    RECEIVER_FLAG_MS,
    RECEIVER_HOLD_MS,
    RECEIVER_LOST_MS,
    RECEIVER_PAUSE_MS,
)


@dataclass(frozen=True)
class Span:
    """Other limits that a setting has."""

    low: float
    high: float
    default: float
    unit: str


class SettingKind(IntEnum):
    """Kinds of values."""

    uint32_t = 0
    float = 1
    mode = 2
    text = 3


@dataclass(frozen=True)
class Setting:
    """A number, choice, mode range or text that a pilot may change; it is kept in flash."""

    name: str
    kind: str  # "uint32_t", "float", "mode" (a ModeRange, packed) or "text" (SETTING_TEXT_BYTES)
    low: float  # of a text: its shortest length
    high: float
    default: float
    unit: str
    meaning: str
    choices: tuple[str, ...] = ()  # names of 0, 1, ...
    betaflight: Span | None = None  # instead, where rates_style is betaflight; the same kind
    at_once: bool = False  # flown as soon as the motors stand and no log is written; else from the next boot

    @property
    def parameter(self) -> str:
        """Its name as MAVLink has room for it; for good, as ground stations store parameters by name."""
        return _PARAMETERS.get(self.name, self.name)


_PARAMETERS = {  # of settings with a name of more than the 16 characters of MAVLink's param_id
    "dynamic_notch_count": "dyn_notch_count",
    "dynamic_notch_low_hz": "dyn_notch_low_hz",
    "dynamic_notch_high_hz": "dyn_notch_hi_hz",
    "rpm_filter_harmonics": "rpm_harmonics",
    "rpm_filter_min_hz": "rpm_min_hz",
    "receiver_protocol": "rx_protocol",
    "failsafe_throttle": "fs_throttle",
    "failsafe_descend_ms": "fs_descend_ms",
    "failsafe_delay_ms": "fs_delay_ms",
    "battery_capacity_mah": "bat_capacity_mah",
    "blackbox_disabled_mask": "blackbox_off",
    "beep_receiver_lost": "beep_rx_lost",
    "beep_policy_refused": "beep_pol_refused",
    "beep_battery_warn": "beep_bat_warn",
    "runaway_detection": "runaway_detect",
    "plausibility_detection": "plausible_detect",
}
# The settings with `at_once`; firmware/src/background.c flies them.
AT_ONCE = "rates, dead bands and PID factors"


def _choice(name: str, choices: tuple[str, ...], meaning: str, default: int = 0) -> Setting:
    return Setting(name, "uint32_t", 0, len(choices) - 1, int(default), "", meaning, choices)


def _switch(name: str, default: bool, meaning: str) -> Setting:
    return _choice(name, ("off", "on"), meaning, default)


def _text(name: str, meaning: str) -> Setting:
    return Setting(name, "text", 0, SETTING_TEXT_BYTES, 0, "characters", meaning)


def _mode(slot: int, default: ModeRange | None) -> Setting:
    packed = default.packed if default is not None else 0
    return Setting(f"mode{slot}", "mode", 0, MODE_RANGE_MAX, packed, "", _MODE_MEANING)


def _whole(name: str, low: int, high: int, default: int, unit: str, meaning: str) -> Setting:
    return Setting(name, "uint32_t", low, high, default, unit, meaning)


def _number(name: str, low: float, high: float, default: float, unit: str, meaning: str) -> Setting:
    return Setting(name, "float", low, high, default, unit, meaning)


def _listed(numbers: tuple[int, ...]) -> str:
    return f"{', '.join(map(str, numbers[:-1]))} or {numbers[-1]}"


def _at_once(*settings: Setting) -> Iterator[Setting]:
    return (replace(setting, at_once=True) for setting in settings)


class FilterKind(IntEnum):
    """A stage of the gyro's filter chain."""

    NONE = 0
    PT1 = 1
    PT2 = 2
    PT3 = 3
    BIQUAD = 4  # low-pass of second order
    NOTCH = 5


SETTING_LEAST = 2.0**-16  # size of a number other than 0: smaller ones become 0
SETTING_TEXT_BYTES = 16  # printable ASCII, then zeros
MODE_RANGE_MAX = (1 << 25) - 1  # of a packed one
_MAPPED_AUX = CHANNEL_MAPPED_COUNT - CHANNEL_AUX1
_HIGH_US = MODE_LOW_US + MODE_STEPS * MODE_STEP_US
_MODE_DEFAULTS = {  # a switch's upper position, as on most transmitters
    slot: ModeRange(mode, slot, SWITCH_ON_US, _HIGH_US)
    for slot, mode in enumerate((Mode.ARM, Mode.PID, Mode.BEEPER, Mode.TRIAL), start=1)
}
_DEVICES = tuple(device.name.lower() for device in LogDevice)
_FILTERS = tuple(kind.name.lower() for kind in FilterKind)
_ALIGNMENTS = ("board", *(alignment.name.lower() for alignment in Alignment))
FILTER_STAGES = 4
# Of the whole chain of gyro filters, for slow motion. Flown in the twin, the NF1's PID swings from 3.75 ms on
# behind a biquad, later behind the others.
FILTER_DELAY_MAX_MS = 3.5
# Of the same chain where a PID gain is not as built in. At 2 ms every corner of the factors flies, at 3 ms a
# P of 1.25 swings.
PID_FACTOR_FILTER_DELAY_MAX_MS = 2.0
_MSP_BAUD_MEANING = f"{_listed(MSP_BAUDS)}, on UART1"
_LOG_BAUD_MEANING = f"{_listed(LOG_BAUDS)}, on UART3 with the log"
_LOG_STEPS_MEANING = (
    f"{_listed(LOG_DIVIDERS)}: each so many-th control step is logged; only 1 can be replayed"
)
_GROUPS_MEANING = "fields left out: " + ", ".join(
    f"{group.value} {group.name.lower().replace('_', ' ')}" for group in LogGroup
)
_MEAN_MEANING = "controllers see the mean of a control period's samples; policy: where it was trained so"
_CHIRP_END_MEANING = f"where it ends; at most {CHIRP_RATE_PART:g} of the control rate"
_STYLE_MEANING = "what the nine numbers below mean; changing it sets them to the new style's defaults"
# Betaflight's, so that an aircraft turns as its pilot knows it (src/main/pg/rates.c, 2025.12).
_RATE_DEFAULT_DEG_S, _MAX_DEFAULT_DEG_S = 70.0, 670.0
_RC_RATE_MAX = 2.38  # without a super rate 1582 deg/s; more is more than RATE_MAX_DEG_S
_RATE_MEANING = "actual: slope at the centre; betaflight: RC rate"
_MAX_MEANING = "actual: at full stick; betaflight: super rate"
_HOLD_MEANING = "without a good frame of the receiver until rates are centred, the throttle kept"
_DELAY_MEANING = "the same until the stage begins; longer than failsafe_hold_ms"
_MODE_MEANING = "MODE AUX LOW HIGH: on from LOW us to below HIGH us of that AUX channel; none: unused"
_GAIN_MEANING = "of the PID: times the gain that is built in"
# Flown in the twins of NF1 and hexacopter without gyro filters: both fly every corner, up to a P of 1.4, down
# to a D of 0.6. The NF1 swings at a P of 3 with a D of 0 or 1, and at a P of 0.2 with a D of 3.
_GAIN_FACTORS = (("p", 0.5, 1.25), ("i", 0.0, 3.0), ("d", 0.75, 2.0))
MOTOR_KEY_MAX = (1 << 24) - 1  # MAVLink's numbers are exact as far
_CHECKED_MEANING = "of what `board motors check` found right, which it stores; 0: nothing"
_BEEPS = {
    "crashed": "after a crash",
    "receiver_lost": "the receiver is lost",
    "not_arming": "the arm switch is on and something forbids arming: its count",
    "took_over": "the PID took over in flight",
    "battery_low": "the battery is low: land now",
    "fault": "a fault that nobody acknowledged",
    "policy_refused": "the policy was refused in flight",
    "motor": "a motor is weak or its ESC silent: its number",
    "battery_warn": "the battery's warning",
    "armed": "when armed",
    "disarmed": "when disarmed",
}
_ARMING_DELAY_MEANING = "from power-up until arming is allowed: longer than the ESCs' start-up tunes"
SETTINGS = (
    _whole("gyro_rate_hz", 1000, GYRO_EDGE_RATE_HZ, GYRO_RATE_DEFAULT_HZ, "Hz", "1000, 2000, 4000 or 8000"),
    _choice("gyro_select", ("first", "second"), "which chip of a board with two gyros"),
    _choice("gyro_alignment", _ALIGNMENTS, "how the chip is turned; flip: it sits on the underside"),
    *(
        _number(f"board_{axis}_deg", -180.0, 180.0, 0.0, "deg", "how the board is turned in the aircraft")
        for axis in AXES
    ),
    _whole("gyro_stuck_ms", 0, 1000, GYRO_BAD_MS, "ms", "the same sample for longer is a fault; 0: never"),
    *(
        setting
        for stage in range(1, FILTER_STAGES + 1)
        for setting in (
            _choice(f"filter{stage}_kind", _FILTERS, "of the gyro's filter chain, in order"),
            _number(f"filter{stage}_hz", 30.0, 4000.0, 100.0, "Hz", "cutoff, or centre of the notch"),
            _number(f"filter{stage}_q", 0.1, 100.0, 0.70710678, "1", "quality of biquad and notch"),
        )
    ),
    _whole("dynamic_notch_count", 0, 3, 0, "notches", "that follow the peaks of each axis; 0: none"),
    _number("dynamic_notch_low_hz", 30.0, 1000.0, 100.0, "Hz", "lowest centre"),
    _number("dynamic_notch_high_hz", 60.0, 2000.0, 600.0, "Hz", "highest centre"),
    _number("dynamic_notch_q", 0.5, 20.0, 3.0, "1", "quality"),
    _whole("rpm_filter_harmonics", 0, 3, 0, "notches", "on 1, 2 and 3 times each motor's turns; 0: none"),
    _number("rpm_filter_min_hz", 30.0, 200.0, 100.0, "Hz", "lowest centre, where they have faded"),
    _number("rpm_filter_q", 2.0, 20.0, 5.0, "1", "quality"),
    _choice("gyro_mean", ("policy", "off", "on"), _MEAN_MEANING),
    _choice("receiver_protocol", ("sbus", "crsf", "msp"), "what speaks on the receiver's line"),
    _whole("msp_baud", MSP_BAUDS[0], MSP_BAUDS[-1], MSP_BAUD_DEFAULT, "baud", _MSP_BAUD_MEANING),
    *(
        _whole(f"map_{name}", 0, CHANNEL_MAPPED_COUNT - 1, channel, "channel", f"of the receiver: {told}")
        for name, told, channel in (
            ("roll", "roll", CHANNEL_ROLL),
            ("pitch", "pitch", CHANNEL_PITCH),
            ("throttle", "throttle", CHANNEL_THROTTLE),
            ("yaw", "yaw", CHANNEL_YAW),
            *((f"aux{aux}", f"AUX {aux}", CHANNEL_AUX1 + aux - 1) for aux in range(1, _MAPPED_AUX + 1)),
        )
    ),
    *(_mode(slot, _MODE_DEFAULTS.get(slot)) for slot in range(1, MODE_SLOT_COUNT + 1)),
    *_at_once(
        _choice("rates_style", ("actual", "betaflight"), _STYLE_MEANING),
        *(
            setting
            for axis in AXES
            for setting in (
                replace(
                    _number(f"{axis}_rate", 0.01, 1000.0, _RATE_DEFAULT_DEG_S, "deg/s", _RATE_MEANING),
                    betaflight=Span(0.01, _RC_RATE_MAX, 1.0, "1"),
                ),
                replace(
                    _number(f"{axis}_max", 0.0, RATE_MAX_DEG_S, _MAX_DEFAULT_DEG_S, "deg/s", _MAX_MEANING),
                    betaflight=Span(0.0, 1.0, 0.7, "1"),
                ),
                replace(
                    _number(f"{axis}_expo", 0.0, 1.0, 0.0, "1", "0: none"),
                    betaflight=Span(0.0, 1.0, 0.0, "1"),
                ),
            )
        ),
        _whole("deadband_us", 0, 100, 0, "us", "of roll and pitch"),
        _whole("yaw_deadband_us", 0, 100, 0, "us", "of yaw"),
    ),
    _switch("interpolation", False, "a ramp between two receiver frames"),
    _choice("failsafe_stage", ("drop", "descend"), "after the hold"),
    _number("failsafe_throttle", 0.0, 1.0, 0.2, "1", "while descending"),
    _whole("failsafe_descend_ms", 0, 60_000, 3000, "ms", "then the motors stop"),
    _whole("failsafe_hold_ms", RECEIVER_PAUSE_MS, RECEIVER_FLAG_MS, RECEIVER_HOLD_MS, "ms", _HOLD_MEANING),
    _whole("failsafe_delay_ms", 200, 20_000, RECEIVER_LOST_MS, "ms", _DELAY_MEANING),
    _number("level_limit_deg", 0.0, 180.0, 25.0, "deg", "tilt that arming allows; 0: any, known or not"),
    _whole("arming_delay_ms", BOOT_GRACE_MS, 10_000, ARMING_DELAY_MS, "ms", _ARMING_DELAY_MEANING),
    # Less leaves the motors too little room above their idle: the NF1 needs more than a second to stop.
    _number("motor_limit", 0.45, 1.0, 1.0, "1", "largest motor fraction"),
    _whole(
        "dynamic_idle_rpm", 0, 10_000, 0, "rpm", "that the slowest motor keeps, by motor_telemetry; 0: off"
    ),
    _switch("motor_stop", False, "armed with the throttle low, motors stand still"),
    *(
        _whole(
            f"motor{motor}_output", 1, MOTOR_COUNT_MAX, motor, "output", "that this motor's ESC is wired to"
        )
        for motor in range(1, MOTOR_COUNT_MAX + 1)
    ),
    _switch("motors_reversed", False, "props out: all motors turn the other way than in the aircraft file"),
    _switch("motor_check", True, "off: arms whether motors and gyro were checked or not"),
    _whole("motors_checked", 0, MOTOR_KEY_MAX, 0, "", _CHECKED_MEANING),
    _choice("motor_protocol", ("dshot300", "dshot600", "dshot150"), "to the ESCs", default=1),
    _switch("motor_telemetry", False, "ESCs tell rotor speeds over the motor wires: bidirectional DShot"),
    _whole("motor_poles", 2, 100, MOTOR_POLES_DEFAULT, "magnets", "of a motor's bell; even"),
    *_at_once(
        *(
            _number(f"pid_{axis}_{term}", low, high, 1.0, "1", _GAIN_MEANING)
            for axis in AXES
            for term, low, high in _GAIN_FACTORS
        )
    ),
    _whole("battery_cells", 0, 6, 0, "cells", "0: found from the voltage at boot"),
    _number(
        "battery_scale", 0.0, 100.0, 0.0, "1", "volts at the pack for one at the pin; 0: as the board has it"
    ),
    _number("current_scale", 0.0, 1000.0, 0.0, "mV/A", "of the sensor; 0: as the board has it"),
    _number("battery_warn_v", 2.5, 4.4, 3.5, "V", "a cell: warning"),
    _number("battery_low_v", 2.5, 4.4, 3.3, "V", "a cell: land now"),
    _whole("battery_capacity_mah", 0, 65_535, 0, "mAh", "of the pack; 0: not told"),
    *(_switch(f"beep_{name}", True, meaning) for name, meaning in _BEEPS.items()),
    _text("craft_name", "the aircraft's name"),
    _text("pilot_name", "the pilot's name"),
    _choice("msp_variant", ("btfl", "nrfl"), "the firmware that MSP says it is; btfl: configurators connect"),
    _choice(
        "uart3_function",
        ("off", "msp", "blackbox"),
        "what UART3 does: msp a second MSP port, blackbox sends the log",
    ),
    _whole("uart3_baud", MSP_BAUDS[0], MSP_BAUDS[-1], MSP_BAUD_DEFAULT, "baud", "of UART3, as msp_baud"),
    _choice(
        "blackbox_device",
        _DEVICES,
        "where the log goes; card: to the board's SD card or flash chip",
        default=LogDevice.CARD,
    ),
    _choice("blackbox_mode", ("normal", "always"), "normal: while armed; always: from power-up"),
    _whole(
        "blackbox_divider", LOG_DIVIDERS[0], LOG_DIVIDERS[-1], LOG_DIVIDERS[0], "steps", _LOG_STEPS_MEANING
    ),
    _whole("blackbox_disabled_mask", 0, (1 << (max(LogGroup) + 1)) - 1, 0, "bits", _GROUPS_MEANING),
    _whole("blackbox_baud", LOG_BAUDS[0], LOG_BAUDS[-1], LOG_BAUD_DEFAULT, "baud", _LOG_BAUD_MEANING),
    _number("chirp_amplitude", 1.0, 300.0, 100.0, "deg/s", "of the mode CHIRP, at low frequencies"),
    _number("chirp_start_hz", 0.2, 250.0, 1.0, "Hz", "where its sweep begins"),
    _number("chirp_end_hz", 0.2, 250.0, 100.0, "Hz", _CHIRP_END_MEANING),
    _number("chirp_s", 1.0, 120.0, 20.0, "s", "how long its sweep takes"),
    _switch("crash_detection", True, "motors stop when the aircraft does what no pilot asked for"),
    _switch("runaway_detection", True, "the same right after arming"),
    _switch("plausibility_detection", True, "the PID takes over from a policy that steers wrongly"),
    _switch("policy_trial", False, "the policy flies only while the mode TRIAL is on"),
    _switch("ground_detection", True, "off: in the air as soon as it is armed, as on a rig"),
)
