"""One truth for each fact that C and Python share.

Everything here is a constant or a small frozen table. `toolchain.rendering.contract_header` renders it as
`nf_contract.h` for the firmware; Python rooms import it directly. Depends on nothing.
"""

from __future__ import annotations

import math
import re
import struct
from dataclasses import dataclass
from enum import IntEnum

# --- Axes and motors -------------------------------------------------------------------------
# Body frame: x forward, y left, z up, right-handed. Rates [rad/s]: roll right +, pitch nose-down +,
# yaw left +. Motors: 1 rear right, 2 front right, 3 rear left, 4 front left; index = number - 1.
AXES = ("roll", "pitch", "yaw")
MOTOR_COUNT_MAX = 8

# --- Time ------------------------------------------------------------------------------------
GYRO_EDGE_RATE_HZ = 8000  # MPU6500 data-ready with DLPF_CFG 0, whatever its divider says
GYRO_RATES_HZ = (1000, 2000, 4000, 8000)  # every 8th, 4th, 2nd or each edge is read
GYRO_RATE_DEFAULT_HZ = 4000
CONTROL_RATES_HZ = (1000, 2000, 4000)

# --- Gyro ------------------------------------------------------------------------------------
GYRO_FULL_SCALE_DEG_S = 2000  # +-2000 deg/s over int16
GYRO_COUNTS = 32768  # counts at full scale: 16.384 LSB per deg/s
GYRO_SATURATED_COUNTS = 32760  # from here on to either side the rate may be any
GYRO_BANDWIDTH_HZ = 250.0  # of MPU6500 and ICM20689 with DLPF_CFG 0
ACCEL_FULL_SCALE_G = 16  # +-16 g over int16
ACCEL_COUNTS = 32768
GRAVITY = 9.80665  # [m/s^2], the standard one

# --- Pilot's sticks --------------------------------------------------------------------------
CHANNEL_COUNT = 16
CHANNEL_ROLL, CHANNEL_PITCH, CHANNEL_THROTTLE, CHANNEL_YAW, CHANNEL_ARM = range(5)
CHANNEL_PID, CHANNEL_BEEPER = 5, 6
CHANNEL_MIN_US, CHANNEL_MID_US, CHANNEL_MAX_US = 1000, 1500, 2000
CHANNEL_VALID_MIN_US, CHANNEL_VALID_MAX_US = 750, 2250  # no pulse of a receiver lies outside
ARM_ON_US = 1700  # the arm channel at or above this asks for armed motors
PID_ON_US = 1700  # at or above this the PID flies
BEEPER_ON_US = 1700
THROTTLE_LOW_US = 1050  # arming needs the throttle at or below this
RATE_FULL_STICK_DEG_S = 1000  # as set by default: linear, no deadband, expo or interpolation

# SBUS: 25 bytes, 16 channels of 11 bits. microseconds = 880 + (5 value + 4) / 8, in integers.
SBUS_FRAME_BYTES = 25
SBUS_HEADER, SBUS_FOOTER = 0x0F, 0x00
SBUS_FLAG_FRAME_LOST, SBUS_FLAG_FAILSAFE = 0x04, 0x08

# CRSF: sync, length of what follows, type, payload, CRC-8/DVB-S2 over type and payload; channels as in SBUS.
CRSF_SYNC = 0xC8
CRSF_FRAME_BYTES_MAX = 64
CRSF_TYPE_LINK, CRSF_TYPE_CHANNELS = 0x14, 0x16

