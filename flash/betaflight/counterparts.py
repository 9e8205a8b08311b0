"""Betaflight's settings that have a counterpart here, one by one, and why the others have none.

Names, units and limits: src/main/cli/settings.c of Betaflight 3.0.1 to 2026.6.1. A number means the
same as in MSP's field for it: toolchain/contract/msp_configuration.py.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from neuroflight.flash.settings.text import NO_TEXT, Value, check_text
from neuroflight.toolchain.contract import Alignment
from neuroflight.toolchain.errors import LinkError

Changes = dict[str, Value]
Convert = Callable[
    [str], Changes
]  # converts a value's text to settings; raises ValueError, one line, if none is equal


@dataclass(frozen=True)
class Counterpart:
    """This firmware's counterpart of a Betaflight setting."""

    group: str  # settings of the same group are imported together or not at all
    convert: Convert
    of_board: bool = False  # a property of the board: imported for the same board only


def number(text: str) -> int:
    """Read a whole number. Raises ValueError, one line."""
    if not re.fullmatch(r"[+-]?\d{1,9}", text):
        raise ValueError(f"got {text[:30]!r}, expected a whole number")
    return int(text)


def is_on(text: str) -> bool:
    """Read ON or OFF. Raises ValueError, one line."""
    if text.upper() not in ("ON", "OFF", "1", "0"):
        raise ValueError(f"got {text[:30]!r}, expected ON or OFF")
    return text.upper() in ("ON", "1")


def _scaled(name: str, factor: float = 1.0, offset: float = 0.0) -> Convert:
    return lambda text: {name: round((number(text) + offset) * factor, 6)}


def _switch(name: str) -> Convert:
    return lambda text: {name: float(is_on(text))}


def _choice(name: str, choices: Mapping[str, float], missing: str) -> Convert:
    def convert(text: str) -> Changes:
        if text.upper() not in choices:
            raise ValueError(f"{text[:30]}: {missing}")
        return {name: choices[text.upper()]}

    return convert


def _text(name: str) -> Convert:
    def convert(text: str) -> Changes:
        text = "" if text == NO_TEXT else text
        try:
            check_text(name, text)
        except LinkError as error:
            raise ValueError(str(error)) from None
        return {name: text}

    return convert


def _small_angle(text: str) -> Changes:
    if number(text) == 0:
        raise ValueError("0 forbids arming in Betaflight, and allows any tilt here")
    return {"level_limit_deg": float(number(text))}


def _direction(text: str) -> Changes:
    if number(text) not in (-1, 1):
        raise ValueError("expected 1 or -1")
    return {"motors_reversed": float(number(text) == -1)}


def _cell_volts(name: str) -> Convert:
    """Read a cell's voltage: tenths of a volt up to 50, else hundredths; no cell has 0.5 V or 10 V."""

    def convert(text: str) -> Changes:
        read = number(text)
        return {name: round(read / (10 if read <= 50 else 100), 3)}

    return convert


_ALIGNMENTS = {"DEFAULT": 0.0} | {a.name.replace("_", ""): 1.0 + a for a in Alignment}
_PROCEDURES = {"DROP": 0.0, "AUTO-LAND": 1.0, "1": 0.0, "0": 1.0}
_PROTOCOLS = {"DSHOT150": 2.0, "DSHOT300": 0.0, "DSHOT600": 1.0}
_RECEIVERS = {"SBUS": 0.0, "CRSF": 1.0}
_NO_ANGLES = "chips here are turned by quarters; `board_yaw_deg` and its like turn the whole board"
_CURRENT = Counterpart("current sensor", _scaled("current_scale", 0.1), of_board=True)
_GYRO = Counterpart("gyro", _choice("gyro_alignment", _ALIGNMENTS, _NO_ANGLES), of_board=True)
_GYRO_SELECT = Counterpart(
    "gyro", _choice("gyro_select", {"FIRST": 0.0, "SECOND": 1.0}, "one gyro is flown here"), of_board=True
)
_CAPACITY = Counterpart("battery", _scaled("battery_capacity_mah"))

