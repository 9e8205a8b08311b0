"""Decodes the replies: payload bytes in, frozen dataclasses out.

Layouts are those of Betaflight's MSP at API 1.47, little-endian; POLICY_INFO and those of records.py are
this project's own. MSP grows at a payload's end, so bytes after the known ones are ignored and missing
ones refused.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum

from neuroflight.flash.link import records, requests
from neuroflight.flash.link.layouts import read
from neuroflight.flash.link.payload import Reader, one_of
from neuroflight.toolchain.contract import MSP_MODE_ARMED, MSP_POLICY_NONE, ArmingReason, Mix, Msp

FIRST_YEAR = 10  # of FC_VERSION: from 10 on its first number counts years, as Betaflight's app reads it
# Minor of the API from which this project's RAW_IMU has MSP_GYRO_COUNTS and MSP_ACCELERATION_COUNTS; before
# that it had whole deg/s and 512 counts for 1 g.
RAW_IMU_COUNTS_SINCE = 47


@dataclass(frozen=True)
class ApiVersion:
    """The version of MSP that is spoken."""

    protocol: int
    major: int
    minor: int


@dataclass(frozen=True)
class BoardInfo:
    """The board's identity; texts are empty if the firmware gives none."""

    identifier: str  # 4 characters
    hardware_revision: int
    target: str
    name: str
    manufacturer: str


@dataclass(frozen=True)
class BuildInfo:
    """The firmware's build date and revision. This project's builds are reproducible and have neither: their
    date is the start of 1970 and their revision zeros."""

    date: str  # Mmm dd yyyy
    time: str  # hh:mm:ss
    revision: str  # first 7 digits of the commit

    @property
    def dated(self) -> bool:
        """True if the firmware knows its build."""
        return self.revision.strip("0") != ""


@dataclass(frozen=True)
class Status:
    """The firmware's state as STATUS reports it."""

    cycle_time_us: int  # control period
    i2c_errors: int
    sensors: int  # bit field of the sensors found
    modes: int  # bit field of the active flight modes
    profile: int
    load_percent: int

    @property
    def armed(self) -> bool:
        """True if the motors may turn."""
        return bool(self.modes & MSP_MODE_ARMED)


@dataclass(frozen=True)
class StatusEx:
    """STATUS and what forbids arming."""

    status: Status
    arming_flag_count: int  # number of bits used in `arming_flags`
    arming_flags: int  # bit field, see `arming_reasons`


@dataclass(frozen=True)
class RawImu:
    """Sensors as whole numbers, each (x, y, z); zeros for a missing sensor."""

    acceleration: tuple[int, int, int]  # counts, the scale depends on the board
    gyro: tuple[int, int, int]  # counts, the scale depends on the firmware
    magnetometer: tuple[int, int, int]  # counts


@dataclass(frozen=True)
class Attitude:
    """Euler angles in degrees as the ecosystem shows them: roll right +, pitch nose down +, heading."""

    roll_deg: float
    pitch_deg: float
    heading_deg: float


@dataclass(frozen=True)
class Analog:
    """Battery and radio link."""

    voltage_v: float
    drawn_mah: int
    rssi: int  # 0..1023
    current_a: float


class BatteryLevel(IntEnum):
    """Battery levels, as the ecosystem numbers them."""

    GOOD = 0
    WARNING = 1
    CRITICAL = 2
    ABSENT = 3  # or its cells are not known
    STARTING = 4  # Betaflight alone: being checked


@dataclass(frozen=True)
class BatteryState:
    """The battery alone."""

    cells: int  # 0: not known
    level: BatteryLevel
    voltage_v: float
    drawn_mah: int
    current_a: float


class PolicySource(IntEnum):
    """Sources of the flown policy."""

    SLOT_A = 0
    SLOT_B = 1
    NONE = MSP_POLICY_NONE  # no policy is good


@dataclass(frozen=True)
class PolicyInfo:
    """The policy that the firmware flies, and the rates it runs at."""

    name: str  # the aircraft it was trained on
    sha256: str  # of policy.onnx, 64 hexadecimal digits
    architecture_hash: int
    observation_count: int
    action_count: int
    weight_count: int
    control_rate_hz: int
    gyro_rate_hz: int
    good: bool  # self-test passed and no output refused since; False keeps the motors stopped
    idle: float  # motor fraction at zero thrust
    source: PolicySource
    sequence: int  # of its blob, 0: as built
    found: tuple[int, ...]  # at boot in slot A and B: 0 good, else a FirmwareError
    mix: Mix  # of outputs and throttle