# --- Arming and failsafe, in milliseconds of gyro samples ------------------------------------
BOOT_GRACE_MS = 1000  # no arming before this
CALIBRATION_MS = 1000  # length of the still gyro average
CALIBRATION_MOTION_DEG_S = 5.0  # a standard deviation above this is motion: start again
CALIBRATION_BIAS_DEG_S = 20.0  # a mean above this is motion: start again
RECEIVER_HOLD_MS = 100  # silence after which the sticks are taken as centred, throttle kept
RECEIVER_LOST_MS = 400  # silence after which the configured failsafe stage begins
RECEIVER_RECOVERY_MS = 200  # frames must come this long before a lost link counts as good again
GYRO_BAD_MS = 10  # bad, stuck, saturated or silent: so long the last good sample stands in, then motors stop
DEADLINE_MISSES_MAX = 3  # control steps in a row that came late: the PID flies
# A crash: for so long an axis is this far from what was asked for, while the controller gives one motor so
# much more than another. The hardest of our own flights, a flip at 720 deg/s, is that far off for 50 ms.
CRASH_ERROR_DEG_S = 500.0
CRASH_SPREAD = 0.5  # of the controller's answer, before the throttle
CRASH_MS = 250
# A runaway, as of a motor or propeller in the wrong place: for so long an axis is as far off, turns away from
# what was asked for, and faster at the end. A pilot who turns round sees the rate fall within 30 ms.
RUNAWAY_WINDOW_MS = 1000  # after arming
RUNAWAY_MS = 50
HANDOVER_MS = 50  # in which a change of controller passes from the old outputs to the new
MOTOR_TEST_TIMEOUT_MS = 500  # a motor test without a fresh request ends; arming waits as long after it
MOTOR_TEST_MAGIC = 0x5453544D  # "MTST": opens it; 0 closes it
MOTOR_TEST_MAX = 0.5  # motor fraction: shows direction, order and balance at a quarter of the thrust
MOTOR_TEST_SUM_MAX = 1.0  # of all motors: the NF1 hovers at four times 0.27

# --- Motor outputs ---------------------------------------------------------------------------
DSHOT_STOP = 0
DSHOT_MIN, DSHOT_MAX = 48, 2047  # 1..47 are commands, never sent by the control path
DSHOT_SPAN = DSHOT_MAX - DSHOT_MIN  # value = 48 + (uint16)(1999 u + 0.5)
DSHOT_ALL_MOTORS = 255  # where a command may name one


class DshotCommand(IntEnum):
    """Commands to a motor's controller; all others are refused."""

    STOP = 0  # ends what is under way
    BEACON_1 = 1
    BEACON_2 = 2
    BEACON_3 = 3
    BEACON_4 = 4
    BEACON_5 = 5
    DIRECTION_1 = 7  # as the motor is wired
    DIRECTION_2 = 8
    SAVE = 12  # what direction was told last
    DIRECTION_NORMAL = 20  # as the controller is set up
    DIRECTION_REVERSED = 21


# u' = idle + (1 - idle) u: the fraction that an armed motor turns at without thrust. A policy is trained with
# its own, which it brings along.
IDLE_DEFAULT = 0.0  # of policies that do not tell
IDLE_MAX = 0.5

# --- Simulator link (Betaflight's wire format, little-endian, loopback) ----------------------
SIM_STATE_PORT, SIM_RECEIVER_PORT = 9003, 9004
SIM_MOTOR_PORT, SIM_SERVO_PORT = 9002, 9001
SIM_POWER_PORT = 9005
SIM_STATE_FORMAT = "<18d"  # time s, rates rad/s FRD, specific force, attitude wxyz, velocity, position, Pa
SIM_RECEIVER_FORMAT = "<d16H"  # time s, 16 channels in microseconds
SIM_MOTOR_FORMAT = "<4f"  # fractions, motor 1..4
SIM_SERVO_FORMAT = "<H2x16f"  # count, pulse widths in microseconds
SIM_POWER_FORMAT = "<Id3f"  # magic, time s, volts, amps, control-time override in microseconds
SIM_POWER_MAGIC = 0x3150464E  # "NFP1"
# What the controller used at a control step, sent on request (--trace-port) before the motor packet:
# magic, control step, setpoint rad/s, gyro rad/s, throttle, motor count, flags, DShot values.
SIM_TRACE_FORMAT = "<II3f3ffBB2x8H"
SIM_TRACE_MAGIC = 0x3154464E  # "NFT1"
SIM_TRACE_FLAG_ARMED = 0x01
MSP_TCP_PORT = 5761


# --- Observation blocks ----------------------------------------------------------------------
class Width(IntEnum):
    """How wide a block is: a fixed count, or one value a motor."""

    SCALAR = 1
    AXES = 3
    MOTORS = 0


@dataclass(frozen=True)
class ObservationBlock:
    """A named piece of what a control step knows."""

    name: str
    code: int
    width: Width
    unit: str
    meaning: str
    in_firmware: bool = True  # the firmware has a source for it

    def count(self, motors: int) -> int:
        """Number of float32 values of this block on an aircraft with `motors` motors."""
        return motors if self.width is Width.MOTORS else int(self.width)