SETTINGS: dict[str, Counterpart] = {
    "name": Counterpart("names", _text("craft_name")),
    "craft_name": Counterpart("names", _text("craft_name")),
    "display_name": Counterpart("names", _text("pilot_name")),
    "pilot_name": Counterpart("names", _text("pilot_name")),
    "serialrx_provider": Counterpart(
        "receiver", _choice("receiver_protocol", _RECEIVERS, "receivers here speak SBUS or CRSF")
    ),
    "deadband": Counterpart("dead bands", _scaled("deadband_us")),
    "yaw_deadband": Counterpart("dead bands", _scaled("yaw_deadband_us")),
    "yaw_motors_reversed": Counterpart("turning direction", _switch("motors_reversed")),
    "yaw_motor_direction": Counterpart("turning direction", _direction),  # to 3.1
    "motor_pwm_protocol": Counterpart(
        "motor protocol",
        _choice("motor_protocol", _PROTOCOLS, "ESCs here are told by DShot150, DShot300 or DShot600"),
    ),
    "failsafe_procedure": Counterpart(
        "failsafe", _choice("failsafe_stage", _PROCEDURES, "the failsafe here drops or descends")
    ),
    "failsafe_delay": Counterpart("failsafe delay", _scaled("failsafe_delay_ms", 100)),
    "failsafe_off_delay": Counterpart("failsafe descent", _scaled("failsafe_descend_ms", 100)),
    "failsafe_landing_time": Counterpart(
        "failsafe descent", _scaled("failsafe_descend_ms", 1000)
    ),  # from 4.6
    "failsafe_throttle": Counterpart("failsafe descent", _scaled("failsafe_throttle", 0.001, -1000)),
    "small_angle": Counterpart("tilt that arming allows", _small_angle),
    "bat_capacity": _CAPACITY,
    "battery_capacity": _CAPACITY,  # 3.0
    "force_battery_cell_count": Counterpart("battery cells", _scaled("battery_cells")),
    "vbat_warning_cell_voltage": Counterpart("battery voltages", _cell_volts("battery_warn_v")),
    "vbat_min_cell_voltage": Counterpart("battery voltages", _cell_volts("battery_low_v")),
    "ibata_scale": _CURRENT,
    "ibat_scale": _CURRENT,  # 3.1
    "current_meter_scale": _CURRENT,  # 3.0
    "gyro_1_sensor_align": _GYRO,
    "gyro_to_use": _GYRO_SELECT,  # to 4.5
    "align_gyro": _GYRO,  # to 3.5
}
BEEPERS = {  # conditions that beep here too: firmware/src/msp/msp_sources.c
    "RX_LOST": "beep_receiver_lost",
    "DISARMING": "beep_disarmed",
    "ARMING": "beep_armed",
    "BAT_CRIT_LOW": "beep_battery_low",
    "BAT_LOW": "beep_battery_warn",
}