def api_version(payload: bytes) -> ApiVersion:
    """Decode API_VERSION."""
    return ApiVersion(*Reader(Msp.API_VERSION, payload).fields("3B"))


def fc_variant(payload: bytes) -> str:
    """Decode FC_VARIANT: four characters, this project's are contract.MSP_VARIANT."""
    return Reader(Msp.FC_VARIANT, payload).text(4)


def fc_version(payload: bytes) -> str:
    """Decode FC_VERSION: `major.minor.patch`; if that is a year and a month, the text behind it."""
    reader = Reader(Msp.FC_VERSION, payload)
    numbers = reader.fields("3B")
    return reader.counted_text() if numbers[0] >= FIRST_YEAR else ".".join(map(str, numbers))


@dataclass(frozen=True)
class Identity:
    """The identity of a firmware of this project, whatever FC_VARIANT and FC_VERSION say."""

    firmware: str
    version: str
    target: str


def identity(payload: bytes) -> Identity:
    """Decode IDENTITY up to the target."""
    reader = Reader(Msp.IDENTITY, payload)
    firmware = reader.counted_text()
    version = ".".join(str(part) for part in reader.fields("3B"))
    reader.fields("BB")  # the API, which API_VERSION tells too
    return Identity(firmware, version, reader.counted_text())


def board_info(payload: bytes) -> BoardInfo:
    """Decode BOARD_INFO up to the manufacturer; signature, MCU and bus counts are passed over."""
    reader = Reader(Msp.BOARD_INFO, payload)
    identifier = reader.text(4)
    hardware_revision, _board_type, _capabilities = reader.fields("HBB")
    target, name, manufacturer = (reader.counted_text() for _ in range(3))
    return BoardInfo(identifier, hardware_revision, target, name, manufacturer)


def build_info(payload: bytes) -> BuildInfo:
    """Decode BUILD_INFO."""
    reader = Reader(Msp.BUILD_INFO, payload)
    return BuildInfo(date=reader.text(11), time=reader.text(8), revision=reader.text(7))


def name(payload: bytes) -> str:
    """Decode NAME, the name that the pilot gave the aircraft; may be empty."""
    return Reader(Msp.NAME, payload).text(len(payload))


def status(payload: bytes) -> Status:
    """Decode STATUS."""
    return Status(*Reader(Msp.STATUS, payload).fields("HHHIBH"))


def status_ex(payload: bytes) -> StatusEx:
    """Decode STATUS_EX."""
    reader = Reader(Msp.STATUS_EX, payload)
    status = Status(*reader.fields("HHHIBH"))
    _profiles, _rate_profile, further_mode_bytes = reader.fields("BBB")
    reader.bytes(further_mode_bytes & 0x0F)  # flight modes 32 and up
    count, flags = reader.fields("BI")
    return StatusEx(status, count, flags)


def arming_reasons(flags: int) -> tuple[str, ...]:
    """Name the reasons set in this project's STATUS_EX `flags`, lowest bit first."""
    known = {f"BIT_{int(reason)}": reason.name for reason in ArmingReason}
    return tuple(known.get(bit, bit) for bit in bit_names(flags))


def bit_names(flags: int) -> tuple[str, ...]:
    """Name each bit set in `flags` >= 0 as `BIT_n`, lowest first: for another make of firmware."""
    return tuple(f"BIT_{bit}" for bit in range(flags.bit_length()) if flags >> bit & 1)


def uid(payload: bytes) -> str:
    """Decode UID: the chip's 96-bit number as 24 hexadecimal digits, in the ecosystem's word order."""
    return "".join(f"{word:08x}" for word in Reader(Msp.UID, payload).fields("3I"))


def rc(payload: bytes) -> tuple[int, ...]:
    """Decode RC: channels in microseconds, in the order roll, pitch, yaw, throttle, aux 1.."""
    return Reader(Msp.RC, payload).shorts()