OBSERVATION_BLOCKS = (
    ObservationBlock("rate", 1, Width.AXES, "rad/s", "gyro, body axes"),
    ObservationBlock("rate_error", 2, Width.AXES, "rad/s", "setpoint - gyro"),
    ObservationBlock("rate_error_delta", 3, Width.AXES, "rad/s", "rate_error - that of the step before"),
    ObservationBlock("rate_error_integral", 4, Width.AXES, "rad", "sum of rate_error dt, clamped"),
    ObservationBlock("previous_action", 5, Width.MOTORS, "1", "the policy's last output"),
    ObservationBlock("throttle", 6, Width.SCALAR, "1", "the pilot's thrust, 0..1"),
    ObservationBlock("rotor_speed", 7, Width.MOTORS, "rad/s", "of each motor", in_firmware=False),
    ObservationBlock("gravity", 8, Width.AXES, "1", "where down is, body axes", in_firmware=False),
)
RATE_ERROR_INTEGRAL_LIMIT_RAD = 0.6
OBSERVATION_COUNT_MAX = 64
OBSERVATION_TERMS_MAX = 32
OBSERVATION_AGE_MAX = 16  # control steps
OBSERVATION_MEMORY_MAX = 256  # floats that all terms together remember: 1 KiB of DTCM
POLICY_WEIGHT_COUNT_MAX = 12288  # 48 KiB of DTCM
POLICY_MEMORY_COUNT_MAX = 640  # floats of scratch and recurrent state together: 2.5 KiB of DTCM


@dataclass(frozen=True)
class ObservationTerm:
    """A block as a policy observes it: perhaps low-passed, then perhaps some steps old.

    Low-pass of cutoff f at the control rate r: y += a (x - y), a = float32(1 - exp(-2 pi f / r)), all in
    float32; the first step after a reset gives y = x. Age k: what this was k steps ago, 0 from before the
    reset.
    """

    block: ObservationBlock
    cutoff_hz: float | None = None
    age: int = 0  # control steps

    @property
    def name(self) -> str:
        """The block's."""
        return self.block.name

    @property
    def unit(self) -> str:
        """The block's."""
        return self.block.unit

    @property
    def text(self) -> str:
        """As a policy writes it: NAME[~fHz][@k]."""
        cutoff = "" if self.cutoff_hz is None else f"~{self.cutoff_hz!r}".removesuffix(".0") + "Hz"
        return f"{self.name}{cutoff}" + (f"@{self.age}" if self.age else "")

    def count(self, motors: int) -> int:
        """Number of float32 values on an aircraft with `motors` motors."""
        return self.block.count(motors)

    def memory(self, motors: int) -> int:
        """Number of float32 values that outlive a step: the low-pass's, and those that wait to be old."""
        return self.count(motors) * (self.age + (self.cutoff_hz is not None))

    def gain(self, control_rate_hz: int) -> float:
        """The low-pass's a, above 0 and below 1, exactly a float32; 0 for a term without one."""
        if self.cutoff_hz is None:
            return 0.0
        (gain,) = struct.unpack(
            "<f", struct.pack("<f", -math.expm1(-math.tau * self.cutoff_hz / control_rate_hz))
        )
        return float(gain)


_TERM = re.compile(
    r"(?P<name>[a-z_]+)(?:~(?P<cutoff>[0-9]{1,4}(?:\.[0-9]{1,3})?)Hz)?(?:@(?P<age>[0-9]{1,3}))?"
)


def observation_blocks(text: str) -> tuple[ObservationTerm, ...]:
    """Terms in the comma-separated `text`, in order. Raises ValueError, one line, on one that is none."""
    return tuple(_observation_term(term) for term in text.split(","))


def _observation_term(text: str) -> ObservationTerm:
    known = {block.name: block for block in OBSERVATION_BLOCKS}
    found = _TERM.fullmatch(text)
    name = found["name"] if found else re.split("[~@]", text)[0]
    if name not in known:
        raise ValueError(f"unknown observation block {name!r}, known are {', '.join(known)}")
    if not found:
        raise ValueError(
            f"observation {text!r}, expected NAME, NAME~fHz, NAME@k or NAME~fHz@k, e.g. rate~15Hz@1"
        )
    cutoff, age = found["cutoff"], found["age"]
    if cutoff is not None and float(cutoff) == 0.0:
        raise ValueError(f"observation {text!r}: a low-pass at 0 Hz, expected more")
    if age is not None and not 1 <= int(age) <= OBSERVATION_AGE_MAX:
        raise ValueError(f"observation {text!r}: {int(age)} steps old, expected 1 to {OBSERVATION_AGE_MAX}")
    return ObservationTerm(known[name], None if cutoff is None else float(cutoff), int(age or 0))


