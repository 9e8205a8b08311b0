"""Layouts of the MSP messages that are no configuration by settings alone, and of all together.

Those of the ecosystem are as at API 1.47; those from 0x4E00 on are this project's.
"""

from __future__ import annotations

from neuroflight.toolchain.contract.frame_time_sensors import MOTOR_COUNT_MAX
from neuroflight.toolchain.contract.modes import MODE_SLOT_COUNT
from neuroflight.toolchain.contract.motors import MOTOR_BENCH_MAGIC, MOTOR_TEST_MAGIC
from neuroflight.toolchain.contract.msp import MSP_ADJUSTMENT_SLOTS, MSP_POLICY_NONE, Msp
from neuroflight.toolchain.contract.msp_configuration import CONFIGURATIONS
from neuroflight.toolchain.contract.msp_layouts import (
    Direction,
    MspField,
    MspGroup,
    MspLayout,
    number,
    numbers,
    reply,
    request,
)
from neuroflight.toolchain.contract.msp_own import OWN_LAYOUTS
from neuroflight.toolchain.contract.receiver import CHANNEL_COUNT
from neuroflight.toolchain.contract.settings import SETTING_TEXT_BYTES

__all__ = ["LAYOUTS", "layout_of"]
_US = "us"


def _text(name: str, count: int, meaning: str = "") -> MspField:
    return MspField(name, "text", "", meaning, count)


def _counted(name: str, meaning: str = "") -> MspField:
    return MspField(name, "counted", "", meaning)


def _bytes(name: str, count: int, meaning: str = "") -> MspField:
    return MspField(name, "bytes", "", meaning, count)


def _array(kind: str, name: str, count: int, unit: str = "", meaning: str = "") -> MspField:
    return MspField(name, kind, unit, meaning, count)


# --- Who it is ----------------------------------------------------------------------------------------
_IDENTITY = (
    reply(Msp.API_VERSION, *numbers("u8", "protocol major minor")),
    reply(Msp.FC_VARIANT, _text("variant", 4, "as the setting msp_variant says")),
    reply(
        Msp.FC_VERSION,
        *numbers("u8", "year month patch"),
        _counted("release", "of Betaflight, that has this API"),
    ),
    reply(
        Msp.BOARD_INFO,
        _text("board", 4),
        number("u16", "revision"),
        number("u8", "type", "", "0 a flight controller, 2 one with an OSD chip"),
        number("u8", "capabilities", "bits"),
        _counted("target"),
        _counted("board_name", "firmware, version and policy"),
        _counted("maker"),
        _bytes("signature", 32),
        number("u8", "mcu", "", "255: not told"),
        number("u8", "configuration_state", "", "2: set up"),
        number("u16", "gyro_rate", "Hz"),
        number("u32", "problems", "bits"),
        *numbers("u8", "spi_devices i2c_devices"),
        meaning="which board",
    ),
    reply(
        Msp.BUILD_INFO,
        _text("date", 11),
        _text("time", 8),
        _text("revision", 7),
        MspGroup("options", (number("u16", "option", "", "0 ends them"),), meaning="what was built in"),
    ),
    reply(Msp.NAME, _text("name", 0, "the craft's, or while it has none the policy's")),
    reply(Msp.UID, _array("u32", "uid", 3)),
    reply(
        Msp.IDENTITY,
        _counted("firmware", "Neuroflight"),
        *numbers("u8", "major minor patch"),
        *numbers("u8", "api_major api_minor"),
        _counted("target"),
        _text("variant", 4, "what FC_VARIANT tells"),
        _counted("policy", "the aircraft that it was trained on; none: no policy is good"),
        _bytes("policy_sha256", 32),
        meaning="who this is, whatever FC_VARIANT says",
    ),
    reply(Msp.MCU_INFO, number("u8", "mcu", "", "255: not told"), _counted("name")),
    request(
        Msp.GET_TEXT,
        number("u8", "kind", "", "1 pilot, 2 craft, 3 PID profile, 4 rate profile, 6 firmware and policy"),
    ),
    reply(Msp.GET_TEXT, number("u8", "kind"), _counted("text")),
    request(Msp.SET_TEXT, number("u8", "kind"), _counted("text", f"at most {SETTING_TEXT_BYTES} characters")),
)