def motor(payload: bytes) -> tuple[int, ...]:
    """Decode MOTOR: outputs in 1000..2000, motor order; 0 for a motor that is not there."""
    return Reader(Msp.MOTOR, payload).shorts()


@dataclass(frozen=True)
class EscReport:
    """Answers of a motor's ESC over the motor wire; 0 what it does not tell."""

    speed_rpm: int
    errors: float  # part of its answers that were none or not valid, of the second before; 1: it is silent
    temperature_c: int
    volts: float
    amps: float


def motor_telemetry(payload: bytes) -> tuple[EscReport, ...]:
    """Decode MOTOR_TELEMETRY: by motor."""
    reader = Reader(Msp.MOTOR_TELEMETRY, payload)
    (count,) = reader.fields("B")
    rows = [reader.fields("IHBHHH") for _ in range(count)]
    return tuple(
        EscReport(rpm, errors / 10_000, temperature, centivolts / 100, centiamps / 100)
        for rpm, errors, temperature, centivolts, centiamps, _drawn in rows
    )


def raw_imu(payload: bytes) -> RawImu:
    """Decode RAW_IMU."""
    counts = Reader(Msp.RAW_IMU, payload).fields("9h")
    return RawImu(acceleration=counts[0:3], gyro=counts[3:6], magnetometer=counts[6:9])


def attitude(payload: bytes) -> Attitude:
    """Decode ATTITUDE."""
    roll_decidegrees, pitch_decidegrees, heading = Reader(Msp.ATTITUDE, payload).fields("3h")
    return Attitude(roll_decidegrees / 10, pitch_decidegrees / 10, float(heading))


def analog(payload: bytes) -> Analog:
    """Decode ANALOG; of its two voltages the finer one."""
    _decivolts, drawn_mah, rssi, centiamps, centivolts = Reader(Msp.ANALOG, payload).fields("BHHhH")
    return Analog(centivolts / 100, drawn_mah, rssi, centiamps / 100)


def policy_info(payload: bytes) -> PolicyInfo:
    """Decode POLICY_INFO."""
    told = read(Msp.POLICY_INFO, payload)
    return PolicyInfo(
        name=told["name"],
        sha256=told["sha256"].hex(),
        architecture_hash=told["architecture_hash"],
        observation_count=told["observations"],
        action_count=told["actions"],
        weight_count=told["weights"],
        control_rate_hz=told["control_rate"],
        gyro_rate_hz=told["gyro_rate"],
        good=bool(told["good"]),
        idle=told["idle"],
        source=one_of(PolicySource, told["source"], Msp.POLICY_INFO),
        sequence=told["sequence"],
        found=told["found"],
        mix=one_of(Mix, told["mix"], Msp.POLICY_INFO),
    )


def battery_state(payload: bytes) -> BatteryState:
    """Decode BATTERY_STATE; of its two voltages the finer one."""
    reader = Reader(Msp.BATTERY_STATE, payload)
    cells, _capacity, _decivolts, drawn_mah, centiamps = reader.fields("BHBHh")
    level = reader.one_of(BatteryLevel)
    (centivolts,) = reader.fields("H")
    return BatteryState(cells, level, centivolts / 100, drawn_mah, centiamps / 100)


DECODERS: dict[Msp, Callable[[bytes], object]] = {
    Msp.API_VERSION: api_version,
    Msp.FC_VARIANT: fc_variant,
    Msp.FC_VERSION: fc_version,
    Msp.BOARD_INFO: board_info,
    Msp.BUILD_INFO: build_info,
    Msp.NAME: name,
    Msp.STATUS: status,
    Msp.STATUS_EX: status_ex,
    Msp.UID: uid,
    Msp.RC: rc,
    Msp.MOTOR: motor,
    Msp.MOTOR_TELEMETRY: motor_telemetry,
    Msp.RAW_IMU: raw_imu,
    Msp.ATTITUDE: attitude,
    Msp.ANALOG: analog,
    Msp.BATTERY_STATE: battery_state,
    Msp.POLICY_INFO: policy_info,
    Msp.SAFETY: records.safety,
    Msp.TASKS: records.tasks,
    Msp.FAULTS: records.faults,
    Msp.SETTING_INFO: requests.setting_info,
    Msp.SETTING_GET: requests.setting_value,
    Msp.POLICY_SLOT_BEGIN: requests.slot_begun,
}