def observation_count(terms: tuple[ObservationTerm, ...], motors: int) -> int:
    """Width of the policy's input."""
    return sum(term.count(motors) for term in terms)


def observation_memory(terms: tuple[ObservationTerm, ...], motors: int) -> int:
    """Floats that an observation of these terms remembers from step to step."""
    return sum(term.memory(motors) for term in terms)


def check_cutoffs(terms: tuple[ObservationTerm, ...], control_rate_hz: int) -> None:
    """Raises ValueError, one line, on a low-pass that is none at this control rate."""
    for term in terms:
        if term.cutoff_hz is not None and not term.cutoff_hz < control_rate_hz / 2:
            raise ValueError(
                f"observation {term.text!r}: a low-pass at {term.cutoff_hz:g} Hz, expected below "
                f"{control_rate_hz / 2:g} Hz, half the control rate"
            )


def check_observation(terms: tuple[ObservationTerm, ...], motors: int) -> None:
    """Raises ValueError, one line, naming the first figure that is more than an observation may have."""
    for count, most, what in (
        (len(terms), OBSERVATION_TERMS_MAX, "has {} terms"),
        (observation_count(terms, motors), OBSERVATION_COUNT_MAX, "has {} values"),
        (observation_memory(terms, motors), OBSERVATION_MEMORY_MAX, "remembers {} values"),
    ):
        if count > most:
            raise ValueError(f"the observation {what.format(count)}, expected at most {most}; leave some out")


# --- Policy model (metadata_props of policy.onnx) --------------------------------------------
POLICY_FORMAT_VERSION = "1"
POLICY_INPUT, POLICY_OUTPUT = "observation", "action"
META_VERSION = "neuroflight.version"
META_OBSERVATION = "neuroflight.observation"
META_CONTROL_RATE = "neuroflight.control_rate_hz"
META_FILTERS = "neuroflight.filters"
META_IDLE = "neuroflight.idle"  # absent: IDLE_DEFAULT
META_AIRCRAFT = "neuroflight.aircraft"
META_AIRCRAFT_SHA256 = "neuroflight.aircraft_sha256"
META_TRAINING = "neuroflight.training"
POLICY_FILE_BYTES_MAX = 4 << 20
SELFTEST_COUNT = 16

# --- Policy blob: the bytes compiled in and put in a policy slot (docs/policy-blob.md) ---------
# header | float32 weights | float32 self-test observations | float32 self-test actions | CRC-32, each part
# behind the one before without a gap, all little-endian.
POLICY_BLOB_MAGIC = 0x4250464E  # "NFPB"
POLICY_BLOB_LAYOUT = 2
POLICY_BLOB_AIRCRAFT_BYTES = 32
POLICY_BLOB_CRC_BYTES = 4
POLICY_FILTERS_NONE = 0x0D4CBB29  # CRC-32 of "[]": no gyro filter
SHA256_BYTES = 32


@dataclass(frozen=True)
class HeaderField:
    """One field of the blob's header; an array where `count` is above 1."""

    c_type: str
    name: str
    unit: str
    meaning: str
    count: int = 1

    @property
    def format(self) -> str:
        """The field for `struct`; an array counts as its bytes."""
        code = {"char": "B", "uint8_t": "B", "uint16_t": "H", "uint32_t": "I", "float": "f"}[self.c_type]
        return f"{self.count * struct.calcsize(code)}s" if self.count > 1 else code