# --- How it is ------------------------------------------------------------------------------------------
_STATUS = (
    number("u16", "cycle_time", _US, "control period"),
    number("u16", "i2c_errors"),
    number("u16", "sensors", "bits", "0 accelerometer, 5 gyro"),
    number("u32", "modes", "bits", "in the order of BOXIDS"),
    number("u8", "profile"),
    number("u16", "load", "%"),
)
_ARMING = (
    number("u8", "further_modes", "bytes"),
    number("u8", "arming_flag_count"),
    number("u32", "arming_flags", "bits", "the ecosystem's numbers, see Numbers"),
    number("u8", "configuration_state", "bits"),
    number("u16", "core_temperature", "deg C"),
    number("u8", "rate_profiles"),
)
_LIVE = (
    reply(Msp.STATUS, *_STATUS, number("u16", "gyro_cycle_time", _US), *_ARMING),
    reply(Msp.STATUS_EX, *_STATUS, *numbers("u8", "profiles rate_profile"), *_ARMING),
    reply(
        Msp.RAW_IMU,
        _array("i16", "acceleration", 3, "1/2048 g"),
        _array("i16", "gyro", 3, "4/16.4 deg/s"),
        _array("i16", "magnetometer", 3),
    ),
    reply(Msp.MOTOR, _array("u16", "motors", MOTOR_COUNT_MAX, _US, "1000 stopped, 0: there is none")),
    reply(Msp.RC, _array("u16", "channels", CHANNEL_COUNT, _US, "roll, pitch, yaw, throttle, AUX 1 ..")),
    reply(
        Msp.ATTITUDE,
        number("i16", "roll", "0.1 deg", "right +"),
        number("i16", "pitch", "0.1 deg", "nose down +"),
        number("i16", "heading", "deg", "to the right, from where it woke up"),
    ),
    reply(
        Msp.ANALOG,
        number("u8", "voltage_coarse", "0.1 V"),
        number("u16", "drawn", "mAh"),
        number("u16", "rssi", "1/1023"),
        number("i16", "current", "0.01 A"),
        number("u16", "voltage", "0.01 V"),
    ),
    reply(
        Msp.BATTERY_STATE,
        number("u8", "cells"),
        number("u16", "capacity", "mAh"),
        number("u8", "voltage_coarse", "0.1 V"),
        number("u16", "drawn", "mAh"),
        number("i16", "current", "0.01 A"),
        number("u8", "state", "", "0 good, 1 warning, 2 critical, 3 none"),
        number("u16", "voltage", "0.01 V"),
    ),
    reply(Msp.VOLTAGE_METERS, MspGroup("meters", (number("u8", "id"), number("u8", "voltage", "0.1 V")))),
    reply(
        Msp.CURRENT_METERS,
        MspGroup(
            "meters", (number("u8", "id"), number("u16", "drawn", "mAh"), number("u16", "current", "mA"))
        ),
    ),
    reply(Msp.BOXNAMES, _text("names", 0, "of the modes, each ended by ;")),
    reply(
        Msp.BOXIDS, MspGroup("ids", (number("u8", "id"),), meaning="of the modes, in the order of their bits")
    ),
    reply(Msp.PIDNAMES, _text("names", 0, "of the rows of PID, each ended by ;")),
)

# --- Slots, lists ----------------------------------------------------------------------------------------
_RANGE = (
    number("u8", "mode"),
    number("u8", "aux", "", "0 is AUX 1"),
    number("u8", "low", "25 us above 900"),
    number("u8", "high", "25 us above 900"),
)
_LOGIC = (number("u8", "logic", "", "1: and the others"), number("u8", "linked", "", "0"))
_PORT = (
    number("u8", "port", "", "0 is UART1"),
    number("u32", "functions", "bits", "0 MSP, 6 serial receiver, 7 blackbox"),
    *numbers("u8", "msp_baud gps_baud telemetry_baud blackbox_baud", "", "index of 0, 9600, 19200 .."),
)
_PORT_OLD = (_PORT[0], number("u16", "functions", "bits", "the lower ones"), *_PORT[2:])
_OUTPUTS = MspGroup("outputs", (number("u8", "output", "", "of the motor, from 0"),), counted=True)
_SLOTS = (
    reply(Msp.MODE_RANGES, MspGroup("ranges", _RANGE, count=MODE_SLOT_COUNT)),
    reply(Msp.MODE_RANGES_EXTRA, MspGroup("ranges", (number("u8", "mode"), *_LOGIC), counted=True)),
    request(Msp.SET_MODE_RANGE, number("u8", "slot"), *_RANGE, *_LOGIC, required=5),
    reply(
        Msp.ADJUSTMENT_RANGES,
        MspGroup(
            "slots",
            numbers("u8", "slot aux low high function switch_aux"),
            count=MSP_ADJUSTMENT_SLOTS,
            meaning="unused",
        ),
    ),
    reply(
        Msp.RXFAIL_CONFIG,
        MspGroup(
            "channels",
            (number("u8", "mode", "", "0 centred, 1 held"), number("u16", "value", _US)),
            count=CHANNEL_COUNT,
        ),
    ),
    request(
        Msp.SET_RXFAIL_CONFIG, number("u8", "channel"), number("u8", "mode"), number("u16", "value", _US)
    ),
    reply(Msp.SERIAL_CONFIG, MspGroup("ports", _PORT_OLD)),
    reply(Msp.COMMON_SERIAL_CONFIG, MspGroup("ports", _PORT, counted=True)),
    request(Msp.COMMON_SET_SERIAL_CONFIG, MspGroup("ports", _PORT, counted=True)),
    reply(Msp.MOTOR_OUTPUT_REORDERING, _OUTPUTS),
    request(Msp.SET_MOTOR_OUTPUT_REORDERING, _OUTPUTS),
)