FILE = "of the file or its board, no setting"
_GPS = "there is no GPS, barometer, compass or range finder"
_OSD = "there is no on-screen display"
_TELEMETRY = "telemetry tells what it tells; nothing of it can be set"
_THROTTLE = "the throttle has no curve or limit here; set it in the transmitter"
_REASONS = (  # prefix of a command's or setting's name: why it is left out; the first match counts
    (
        r"(batch|defaults|save|diff|dump|exit|version|profile|rateprofile|board_name|manufacturer_id|mcu_id|signature)\b",
        FILE,
    ),
    (
        r"resource|timer|dma|.*_(spi|i2c)_|.*_(spi|i2c)bus",
        "pins, timers and DMA streams are built into the image",
    ),
    (r"led|color|mode_color", "there is no LED strip"),
    (
        r"vtx|vcd|max7456|cam|tramp|smartaudio|displayport",
        "nothing here speaks to a video transmitter or a camera",
    ),
    (r"osd|cms|dashboard|feature -?(osd|display)", _OSD),
    (
        r"gps|nav_|baro|mag_|rangefinder|sonar|altitude|alt_hold|position|feature -?(gps|sonar|rangefinder)",
        _GPS,
    ),
    (r"tlm|telemetry|frsky|hott|ibus|smartport|mavlink|crsf|feature -?telemetry", _TELEMETRY),
    (
        r"blackbox|debug|feature -?blackbox",
        "the log is set by `blackbox_device` and its like, for this control rate",
    ),
    (
        r"gyro_(low|lpf|notch|soft|dyn|hardware|filter)|dyn_(notch|lpf_gyro)|rpm_|simplified_gyro",
        "a policy flies behind the gyro filters that it was trained with (`filter1_kind` and its like)",
    ),
    (
        r"[pidfs]_(roll|pitch|yaw|level|mag|vel|alt)|d_m|pid|dterm|dyn_lpf|yaw_lowpass|iterm|feedforward|ff_|tpa|"
        r"anti_gravity|simplified|level_|horizon_|angle_|setpoint|vbat_(sag|pid)|thrust_linear|throttle_boost",
        "the policy has no gains, and the PID's are built in (`pid_roll_p` and its like are factors of them)",
    ),
    (
        r"motor|dshot|min_throttle|max_throttle|min_command|idle|digital_idle|use_unsynced|3d_|feature -?3d",
        "idle and range of the motors are the controller's (`motor_limit` caps all)",
    ),
    (r"thr_|throttle", _THROTTLE),
    (
        r"rc_smooth|rc_interp",
        "controllers take the receiver's own steps (`interpolation`: a ramp between two frames)",
    ),
    (r"rates_|quick_|rc_", "no counterpart among the rates here"),
    (
        r"rxfail|failsafe",
        "until the failsafe stage rates are centred, throttle and modes held, on every channel",
    ),
    (
        r"rx|serialrx|sbus|rssi|min_check|max_check|mid_rc|spektrum|feature -?(rx|rssi)",
        "the receiver's line is fixed: SBUS inverted, CRSF not, 1000 to 2000 us, no RSSI channel",
    ),
    (r"servo|smix|tri_|channel_forward|feature -?(servo|channel)", "there are no servos"),
    (r"acc_|gyro_|align_|sensor|imu_|moron", "sensors and their calibration are this board's own"),
    (
        r"vbat|ibat|bat_|current_|feature -?(vbat|current)",
        "voltage and current are measured at the board's pins",
    ),
    (r"adjrange", "nothing is adjusted in flight but by the modes"),
    (r"beacon", "the ESCs beep for no condition here"),
    (r"beeper", "the beeper has no such condition here"),
    (r"serial", "ports have fixed uses: UART1 MSP, UART2 the receiver, UART3 by `uart3_function`"),
)
_COMPILED = tuple((re.compile(pattern), reason) for pattern, reason in _REASONS)
COMMANDS = frozenset(  # all commands in such files; src/main/cli/cli.c of the same versions
    {
        *(
            "adjrange",
            "aux",
            "batch",
            "battery_profile",
            "beacon",
            "beeper",
            "board_name",
            "color",
            "defaults",
        ),
        *(
            "diff",
            "display_name",
            "dma",
            "dump",
            "exit",
            "feature",
            "led",
            "manufacturer_id",
            "map",
            "mcu_id",
        ),
        *("mixer", "mmix", "mode_color", "name", "profile", "rateprofile", "resource", "rxfail", "rxrange"),
        *("save", "serial", "servo", "signature", "simplified_tuning", "smix", "timer", "version", "vtx"),
        *("vtxtable", "waypoint"),
    }
)
NOT_A_COMMAND = "no command of Betaflight's"


def reason_without(text: str) -> str:
    """Return why a line has no counterpart, by its command or its setting's name."""
    return next((reason for pattern, reason in _COMPILED if pattern.match(text)), "no counterpart here")