POLICY_BLOB_FIELDS = (
    HeaderField("uint32_t", "magic", "", "NFPB, in that order in memory"),
    HeaderField("uint16_t", "layout", "", "version of this layout"),
    HeaderField("uint16_t", "header_bytes", "bytes", "where the weights begin, a multiple of 8"),
    HeaderField("uint32_t", "total_bytes", "bytes", "of the whole blob, CRC included"),
    HeaderField("uint32_t", "sequence", "", "0: compiled in; of valid slots the highest is flown"),
    HeaderField("uint32_t", "architecture_hash", "", "same: weights may be exchanged"),
    HeaderField("uint32_t", "filters_hash", "", "CRC-32 of the gyro filters' JSON list"),
    HeaderField("uint32_t", "control_rate_hz", "Hz", "of policy_step, at least 1"),
    HeaderField("uint16_t", "observation_count", "floats", "of an observation, at least 1"),
    HeaderField("uint16_t", "action_count", "floats", "of an action: the motors, at least 1"),
    HeaderField("uint32_t", "weight_offset", "bytes", "of the weights from the blob's begin"),
    HeaderField("uint32_t", "weight_count", "floats", "of the table, tables of functions included"),
    HeaderField("uint32_t", "selftest_offset", "bytes", "of the observations; the actions follow them"),
    HeaderField("uint16_t", "selftest_count", "rows", "of observations and of actions, at least 1"),
    HeaderField("uint16_t", "selftest_steps", "rows", "from one policy_init to the next; divides the count"),
    HeaderField("uint32_t", "observation_term_count", "", "used entries of the next three, at least 1"),
    HeaderField("uint8_t", "observation_blocks", "", "codes in order, then 0", OBSERVATION_TERMS_MAX),
    HeaderField("uint8_t", "observation_ages", "steps", "of each term, then 0", OBSERVATION_TERMS_MAX),
    HeaderField("float", "observation_gains", "", "of each low-pass, 0: none", OBSERVATION_TERMS_MAX),
    HeaderField("char", "aircraft", "", "ASCII, then 0; a name may fill it", POLICY_BLOB_AIRCRAFT_BYTES),
    HeaderField("uint8_t", "aircraft_sha256", "", "of the aircraft trained for", SHA256_BYTES),
    HeaderField("uint8_t", "policy_sha256", "", "of the ONNX file", SHA256_BYTES),
    HeaderField("float", "idle", "", "motor fraction at zero thrust, 0 to 0.5"),
)
POLICY_BLOB_HEADER_FORMAT = "<" + "".join(field.format for field in POLICY_BLOB_FIELDS)

# --- Checkpoint (torch.save of plain containers and tensors, loaded with weights_only) --------
CHECKPOINT_FORMAT = "neuroflight.checkpoint"
CHECKPOINT_VERSION = 1
CHECKPOINT_FILE_BYTES_MAX = 64 << 20


# --- MSP -------------------------------------------------------------------------------------
class Msp(IntEnum):
    """Commands of the MultiWii Serial Protocol that this firmware answers; numbers are the ecosystem's."""

    API_VERSION = 1
    FC_VARIANT = 2
    FC_VERSION = 3
    BOARD_INFO = 4
    BUILD_INFO = 5
    NAME = 10
    STATUS = 101
    RAW_IMU = 102
    MOTOR = 104
    RC = 105
    ATTITUDE = 108
    ANALOG = 110
    BATTERY_STATE = 130
    STATUS_EX = 150
    UID = 160
    SET_RAW_RC = 200  # sticks, where the receiver is MSP
    SET_MOTOR = 214  # motor test, once MOTOR_TEST has opened it
    EEPROM_WRITE = 250  # settings to flash
    POLICY_INFO = 0x4E01  # v2, ours: what the compiled-in policy is
    TASKS = 0x4E02  # v2, ours: rate, worst, best, mean and misses of each task
    FAULTS = 0x4E03  # v2, ours: the record of the last fault; with a payload: it is acknowledged
    SAFETY = 0x4E04  # v2, ours: flight state, causes of the last stop and of the last change to the PID
    SETTING_INFO = 0x4E10  # v2, ours: name, unit, range, default of one setting, by index
    SETTING_GET = 0x4E11  # v2, ours: value of one setting, by index
    SETTING_SET = 0x4E12  # v2, ours: one setting, by index; flown from the next boot on
    MOTOR_TEST = 0x4E20  # v2, ours: opens or closes the motor test
    DSHOT_COMMAND = 0x4E21  # v2, ours: beep, direction; disarmed only
    POLICY_SLOT_BEGIN = 0x4E30  # v2, ours: erases the slot that is not flown
    POLICY_SLOT_WRITE = 0x4E31  # v2, ours: offset and bytes
    POLICY_SLOT_END = 0x4E32  # v2, ours: checks the blob; flown from the next boot on
    REBOOT = 68


