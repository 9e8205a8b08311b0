"""What the replies say: payload bytes in, frozen dataclasses out.

Layouts are those of Betaflight's MSP at API 1.46, little-endian; POLICY_INFO is this project's own.
MSP grows at a payload's end, so bytes after the known ones are ignored and missing ones refused.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from toolchain.contract import MSP_MODE_ARMED, ArmingReason, Msp
from toolchain.errors import LinkError


@dataclass(frozen=True)
class ApiVersion:
    """Which MSP is spoken."""

    protocol: int
    major: int
    minor: int


@dataclass(frozen=True)
class BoardInfo:
    """Which board it is; texts are empty where the firmware gives none."""

    identifier: str  # 4 characters
    hardware_revision: int
    target: str
    name: str
    manufacturer: str


@dataclass(frozen=True)
class BuildInfo:
    """When and from which revision the firmware was built. This project's builds are reproducible and
    know neither: their date is the start of 1970 and their revision zeros."""

    date: str  # Mmm dd yyyy
    time: str  # hh:mm:ss
    revision: str  # first 7 digits of the commit

    @property
    def dated(self) -> bool:
        """Whether the firmware knows its build."""
        return self.revision.strip("0") != ""


@dataclass(frozen=True)
class Status:
    """How the firmware is doing, as STATUS tells it."""

    cycle_time_us: int  # control period
    i2c_errors: int
    sensors: int  # bit field of the sensors found
    modes: int  # bit field of the active flight modes
    profile: int
    load_percent: int

    @property
    def armed(self) -> bool:
        """Whether the motors may turn."""
        return bool(self.modes & MSP_MODE_ARMED)


@dataclass(frozen=True)
class StatusEx:
    """STATUS and what forbids arming."""

    status: Status
    arming_flag_count: int  # how many of the bits below have a meaning
    arming_flags: int  # bit field, see `arming_reasons`


@dataclass(frozen=True)
class RawImu:
    """Sensors as whole numbers, each (x, y, z); zeros for a sensor that is not there."""

    acceleration: tuple[int, int, int]  # counts, the scale depends on the board
    gyro: tuple[int, int, int]  # deg/s
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


@dataclass(frozen=True)
class PolicyInfo:
    """The policy that is compiled into the firmware, and the rates it runs at."""

    name: str  # the aircraft it was trained on
    sha256: str  # of policy.onnx, 64 hexadecimal digits
    architecture_hash: int
    observation_count: int
    action_count: int
    weight_count: int
    control_rate_hz: int
    gyro_rate_hz: int
    good: bool  # its self-test passed and no output was refused since; False keeps the motors stopped


class _Reader:
    """Takes fields off the front of a payload; a payload that ends too early is a LinkError."""

    def __init__(self, command: Msp, payload: bytes) -> None:
        self.command = command
        self.payload = payload
        self.at = 0

    def bytes(self, count: int) -> bytes:
        """The next `count` bytes."""
        end = self.at + count
        if end > len(self.payload):
            raise LinkError(
                f"MSP {self.command.name} reply has {len(self.payload)} bytes, expected at least {end}; "
                "the firmware speaks another layout: bring it and this tool to the same version"
            )
        field = self.payload[self.at : end]
        self.at = end
        return field

    def fields(self, layout: str) -> tuple[Any, ...]:
        """The next fields, of the struct format `layout` without its byte order."""
        form = struct.Struct("<" + layout)
        return form.unpack(self.bytes(form.size))

    def text(self, count: int) -> str:
        """The next `count` bytes as text; whatever is not printable ASCII shows as `?`."""
        characters = self.bytes(count).rstrip(b"\0").decode("latin-1")
        return "".join(c if " " <= c <= "~" else "?" for c in characters)

    def counted_text(self) -> str:
        """A text behind a byte that gives its length."""
        (count,) = self.fields("B")
        return self.text(count)

    def shorts(self) -> tuple[int, ...]:
        """All the rest as u16."""
        rest = len(self.payload) - self.at
        return self.fields(f"{(rest + 1) // 2}H")  # an odd byte lacks its other half: refused


def api_version(payload: bytes) -> ApiVersion:
    """Decode API_VERSION."""
    return ApiVersion(*_Reader(Msp.API_VERSION, payload).fields("3B"))


def fc_variant(payload: bytes) -> str:
    """Decode FC_VARIANT: four characters, this project's are contract.MSP_VARIANT."""
    return _Reader(Msp.FC_VARIANT, payload).text(4)


def fc_version(payload: bytes) -> str:
    """Decode FC_VERSION, as `major.minor.patch`."""
    return ".".join(str(part) for part in _Reader(Msp.FC_VERSION, payload).fields("3B"))


