"""The table of MSP messages: number, payload, when a request may come and why it may be refused.

The firmware's dispatch, what `flash` sends and reads, and docs/reference/msp.md follow from it. Messages of
the ecosystem are as at API 1.47; those from 0x4E00 on are this project's and need version 2.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from enum import Enum, IntEnum
from functools import partial

from neuroflight.toolchain.contract.blackbox import LOG_ERASE_MAGIC, LOG_NAME_BYTES
from neuroflight.toolchain.contract.frame_time_sensors import MOTOR_COUNT_MAX
from neuroflight.toolchain.contract.image_format import IMAGE_BUILD_BYTES, IMAGE_FIELDS, IMAGE_HEADER_FORMAT
from neuroflight.toolchain.contract.modes import MODE_SLOT_COUNT
from neuroflight.toolchain.contract.motors import MOTOR_BENCH_MAGIC, MOTOR_TEST_MAGIC
from neuroflight.toolchain.contract.msp import (
    MSP_ADJUSTMENT_SLOTS,
    MSP_PAYLOAD_MAX,
    MSP_POLICY_NONE,
    MSP_STREAM_RATE_MAX_HZ,
    Refusal,
)
from neuroflight.toolchain.contract.msp_fields import (
    Fields,
    MspField,
    MspGroup,
    counted,
    f32,
    i8,
    i16,
    number,
    numbers,
    octets,
    text,
    u8,
    u16,
    u32,
)
from neuroflight.toolchain.contract.policy_format import SHA256_BYTES
from neuroflight.toolchain.contract.receiver import CHANNEL_COUNT
from neuroflight.toolchain.contract.settings import AT_ONCE, SETTING_TEXT_BYTES
from neuroflight.toolchain.contract.structs import FAULT_FILE_BYTES, FAULT_REGISTERS, FaultKind

__all__ = ["Access", "Msp", "MspWhen"]


class MspWhen(Enum):
    """Conditions under which a request is carried out; else it is refused as ARMED."""

    ALWAYS = "always"
    STOPPED = "disarmed"
    STORING = "disarmed, and nothing arms meanwhile: flash is written"
    NEVER = "it is no request"


@dataclass(frozen=True)
class Access:
    """The condition of a request, and every other reason why it may be refused."""

    when: MspWhen = MspWhen.ALWAYS
    refusals: tuple[Refusal, ...] = ()
    note: str = ""


class Answers(Enum):
    """Files of firmware/src/msp that answer messages."""

    CONFIGURATION = "msp_fields.c, by the settings behind its fields: msp_configuration.py, msp_tuning.py"
    REPLY = "msp_replies.c: reply_<name>"
    COMMAND = "msp_commands.c: command_<name>"
    LIST = "msp_lists.c"
    NOBODY = "none: it comes unasked"


@dataclass(frozen=True)
class Payload:
    """Fields of a message in one direction; those behind the first `required` are of newer versions."""

    fields: Fields
    required: int | None = None  # None: all
    sizes: tuple[int, int] | None = None  # shortest and longest request [bytes]; None: as its fields say


@dataclass(frozen=True)
class Message:
    """A row of the table."""

    number: int
    answers: Answers = Answers.CONFIGURATION
    request: Payload | None = None  # None: empty, or that of a configuration message
    reply: Payload | None = None
    access: Access = field(default_factory=Access)
    acknowledges: Access | None = None  # with the fields not required: command_<name>_acknowledge
    once: bool = False  # doing it twice is not doing it once: it is never sent again unasked


def payload(
    *fields: MspField | MspGroup, required: int | None = None, sizes: tuple[int, int] | None = None
) -> Payload:
    """Return a payload of these fields."""
    return Payload(fields, required, sizes)


def tells(number: int, *fields: MspField | MspGroup, required: int | None = None) -> Message:
    """Return the row of a message that only reads."""
    return Message(number, Answers.REPLY, reply=payload(*fields, required=required))


def acts(
    when: MspWhen,
    number: int,
    refusals: tuple[Refusal, ...] = (),
    request: Payload | None = None,
    reply: Payload | None = None,
    note: str = "",
    acknowledges: Access | None = None,
    once: bool = False,
) -> Message:
    """Return the row of a message with a function of its own; one of another size is refused as PAYLOAD."""
    access = Access(when, (Refusal.PAYLOAD, *refusals), note)
    request = payload() if request is None and reply is None else request
    return Message(number, Answers.COMMAND, request, reply, access, acknowledges, once)


# Rows of `acts` by when they may come.
asks, stopped, stores = (partial(acts, when) for when in (MspWhen.ALWAYS, MspWhen.STOPPED, MspWhen.STORING))


def configures(number: int, *refusals: Refusal, note: str = "") -> Message:
    """Return the row of a configuration message that may be refused."""
    return Message(number, access=Access(MspWhen.ALWAYS, refusals, note))


def lists(
    number: int,
    refusals: tuple[Refusal, ...] = (),
    request: Payload | None = None,
    reply: Payload | None = None,
) -> Message:
    """Return the row of a message that tells a list."""
    return Message(number, Answers.LIST, request, reply, Access(MspWhen.ALWAYS, refusals))


def changes(number: int, request: Payload, *, read_first: bool = False, note: str = "") -> Message:
    """Return the row of a message that changes a list; read_first: only of a peer that has read it."""
    return Message(number, Answers.LIST, request, access=set_access(read_first, note))


def set_access(read_first: bool, note: str = "") -> Access:
    """Return when a message that changes settings may come."""
    refusals = (_R.PAYLOAD, _R.INDEX, _R.RANGE, _R.CONFLICT, _R.ABSENT)
    if not read_first:
        return Access(_STOPPED, refusals)
    return Access(_STOPPED, (*refusals, _R.ORDER), _READ_FIRST + note)


_READ_FIRST = "refused as `order` until this peer has read its counterpart, as its zeros mean something"
_R = Refusal
_STOPPED, _STORING = MspWhen.STOPPED, MspWhen.STORING
_STARTED = (
    "REBOOT starts it; `blob` where no slot holds a policy that it can fly; may be repeated: the number stays"
)
_BOTH = "while the other bank's image is started next, or is the one to go back to"
_LOG_ORDER = "`absent` where the device keeps no logs, `order` while one is written"
_WRITES = (_R.ORDER, _R.FLASH, _R.ABSENT)
_LOGS = (_R.INDEX, _R.ORDER, _R.LOG, _R.ABSENT)
_US = "us"

_SETTING = u16("setting", "", "its index: place in docs/reference/settings.md, from 0")
_KIND = u8("kind", "", "0 u32, 1 f32, 2 mode range packed in a u32, 3 text")
_HEADER_FIELDS = ", ".join(field.name for field in IMAGE_FIELDS)
_LOG = u16("log", "", "its index, from 0")
_STATE = u8("state", "", "0 done, 1 under way: ask again")
_LIMIT = "as the kind says; of a text its length"


def _piece(of: str) -> Payload:
    return payload(
        u32("offset", "bytes", "a multiple of 4: where the last one ended"),
        octets("data", f"of the {of}, a multiple of 4"),
        sizes=(8, MSP_PAYLOAD_MAX),
    )


def _list(name: str, kind: str, unit: str, meaning: str) -> MspGroup:
    return MspGroup(name, (number(kind, name[:-1], unit),), counted=True, meaning=meaning)


_STATUS = (
    u16("cycle_time", _US, "control period"),
    u16("i2c_errors"),
    u16("sensors", "bits", "0 accelerometer, 5 gyro"),
    u32("modes", "bits", "in the order of BOXIDS"),
    u8("profile"),
    u16("load", "%"),
)
_ARMING = (
    u8("further_modes", "bytes"),
    u8("arming_flag_count"),
    u32("arming_flags", "bits", "the ecosystem's numbers, see Numbers"),
    u8("configuration_state", "bits"),
    u16("core_temperature", "deg C"),
    u8("rate_profiles"),
)
_RANGE = (
    u8("mode"),
    u8("aux", "", "0 is AUX 1"),
    u8("low", "25 us above 900"),
    u8("high", "25 us above 900"),
)
_LOGIC = (u8("logic", "", "1: and the others"), u8("linked", "", "0"))
_PORT = (
    u8("port", "", "0 is UART1, 20 USB"),
    u32("functions", "bits", "0 MSP, 6 serial receiver, 7 blackbox"),
    *numbers("u8", "msp_baud gps_baud telemetry_baud blackbox_baud", "", "index of 0, 9600, 19200 .."),
)
_PORT_OLD = (_PORT[0], u16("functions", "bits", "the lower ones"), *_PORT[2:])
_OUTPUTS = MspGroup("outputs", (u8("output", "", "of the motor, from 0"),), counted=True)

_ROWS: dict[int, Message] = {}


class Msp(IntEnum):
    """Commands of the MultiWii Serial Protocol that this firmware answers; numbers are the ecosystem's."""

    _value_: int

    def __new__(cls, row: Message | int) -> Msp:
        """row: a number alone is that of a configuration message."""
        message = Message(row) if isinstance(row, int) else row
        member = int.__new__(cls, message.number)
        member._value_ = message.number
        _ROWS[message.number] = message
        return member

    @property
    def row(self) -> Message:
        """Its row of the table."""
        return _ROWS[self.value]

    API_VERSION = tells(1, *numbers("u8", "protocol major minor"))
    FC_VARIANT = tells(2, text("variant", "as the setting msp_variant says", 4))
    FC_VERSION = tells(
        3, *numbers("u8", "year month patch"), counted("release", "of Betaflight, that has this API")
    )
    BOARD_INFO = tells(
        4,
        text("board", count=4),
        u16("revision"),
        u8("type", "", "0 a flight controller, 2 one with an OSD chip"),
        u8("capabilities", "bits"),
        counted("target"),
        counted("board_name", "firmware, version and policy"),
        counted("maker"),
        octets("signature", count=32),
        u8("mcu", "", "255: not told"),
        u8("configuration_state", "", "2: set up"),
        u16("gyro_rate", "Hz"),
        u32("problems", "bits"),
        *numbers("u8", "spi_devices i2c_devices"),
    )
    BUILD_INFO = tells(
        5,
        text("date", count=11),
        text("time", count=8),
        text("revision", count=7),
        MspGroup("options", (u16("option", "", "0 ends them"),), meaning="what was built in"),
    )
    NAME = tells(10, text("name", "the craft's, or while it has none the policy's"))
    BATTERY_CONFIG = 32
    SET_BATTERY_CONFIG = 33
    MODE_RANGES = lists(34, reply=payload(MspGroup("ranges", _RANGE, count=MODE_SLOT_COUNT)))
    SET_MODE_RANGE = changes(
        35,
        payload(u8("slot"), *_RANGE, *_LOGIC, required=5),
        read_first=True,
        note="; a refused range leaves its slot empty",
    )
    FEATURE_CONFIG = 36
    SET_FEATURE_CONFIG = 37
    BOARD_ALIGNMENT_CONFIG = 38
    SET_BOARD_ALIGNMENT_CONFIG = 39
    CURRENT_METER_CONFIG = 40
    SET_CURRENT_METER_CONFIG = 41
    MIXER_CONFIG = 42
    SET_MIXER_CONFIG = 43
    RX_CONFIG = 44
    SET_RX_CONFIG = 45
    RSSI_CONFIG = 50
    SET_RSSI_CONFIG = 51
    ADJUSTMENT_RANGES = lists(
        52,
        reply=payload(
            MspGroup(
                "slots",
                numbers("u8", "slot aux low high function switch_aux"),
                count=MSP_ADJUSTMENT_SLOTS,
                meaning="unused",
            )
        ),
    )
    SERIAL_CONFIG = lists(54, reply=payload(MspGroup("ports", _PORT_OLD)))
    VOLTAGE_METER_CONFIG = 56
    SET_VOLTAGE_METER_CONFIG = 57
    SONAR = 58
    PID_CONTROLLER = 59
    ARMING_CONFIG = 61
    SET_ARMING_CONFIG = 62
    RX_MAP = 64
    SET_RX_MAP = 65
    REBOOT = stopped(
        68,
        (_R.ABSENT, _R.ORDER),
        request=payload(u8("kind", "", "0"), required=0),
        note="kind 0, or none, starts the firmware, 1 the boot loader in the chip's ROM, 2 (or 3) the "
        "firmware to show its SD card as a disk by USB, until it is unplugged or ejected: `absent` without "
        "a cable, `order` while an image is on probation; 1 to 3: `absent` on the host program",
        once=True,
    )
    DATAFLASH_SUMMARY = 70
    FAILSAFE_CONFIG = 75
    SET_FAILSAFE_CONFIG = 76
    RXFAIL_CONFIG = lists(
        77,
        reply=payload(
            MspGroup(
                "channels", (u8("mode", "", "0 centred, 1 held"), u16("value", _US)), count=CHANNEL_COUNT
            )
        ),
    )
    SET_RXFAIL_CONFIG = changes(78, payload(u8("channel"), u8("mode"), u16("value", _US)))
    SDCARD_SUMMARY = 79
    BLACKBOX_CONFIG = 80
    SET_BLACKBOX_CONFIG = 81
    ADVANCED_CONFIG = 90
    SET_ADVANCED_CONFIG = 91
    FILTER_CONFIG = configures(92, _R.ABSENT, note="where the filters are a chain that it cannot say")
    SET_FILTER_CONFIG = 93
    PID_ADVANCED = 94
    SET_PID_ADVANCED = 95
    SENSOR_CONFIG = 96
    SET_SENSOR_CONFIG = 97
    ARMING_DISABLE = asks(
        99,
        (_R.ARMED, _R.ABSENT),
        request=payload(
            u8("disabled", "", "1: nothing arms from now on"),
            u8("runaway_off", "", "1, with disabled 0: opens the motor test"),
            required=1,
        ),
        reply=payload(),
        note="nothing arms while a peer says so; `00 01` opens the motor test and is `armed` unless the "
        "state is disarmed; it lasts until the peer takes it back, hangs up (TCP) or the firmware starts "
        "anew",
        once=True,
    )
    STATUS = tells(101, *_STATUS, u16("gyro_cycle_time", _US), *_ARMING)
    RAW_IMU = tells(
        102,
        i16("acceleration", "1/2048 g", count=3),
        i16("gyro", "4/16.4 deg/s", count=3),
        i16("magnetometer", count=3),
    )
    MOTOR = tells(104, u16("motors", _US, "1000 stopped, 0: there is none", MOTOR_COUNT_MAX))
    RC = tells(105, u16("channels", _US, "roll, pitch, yaw, throttle, AUX 1 ..", CHANNEL_COUNT))
    ATTITUDE = tells(
        108,
        i16("roll", "0.1 deg", "right +"),
        i16("pitch", "0.1 deg", "nose down +"),
        i16("heading", "deg", "to the right, from where it woke up"),
    )
    ALTITUDE = 109
    ANALOG = tells(
        110,
        u8("voltage_coarse", "0.1 V"),
        u16("drawn", "mAh"),
        u16("rssi", "1/1023"),
        i16("current", "0.01 A"),
        u16("voltage", "0.01 V"),
    )
    RC_TUNING = 111
    PID = 112
    BOXNAMES = tells(116, text("names", "of the modes, each ended by ;"))
    PIDNAMES = tells(117, text("names", "of the rows of PID, each ended by ;"))
    BOXIDS = tells(119, MspGroup("ids", (u8("id"),), meaning="of the modes, in the order of their bits"))
    MOTOR_3D_CONFIG = 124
    RC_DEADBAND = 125
    SENSOR_ALIGNMENT = 126
    VOLTAGE_METERS = tells(128, MspGroup("meters", (u8("id"), u8("voltage", "0.1 V"))))
    CURRENT_METERS = tells(129, MspGroup("meters", (u8("id"), u16("drawn", "mAh"), u16("current", "mA"))))
    BATTERY_STATE = tells(
        130,
        u8("cells"),
        u16("capacity", "mAh"),
        u8("voltage_coarse", "0.1 V"),
        u16("drawn", "mAh"),
        i16("current", "0.01 A"),
        u8("state", "", "0 good, 1 warning, 2 critical, 3 none"),
        u16("voltage", "0.01 V"),
    )
    MOTOR_CONFIG = 131
    COMPASS_CONFIG = 133
    MOTOR_TELEMETRY = tells(
        139,
        MspGroup(
            "motors",
            (
                u32("speed", "rpm", "as the ESC told it last"),
                u16("errors", "0.01 %", "of its answers in the second before; 10000: it is silent"),
                u8("temperature", "deg C"),
                u16("voltage", "0.01 V"),
                u16("current", "0.01 A"),
                u16("drawn", "mAh"),
            ),
            counted=True,
            meaning="by motor; 0 what its ESC does not tell",
        ),
    )
    SIMPLIFIED_TUNING = configures(140, _R.ABSENT, note="where the filters are a chain that it cannot say")
    SET_SIMPLIFIED_TUNING = 141
    VALIDATE_SIMPLIFIED_TUNING = 145
    STATUS_EX = tells(150, *_STATUS, *numbers("u8", "profiles rate_profile"), *_ARMING)
    UID = tells(160, u32("uid", count=3))
    BEEPER_CONFIG = 184
    SET_BEEPER_CONFIG = 185
    SET_RAW_RC = asks(
        200,
        (_R.ABSENT, _R.ORDER),
        request=payload(MspGroup("channels", (u16("channel", _US),)), sizes=(8, 2 * CHANNEL_COUNT)),
        note="`absent` unless the setting `receiver_protocol` is msp; `order` before the last "
        "channels were taken",
        once=True,
    )
    SET_PID = 202
    SET_RC_TUNING = 204
    RESET_CONF = stores(208, (_R.CONFLICT, _R.FLASH, _R.ABSENT), note="stores the defaults")
    # motor test, once MOTOR_TEST or ARMING_DISABLE has opened it
    SET_MOTOR = stopped(
        214,
        (_R.INDEX, _R.RANGE, _R.ORDER, _R.ABSENT),
        request=payload(
            MspGroup("motors", (u16("motor", _US, "1000 or 0: stopped"),)), sizes=(2, 2 * MOTOR_COUNT_MAX)
        ),
        note="`order` without an open motor test, `range` above its limits for a motor and for all together; "
        "values that stop are always taken; as many values as the aircraft has motors, none above 1125, of a "
        "peer that holds the arming lock, open a test up to there, which values that stop all end",
        once=True,
    )
    SET_MOTOR_3D_CONFIG = 217
    SET_RC_DEADBAND = 218
    SET_SENSOR_ALIGNMENT = 220
    SET_MOTOR_CONFIG = 222
    SET_COMPASS_CONFIG = 224
    MODE_RANGES_EXTRA = lists(238, reply=payload(MspGroup("ranges", (u8("mode"), *_LOGIC), counted=True)))
    SET_ACC_TRIM = 239
    ACC_TRIM = 240
    # settings to flash
    EEPROM_WRITE = stores(
        250,
        (_R.CONFLICT, _R.FLASH, _R.ABSENT, _R.SPOILT),
        note="`spoilt` after a refusal of a change of this peer: what was not refused is stored",
    )
    DEBUG = 254
    COMMON_SERIAL_CONFIG = lists(4105, reply=payload(MspGroup("ports", _PORT, counted=True)))
    COMMON_SET_SERIAL_CONFIG = changes(4106, payload(MspGroup("ports", _PORT, counted=True)))
    MOTOR_OUTPUT_REORDERING = lists(12289, reply=payload(_OUTPUTS))
    SET_MOTOR_OUTPUT_REORDERING = changes(12290, payload(_OUTPUTS))
    SEND_DSHOT_COMMAND = stopped(
        12291,
        (_R.INDEX, _R.ORDER, _R.ABSENT),
        request=payload(
            u8("type", "", "0 inline, 1 blocking: the same here"),
            u8("motor", "", "255: all"),
            MspGroup("commands", (u8("command"),), counted=True),
            sizes=(4, MSP_PAYLOAD_MAX),
        ),
        note="one command a message, or one and SAVE; ends the peer's test that SET_MOTOR opened; "
        "otherwise as DSHOT_COMMAND",
        once=True,
    )
    GET_TEXT = lists(
        12294,
        (_R.INDEX,),
        request=payload(
            u8("kind", "", "1 pilot, 2 craft, 3 PID profile, 4 rate profile, 6 firmware and policy")
        ),
        reply=payload(u8("kind"), counted("text")),
    )
    SET_TEXT = changes(
        12295, payload(u8("kind"), counted("text", f"at most {SETTING_TEXT_BYTES} characters"))
    )
    SENSOR_CONFIG_ACTIVE = 12298
    MCU_INFO = tells(12300, u8("mcu", "", "255: not told"), counted("name"))
    GYRO_SENSOR = 12301
    POLICY_INFO = tells(
        0x4E01,
        u32("architecture_hash"),
        *numbers("u16", "observations actions"),
        u32("weights"),
        *numbers("u16", "control_rate gyro_rate", "Hz"),
        u8("good"),
        counted("name"),
        octets("sha256", count=32),
        f32("idle", "motor fraction"),
        u8("source", "", f"0 slot A, 1 slot B, {MSP_POLICY_NONE} none is good"),
        u32("sequence", "", "0: as built"),
        i8("found", "", "in each slot, 0 good, else an error, see Numbers", 2),
        u8("mix", "", "of outputs and throttle: 0 attitude first, 1 centred"),
    )
    TASKS = asks(
        0x4E02,
        reply=payload(
            u32("cycles_hz", "Hz"),
            MspGroup(
                "tasks",
                (
                    u16("rate", "Hz"),
                    *numbers("u32", "runs misses"),
                    *numbers("u32", "worst best mean", "cycles"),
                ),
                counted=True,
                meaning="in the order of Numbers",
            ),
        ),
    )
    FAULTS = asks(
        0x4E03,
        request=payload(
            u32("boot", "", "acknowledges the fault that this boot found; without it nothing is changed"),
            required=0,
        ),
        reply=payload(
            u32("boots", "", "the present one included"),
            u8("pending", "", "1: the newest fault follows, which nobody acknowledged"),
            u32("boot", "", "that found it"),
            u32(
                "fault",
                "",
                "FaultKind: " + ", ".join(f"{kind:d} {kind.name.lower()}" for kind in FaultKind if kind),
            ),
            u32("registers", "", ", ".join(FAULT_REGISTERS), len(FAULT_REGISTERS)),
            u32("line", "", "of the assertion, else the exception's number"),
            text("file", "end of its path", FAULT_FILE_BYTES),
            u32("uptime", "control steps"),
            required=2,
        ),
        acknowledges=Access(_STORING, (_R.PAYLOAD, _R.INDEX, _R.FLASH, _R.ABSENT)),
    )
    SAFETY = tells(
        0x4E04,
        *numbers("u8", "state stop_cause fallback_cause gyro_health", "", "see Numbers"),
        u32("arming_reasons", "bits", "see Numbers"),
        *numbers("u8", "policy_good pid_built_in pid_flies", "", "1: yes"),
        u8("receiver_quality", "%"),
        i16("temperature", "0.01 deg C"),
        f32("idle", "motor fraction"),
        u8("refused_cause", "", "a fallback cause: why the policy must not fly"),
        u8("gyro_identity", "", "WHO_AM_I of the gyro chip, known or not; 0: nothing was read"),
        u8("brown_out", "", "the detector's level + 1, 1: it is off; 0: not told"),
        u8("airborne", "", "1: it has taken off since it was armed"),
        u8("gyro_chip", "", "its number + 1, see Numbers; 0: none that is known"),
        u32("motor_key", "", "of board, aircraft, and how motors and gyro are set: for motors_checked"),
        required=12,
    )
    # all logged faults, and the policy that was refused in flight
    ACKNOWLEDGE = stores(0x4E05, (_R.INDEX, _R.FLASH, _R.ABSENT), once=True)
    IDENTITY = tells(
        0x4E06,
        counted("firmware", "Neuroflight"),
        *numbers("u8", "major minor patch"),
        *numbers("u8", "api_major api_minor"),
        counted("target"),
        text("variant", "what FC_VARIANT tells", 4),
        counted("policy", "the aircraft that it was trained on; none: no policy is good"),
        octets("policy_sha256", count=32),
    )
    CALIBRATE = stopped(0x4E07, (_R.ABSENT,), note="in the state disarmed only, else `armed`", once=True)
    SETTING_INFO = asks(
        0x4E10,
        (_R.INDEX,),
        request=payload(_SETTING),
        reply=payload(
            u16("count", "", "settings in all"),
            _KIND,
            octets("low", _LIMIT, 4),
            octets("high", _LIMIT, 4),
            octets("default", "as the kind says", 4),
            counted("name"),
            counted("unit"),
        ),
    )
    SETTING_GET = asks(
        0x4E11,
        (_R.INDEX,),
        request=payload(_SETTING),
        reply=payload(_KIND, octets("value", f"4 bytes, {SETTING_TEXT_BYTES} of a text")),
    )
    SETTING_SET = stopped(
        0x4E12,
        (_R.INDEX, _R.RANGE),
        request=payload(
            _SETTING,
            octets("value", f"4 bytes, {SETTING_TEXT_BYTES} of a text, ended by zeros"),
            sizes=(6, 2 + SETTING_TEXT_BYTES),
        ),
        note=f"flown from the next boot on, {AT_ONCE} at once; "
        "what does not go together is refused when it is stored",
    )
    SETTINGS_DEFAULT = stopped(0x4E13, note="not stored yet")
    MOTOR_TEST = stopped(
        0x4E20,
        (_R.ABSENT,),
        request=payload(
            u32(
                "magic",
                "",
                f"0x{MOTOR_TEST_MAGIC:08X} opens, 0 closes, 0x{MOTOR_BENCH_MAGIC:08X} opens for one rotor on "
                "a dynamometer, up to its full speed",
            )
        ),
        note="`armed` unless the state is disarmed; the frames of a DShot command go before its values",
        once=True,
    )
    # beep, direction; disarmed only
    DSHOT_COMMAND = stopped(
        0x4E21,
        (_R.INDEX, _R.ORDER, _R.ABSENT),
        request=payload(u8("motor", "", "255: all"), u8("command")),
        note="`armed` beside a motor test, `order` while another is under way",
        once=True,
    )
    # erases the slot that is not flown
    POLICY_SLOT_BEGIN = stores(
        0x4E30,
        _WRITES,
        request=payload(u32("size", "bytes", "of the blob")),
        reply=payload(u32("sequence", "", "that the blob may have, or a newer one")),
        note=f"`order` after a revert, until the restart, and {_BOTH}",
        once=True,
    )
    POLICY_SLOT_WRITE = stores(
        0x4E31, _WRITES, request=_piece("blob"), note="the last one may be repeated", once=True
    )
    # checks the blob; flown from the next boot on
    POLICY_SLOT_END = stores(
        0x4E32, (_R.ORDER, _R.FLASH, _R.BLOB, _R.SEQUENCE, _R.ABSENT), note="may be repeated", once=True
    )
    # the flown slot's policy is none any more from the next boot on
    POLICY_SLOT_REVERT = stores(
        0x4E33,
        _WRITES,
        note="`order` where no slot is flown or the other one holds no policy for this image, after an "
        f"update until the restart, and {_BOTH}; may be repeated",
    )
    POLICY_SLOT_INFO = asks(
        0x4E34,
        (_R.INDEX,),
        request=payload(u8("source", "", "0 slot A, 1 slot B")),
        reply=payload(
            i8("found", "", "0 good, else an error, see Numbers: why it could not be flown now"),
            u8("flown", "", "1: by this boot"),
            u32("sequence", "", "this and what follows: zeros where there is no whole policy"),
            u32("architecture_hash"),
            u32("filters_hash"),
            u32("control_rate", "Hz"),
            f32("idle", "", "motor fraction at zero thrust"),
            counted("aircraft", "that it was trained on"),
            octets("policy_sha256", "of the ONNX file", SHA256_BYTES),
            octets("build", "of the image that it came with; zeros: for any", IMAGE_BUILD_BYTES),
        ),
    )
    # records of control steps unasked from now on, at the rate told
    STREAM = asks(
        0x4E40,
        (_R.ABSENT,),
        request=payload(u16("rate", "Hz", "0 ends it")),
        reply=payload(
            u16(
                "granted",
                "Hz",
                f"the greatest divisor of the control rate not above it, nor above {MSP_STREAM_RATE_MAX_HZ}",
            )
        ),
        note="ends with rate 0, with its TCP connection, with a restart",
    )
    STREAM_SAMPLE = Message(
        0x4E41,
        Answers.NOBODY,
        reply=payload(
            u16("sequence", "", "counts those that were due: a gap is what the line could not take"),
            u32("step", "", "control step"),
            u32("cycles", "", "that it took"),
            u8("state", "", "FlightState"),
            u8("flags", "bits", "0 armed, 1 the PID flies"),
            f32("setpoint", "rad/s", count=3),
            f32("gyro", "rad/s", count=3),
            f32("throttle", "", "0..1"),
            _list("motors", "u16", "DShot", "in motor order"),
            _list("observations", "f32", "", "none unless armed and the policy flies"),
            _list("actions", "f32", "", "none unless armed"),
        ),
        access=Access(MspWhen.NEVER, (), "comes unasked after STREAM"),
    )
    IMAGE_INFO = asks(
        0x4E50,
        (_R.ABSENT,),
        reply=payload(
            u8("running", "", "bank that this image runs from: 0 A, 1 B"),
            MspGroup(
                "banks",
                (
                    u8(
                        "flags",
                        "bits",
                        "0 its header fits bank and board, else all of it is zeros; 1 numbered, 2 confirmed, "
                        "3 rejected, 4 installed by the ROM and not numbered yet",
                    ),
                    u8("starts", "", "counted ones of an image that is not confirmed"),
                    u32("sequence", "", "of two numbered images the newer one is started"),
                    u32("image_bytes", "bytes"),
                    u32("crc"),
                    octets("version", "major, minor, patch, 0", 4),
                    octets("build", "number of the build, the same in both banks' images", IMAGE_BUILD_BYTES),
                ),
                counted=True,
            ),
            u8("layout", "", "of images and flash map that this firmware knows"),
            required=2,
        ),
    )
    # erases the bank that is not run, for the image of that header
    IMAGE_BEGIN = stores(
        0x4E51,
        (_R.ORDER, _R.IMAGE, _R.FLASH, _R.ABSENT),
        request=payload(
            octets("header", f"of the image: {_HEADER_FIELDS}", struct.calcsize(IMAGE_HEADER_FORMAT))
        ),
        reply=payload(u32("offset", "bytes", "to go on from: not 0 where the same image was under way")),
        note="`image` before anything is erased; `order` while the running image is not confirmed and the "
        "other bank's is, to which the board may have to go back; erasing takes one to two seconds, in which "
        "nothing is answered",
    )
    IMAGE_WRITE = stores(0x4E52, _WRITES, request=_piece("image"), note="the last one may be repeated")
    # checks that all of it has arrived
    IMAGE_END = stores(
        0x4E53,
        (_R.ORDER, _R.IMAGE, _R.ABSENT),
        request=payload(),
        reply=payload(u32("crc", "", "of the image as flash has it")),
        note="may be repeated",
    )
    IMAGE_HASH = stopped(
        0x4E54,
        (_R.INDEX, _R.IMAGE, _R.ABSENT),
        request=payload(u8("bank", "", "0 A, 1 B")),
        reply=payload(octets("sha256", "of the image as flash has it", SHA256_BYTES)),
    )
    # the image of that SHA-256 is started from the next boot on
    IMAGE_SWITCH = stores(
        0x4E55,
        (_R.ORDER, _R.IMAGE, _R.BLOB, _R.FLASH, _R.ABSENT),
        request=payload(octets("sha256", "of the image that is not run", SHA256_BYTES)),
        reply=payload(u32("sequence", "", "number that the image has got")),
        note=_STARTED,
    )
    # what the blackbox does, and how many logs its device keeps
    LOG_INFO = asks(
        0x4E60,
        (_R.ABSENT,),
        reply=payload(
            u8("device", "", "LogDevice, as set"),
            u8("state", "", "LogState"),
            u8("error", "", "LogError: the device's last one, until a log begins well"),
            u8(
                "flags",
                "bits",
                "0 a log is being written, 1 the current or last one lacks control steps, "
                "2 files are still being looked at: there may be more",
            ),
            u16("logs", "", "that can be read"),
            u16("empty", "", "files that can take a log; of a flash chip: how many logs there is room for"),
            u32("capacity", "KiB", "of all files for logs"),
            u32("free", "KiB", "of the empty ones"),
            u32("frames", "", "of the current or last log"),
            u32("dropped", "control steps", "that are missing in it"),
            u32("bytes", "bytes", "of it"),
        ),
    )
    LOG_ENTRY = stopped(
        0x4E61,
        _LOGS,
        request=payload(_LOG),
        reply=payload(
            _LOG,
            _STATE,
            text("name", "of its file", LOG_NAME_BYTES),
            u32("bytes", "bytes", "of the log, its file may be longer"),
        ),
        note=_LOG_ORDER,
    )
    LOG_READ = stopped(
        0x4E62,
        _LOGS,
        request=payload(_LOG, u32("offset", "bytes"), u16("count", "bytes", "at most")),
        reply=payload(
            _LOG,
            u32("offset", "bytes"),
            _STATE,
            octets("data", "as many as fit; none with state 0: the log ends there"),
        ),
        note=_LOG_ORDER,
    )
    # makes all their files empty again
    LOG_ERASE = stopped(
        0x4E63,
        (_R.ORDER, _R.LOG, _R.ABSENT),
        request=payload(u32("magic", "", f"{LOG_ERASE_MAGIC:#x}")),
        reply=payload(_STATE),
        note=f"{_LOG_ORDER}; may be repeated",
    )