MSP_PROTOCOL_VERSION = 0
MSP_API_MAJOR, MSP_API_MINOR = 1, 46
MSP_VARIANT = "NRFL"
MSP_PAYLOAD_MAX = 512
MSP_BAUDS = (9600, 19200, 38400, 57600, 115200, 230400, 460800, 921600)  # of the line, 8N1
MSP_BAUD_DEFAULT = 115200  # the ecosystem's
MSP_MODE_ARMED = 0x01  # bit of the flight modes in STATUS and STATUS_EX
VERSION = (0, 1, 0)
CRC8_DVB_S2_POLY = 0xD5


# --- Safety ----------------------------------------------------------------------------------
class FlightState(IntEnum):
    """What the firmware is doing; firmware/src/safety/safety.c has the transitions."""

    BOOT = 0
    CALIBRATING = 1
    DISARMED = 2
    ARMED = 3
    FAILSAFE_HOLD = 4  # armed, the receiver silent: rates centred, throttle kept
    FAILSAFE_DROP = 5  # the configured stage: motors stopped, or a descent that ends so
    CRASHED = 6  # motors stopped until the switch has been off
    FAULT = 7  # motors stopped until the next boot


class ArmingReason(IntEnum):
    """Bit number of each reason that keeps the motors stopped."""

    BOOT_GRACE = 0
    GYRO_NOT_CALIBRATED = 1
    RECEIVER_LOST = 2
    THROTTLE_HIGH = 3
    SWITCH_NOT_CYCLED = 4
    POLICY_BAD = 5  # and the switch chooses the policy
    GYRO_BAD = 6  # stuck, saturated, silent or no number
    NOT_LEVEL = 7  # tilted beyond the limit, or the attitude is not known
    BATTERY_UNKNOWN = 8
    FAULT = 9  # a fault record that nobody acknowledged
    CRASHED = 10
    MOTOR_TEST = 11
    STORING = 12  # flash is being erased or written, or the board is about to start anew
    PID_MISSING = 13  # the switch chooses a PID that is not built in


class StopCause(IntEnum):
    """Why the motors stopped last."""

    NONE = 0
    SWITCH = 1
    RECEIVER = 2
    GYRO_INVALID = 3
    GYRO_STUCK = 4
    GYRO_SATURATED = 5
    GYRO_SILENT = 6
    CRASH = 7
    RUNAWAY = 8
    NO_CONTROLLER = 9  # the policy was refused in flight and no PID is built in


class FallbackCause(IntEnum):
    """Why the PID flies instead of the policy."""

    NONE = 0
    SWITCH = 1  # the pilot's
    POLICY_OUTPUT = 2  # NaN or out of range
    DEADLINE = 3


class Task(IntEnum):
    """What the processor is measured at."""

    GYRO = 0  # a gyro sample that is no control step
    CONTROL = 1  # one that is, from the interrupt to the motors' frame
    BATTERY = 2
    ALERT = 3
    STORAGE = 4
    MSP = 5


class Refusal(IntEnum):
    """Why a request that would change something is refused."""

    NONE = 0
    ARMED = 1  # or under test; only with the motors stopped
    PAYLOAD = 2  # of a length or with a value that the command does not take
    INDEX = 3  # there is none of that number
    RANGE = 4  # beyond a setting's limits, or no number
    CONFLICT = 5  # settings that do not go together
    FLASH = 6  # did not take what was written
    ORDER = 7  # not what comes next: a policy slot is begun, written from its beginning, ended
    BLOB = 8  # the policy is not one for this image
    SEQUENCE = 9  # of the policy is not above those before
    ABSENT = 10  # this build has no such thing


class GyroHealth(IntEnum):
    """What is wrong with the gyro's samples."""

    GOOD = 0
    INVALID = 1  # the transfer failed or the value is no rate
    STUCK = 2
    SATURATED = 3
    SILENT = 4