# --- What acts ---------------------------------------------------------------------------------------------
_ACTS = (
    request(
        Msp.ARMING_DISABLE,
        number("u8", "disabled", "", "1: nothing arms from now on"),
        number("u8", "runaway_off", "", "1, with disabled 0: opens the motor test"),
        required=1,
    ),
    reply(Msp.ARMING_DISABLE),
    request(Msp.REBOOT, number("u8", "kind", "", "0"), required=0),
    request(Msp.EEPROM_WRITE),
    request(Msp.RESET_CONF),
    request(Msp.SET_RAW_RC, MspGroup("channels", (number("u16", "channel", _US),))),
    request(Msp.SET_MOTOR, MspGroup("motors", (number("u16", "motor", _US, "1000 or 0: stopped"),))),
    request(
        Msp.SEND_DSHOT_COMMAND,
        number("u8", "type", "", "0 inline, 1 blocking: the same here"),
        number("u8", "motor", "", "255: all"),
        MspGroup("commands", (number("u8", "command"),), counted=True),
    ),
)
_OWN = (
    request(Msp.CALIBRATE),
    request(Msp.ACKNOWLEDGE),
    request(Msp.SETTINGS_DEFAULT),
    request(
        Msp.MOTOR_TEST,
        number(
            "u32",
            "magic",
            "",
            f"0x{MOTOR_TEST_MAGIC:08X} opens, 0 closes, 0x{MOTOR_BENCH_MAGIC:08X} opens for one rotor on a "
            "dynamometer, up to its full speed",
        ),
    ),
    request(Msp.DSHOT_COMMAND, number("u8", "motor", "", "255: all"), number("u8", "command")),
    reply(
        Msp.SAFETY,
        *numbers("u8", "state stop_cause fallback_cause gyro_health", "", "see Numbers"),
        number("u32", "arming_reasons", "bits", "see Numbers"),
        *numbers("u8", "policy_good pid_built_in pid_flies", "", "1: yes"),
        number("u8", "receiver_quality", "%"),
        number("i16", "temperature", "0.01 deg C"),
        number("f32", "idle", "motor fraction"),
        number("u8", "refused_cause", "", "a fallback cause: why the policy must not fly"),
        number("u8", "gyro_identity", "", "WHO_AM_I of the gyro chip, known or not; 0: nothing was read"),
        number("u8", "brown_out", "", "the detector's level + 1, 1: it is off; 0: not told"),
        number("u8", "airborne", "", "1: it has taken off since it was armed"),
        required=12,
    ),
    reply(
        Msp.TASKS,
        number("u32", "cycles_hz", "Hz"),
        MspGroup(
            "tasks",
            (
                number("u16", "rate", "Hz"),
                *numbers("u32", "runs misses"),
                *numbers("u32", "worst best mean", "cycles"),
            ),
            counted=True,
            meaning="in the order of Numbers",
        ),
    ),
    reply(
        Msp.POLICY_INFO,
        number("u32", "architecture_hash"),
        *numbers("u16", "observations actions"),
        number("u32", "weights"),
        *numbers("u16", "control_rate gyro_rate", "Hz"),
        number("u8", "good"),
        _counted("name"),
        _bytes("sha256", 32),
        number("f32", "idle", "motor fraction"),
        number("u8", "source", "", f"0 slot A, 1 slot B, {MSP_POLICY_NONE} none is good"),
        number("u32", "sequence", "", "0: as built"),
        _array("i8", "found", 2, "", "in each slot, 0 good, else an error of nf_err.h"),
        number("u8", "mix", "", "of outputs and throttle: 0 attitude first, 1 centred"),
    ),
)
_CONFIGURED = tuple(
    layout for pair in CONFIGURATIONS for layout in (pair.reply, pair.request) if layout is not None
)

LAYOUTS = (*_IDENTITY, *_LIVE, *_CONFIGURED, *_SLOTS, *_ACTS, *_OWN, *OWN_LAYOUTS)
_BY_KEY = {(layout.message, layout.direction): layout for layout in LAYOUTS}


def layout_of(message: Msp, direction: Direction = Direction.REPLY) -> MspLayout:
    """Return the layout of a message. Raises KeyError if its payload is empty, or is read by flash/records.py
    and flash/requests.py."""
    return _BY_KEY[message, direction]