def board_info(payload: bytes) -> BoardInfo:
    """Decode BOARD_INFO up to the manufacturer; signature, MCU and bus counts are passed over."""
    reader = _Reader(Msp.BOARD_INFO, payload)
    identifier = reader.text(4)
    hardware_revision, _board_type, _capabilities = reader.fields("HBB")
    target, name, manufacturer = (reader.counted_text() for _ in range(3))
    return BoardInfo(identifier, hardware_revision, target, name, manufacturer)


def build_info(payload: bytes) -> BuildInfo:
    """Decode BUILD_INFO."""
    reader = _Reader(Msp.BUILD_INFO, payload)
    return BuildInfo(date=reader.text(11), time=reader.text(8), revision=reader.text(7))


def name(payload: bytes) -> str:
    """Decode NAME, the name that the pilot gave the aircraft; may be empty."""
    return _Reader(Msp.NAME, payload).text(len(payload))


def status(payload: bytes) -> Status:
    """Decode STATUS."""
    return Status(*_Reader(Msp.STATUS, payload).fields("HHHIBH"))


def status_ex(payload: bytes) -> StatusEx:
    """Decode STATUS_EX."""
    reader = _Reader(Msp.STATUS_EX, payload)
    status = Status(*reader.fields("HHHIBH"))
    _profiles, _rate_profile, further_mode_bytes = reader.fields("BBB")
    reader.bytes(further_mode_bytes & 0x0F)  # flight modes 32 and up
    count, flags = reader.fields("BI")
    return StatusEx(status, count, flags)


def arming_reasons(flags: int) -> tuple[str, ...]:
    """Names of the reasons set in this project's STATUS_EX `flags`, lowest bit first."""
    known = {f"BIT_{int(reason)}": reason.name for reason in ArmingReason}
    return tuple(known.get(bit, bit) for bit in bit_names(flags))


def bit_names(flags: int) -> tuple[str, ...]:
    """`BIT_n` of each bit set in `flags` >= 0, lowest first: for flags of another make of firmware."""
    return tuple(f"BIT_{bit}" for bit in range(flags.bit_length()) if flags >> bit & 1)


def uid(payload: bytes) -> str:
    """Decode UID: the chip's 96-bit number as 24 hexadecimal digits, in the ecosystem's word order."""
    return "".join(f"{word:08x}" for word in _Reader(Msp.UID, payload).fields("3I"))


def rc(payload: bytes) -> tuple[int, ...]:
    """Decode RC: channels in microseconds, in the order roll, pitch, yaw, throttle, aux 1.."""
    return _Reader(Msp.RC, payload).shorts()


def motor(payload: bytes) -> tuple[int, ...]:
    """Decode MOTOR: outputs in 1000..2000, motor order; 0 for a motor that is not there."""
    return _Reader(Msp.MOTOR, payload).shorts()


def raw_imu(payload: bytes) -> RawImu:
    """Decode RAW_IMU."""
    counts = _Reader(Msp.RAW_IMU, payload).fields("9h")
    return RawImu(acceleration=counts[0:3], gyro=counts[3:6], magnetometer=counts[6:9])


def attitude(payload: bytes) -> Attitude:
    """Decode ATTITUDE."""
    roll_decidegrees, pitch_decidegrees, heading = _Reader(Msp.ATTITUDE, payload).fields("3h")
    return Attitude(roll_decidegrees / 10, pitch_decidegrees / 10, float(heading))


def analog(payload: bytes) -> Analog:
    """Decode ANALOG; of its two voltages the finer one."""
    _decivolts, drawn_mah, rssi, centiamps, centivolts = _Reader(Msp.ANALOG, payload).fields("BHHhH")
    return Analog(centivolts / 100, drawn_mah, rssi, centiamps / 100)


def policy_info(payload: bytes) -> PolicyInfo:
    """Decode POLICY_INFO."""
    reader = _Reader(Msp.POLICY_INFO, payload)
    architecture_hash, observations, actions, weights = reader.fields("IHHI")
    control_rate_hz, gyro_rate_hz, good = reader.fields("HHB")
    return PolicyInfo(
        name=reader.counted_text(),
        sha256=reader.bytes(32).hex(),
        architecture_hash=architecture_hash,
        observation_count=observations,
        action_count=actions,
        weight_count=weights,
        control_rate_hz=control_rate_hz,
        gyro_rate_hz=gyro_rate_hz,
        good=bool(good),
    )


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
    Msp.RAW_IMU: raw_imu,
    Msp.ATTITUDE: attitude,
    Msp.ANALOG: analog,
    Msp.POLICY_INFO: policy_info,
}