# --- Settings --------------------------------------------------------------------------------
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
_MSP_BAUD_MEANING = f"{', '.join(str(baud) for baud in MSP_BAUDS[:-1])} or {MSP_BAUDS[-1]}, on UART1"
SETTINGS = (
    _whole("gyro_rate_hz", 1000, GYRO_EDGE_RATE_HZ, GYRO_RATE_DEFAULT_HZ, "Hz", "1000, 2000, 4000 or 8000"),
    _choice("gyro_alignment", "board", ("board", "cw0", "cw90", "cw180", "cw270"), "how the chip is turned"),
    _whole("gyro_stuck_ms", 0, 1000, GYRO_BAD_MS, "ms", "the same sample for longer is a fault; 0: never"),
    *(
        setting
        for stage in range(1, FILTER_STAGES + 1)
        for setting in (
            _choice(f"filter{stage}_kind", "none", _FILTERS, "of the gyro's filter chain, in order"),
            _number(f"filter{stage}_hz", 1.0, 4000.0, 100.0, "Hz", "cutoff, or centre of the notch"),
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
        )
    ),
    _choice("rates_style", "actual", ("actual", "betaflight"), "what the nine numbers below mean"),
    *(
        setting
        for axis in AXES
        for setting in (
            _number(
                f"{axis}_rate",
                0.01,
                1000.0,
                1000.0,
                "deg/s",
                "actual: slope at the centre; betaflight: RC rate",
            ),
            _number(
                f"{axis}_max", 0.0, 1998.0, 1000.0, "deg/s", "actual: at full stick; betaflight: super rate"
            ),
            _number(f"{axis}_expo", 0.0, 1.0, 0.0, "1", "0: none"),
        )
    ),
    _whole("deadband_us", 0, 100, 0, "us", "of roll and pitch"),
    _whole("yaw_deadband_us", 0, 100, 0, "us", "of yaw"),
    _choice("interpolation", "off", _SWITCH, "a ramp between two receiver frames"),
    _choice("failsafe_stage", "drop", ("drop", "descend"), "after the hold"),
    _number("failsafe_throttle", 0.0, 1.0, 0.2, "1", "while descending"),
    _whole("failsafe_descend_ms", 0, 60_000, 3000, "ms", "then the motors stop"),
    _number("level_limit_deg", 0.0, 180.0, 25.0, "deg", "tilt that arming allows; 0: any, known or not"),
    _number("motor_limit", 0.1, 1.0, 1.0, "1", "largest motor fraction"),
    _choice("motor_stop", "off", _SWITCH, "armed with the throttle low, motors stand still"),
    _choice("motor_protocol", "dshot600", ("dshot300", "dshot600"), "to the ESCs"),
    _whole("battery_cells", 0, 6, 0, "cells", "0: found from the voltage at boot"),
    _number("battery_scale", 1.0, 100.0, 11.0, "1", "volts at the pack for one at the pin"),
    _number("current_scale", 1.0, 1000.0, 17.9, "mV/A", "of the sensor"),
    _number("battery_warn_v", 2.5, 4.4, 3.5, "V", "a cell: warning"),
    _number("battery_low_v", 2.5, 4.4, 3.3, "V", "a cell: land now"),
    _choice("crash_detection", "on", _SWITCH, "motors stop when the aircraft does what no pilot asked for"),
    _choice("runaway_detection", "on", _SWITCH, "the same right after arming"),
)


# --- MATEKF722: memory and flash map ----------------------------------------------------------
@dataclass(frozen=True)
class Region:
    """A span of the address space: [address, address + size)."""

    name: str
    address: int
    size: int


FLASH_BASE = 0x08000000
FLASH_BYTES = 512 * 1024
FLASH_SECTORS = (
    *(Region(f"sector {i}", FLASH_BASE + i * 0x4000, 0x4000) for i in range(4)),
    Region("sector 4", FLASH_BASE + 0x10000, 0x10000),
    *(Region(f"sector {i}", FLASH_BASE + (i - 4) * 0x20000, 0x20000) for i in range(5, 8)),
)
FLASH_BOOT = FLASH_SECTORS[0]
FLASH_SETTINGS = (FLASH_SECTORS[1], FLASH_SECTORS[2])
FLASH_FAULT_RECORD = FLASH_SECTORS[3]
FLASH_POLICY_SLOTS = (FLASH_SECTORS[4], Region("policy slot B", FLASH_SECTORS[7].address, 0x10000))
FLASH_BANK_A, FLASH_BANK_B = FLASH_SECTORS[5], FLASH_SECTORS[6]
ITCM = Region("ITCM", 0x00000000, 16 * 1024)
DTCM = Region("DTCM", 0x20000000, 64 * 1024)
SRAM1 = Region("SRAM1", 0x20010000, 176 * 1024)
SRAM2 = Region("SRAM2", 0x2003C000, 16 * 1024)
