"""Encodes the payloads of requests, and words the reasons why a firmware refuses one.

A value that the command cannot take is a ValueError, before anything is sent; limits of settings are the
firmware's business. Layouts beyond SET_RAW_RC, SET_MOTOR and REBOOT are this project's own.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

from neuroflight.flash.link.payload import Reader
from neuroflight.flash.link.policy_errors import policy_error
from neuroflight.toolchain.contract import (
    CHANNEL_COUNT,
    CHANNEL_MAX_US,
    CHANNEL_MIN_US,
    MOTOR_COUNT_MAX,
    MSP_PAYLOAD_MAX,
    SETTING_TEXT_BYTES,
    SETTINGS,
    Msp,
    Refusal,
    SettingKind,
)
from neuroflight.toolchain.contract.msp_messages import storing
from neuroflight.toolchain.errors import LinkError

ALL_MOTORS = 0xFF  # as the motor of DSHOT_COMMAND
SLOT_HEADER_BYTES = 4  # before the blob's bytes in POLICY_SLOT_WRITE
SLOT_BYTES_MAX = MSP_PAYLOAD_MAX - SLOT_HEADER_BYTES
WORD_BYTES = 4
SETTING_KINDS = tuple(kind.name for kind in SettingKind)  # by number
STORING = frozenset(filter(storing, Msp))  # commands that wait for the flash
REASONS = {
    Refusal.ARMED: "the motors are armed or under test; disarm first",
    Refusal.PAYLOAD: "the request has a length or a value that the command does not take",
    Refusal.INDEX: "there is none of that number",
    Refusal.RANGE: "the value is beyond the setting's limits",
    Refusal.CONFLICT: "{setting} does not fit the policy or other settings, see docs/reference/settings.md",
    Refusal.FLASH: "flash did not take it; what was stored before still holds",
    Refusal.ORDER: "something has to come before it: opening, beginning, reading",
    Refusal.BLOB: "the policy is none for this firmware: {policy} (error {detail})",
    Refusal.SEQUENCE: "the policy's sequence number is not newer than that of the policy which stays",
    Refusal.ABSENT: "this firmware or its settings have no such thing",
    Refusal.SPOILT: "it is stored, but not all: some of a change before it was refused",
    Refusal.IMAGE: "the image is none for this board's other bank (error {detail})",
    Refusal.LOG: "the device that keeps the logs failed (LogError {detail})",
}


@dataclass(frozen=True)
class SettingInfo:
    """The firmware's description of one of its settings."""

    count: int  # settings in all
    name: str
    unit: str
    low: float  # both limits may be taken; of a text: its length
    high: float
    default: float
    kind: str  # as of contract.Setting

    @property
    def whole(self) -> bool:
        """True if it takes only whole numbers."""
        return self.kind in ("uint32_t", "mode")


def repeatable(command: Msp, payload: bytes) -> bool:
    """Return True if a request may be repeated when no reply came, though it may have been carried out."""
    return not command.row.once and not (command.row.acknowledges and payload)


def _within(what: str, value: int, low: int, high: int) -> int:
    if not low <= value <= high:
        raise ValueError(f"{what} {value}, expected {low}..{high}")
    return value


def set_raw_rc(channels_us: Sequence[int]) -> bytes:
    """Encode SET_RAW_RC: a receiver's channels, as set by default roll, pitch, throttle, yaw, aux 1.."""
    count = _within("channel count", len(channels_us), 4, CHANNEL_COUNT)
    return struct.pack(f"<{count}H", *(_within("channel [us]", us, 0, 0xFFFF) for us in channels_us))


def set_motor(values_us: Sequence[int]) -> bytes:
    """Encode SET_MOTOR: 1000 (stopped) to 2000 each, in motor order."""
    count = _within("motor count", len(values_us), 1, MOTOR_COUNT_MAX)
    values = (_within("motor [us]", us, CHANNEL_MIN_US, CHANNEL_MAX_US) for us in values_us)
    return struct.pack(f"<{count}H", *values)


def motor_test(magic: int) -> bytes:
    """Encode MOTOR_TEST: the right magic opens it, another closes it."""
    return struct.pack("<I", _within("magic", magic, 0, 0xFFFFFFFF))


def dshot_command(command: int, motor: int = ALL_MOTORS) -> bytes:
    """Encode DSHOT_COMMAND for the motor of that index, or for all."""
    if motor != ALL_MOTORS:
        _within("motor", motor, 0, MOTOR_COUNT_MAX - 1)
    return struct.pack("<BB", motor, _within("DShot command", command, 0, 47))


def setting_index(index: int) -> bytes:
    """Encode SETTING_INFO and SETTING_GET."""
    return struct.pack("<H", _within("setting", index, 0, 0xFFFF))


def setting_set(index: int, value: float | str, kind: str) -> bytes:
    """Encode SETTING_SET; `kind` as SETTING_INFO tells it, a text for a text."""
    if kind == "text":
        text = str(value).encode("ascii", "replace")
        if len(text) > SETTING_TEXT_BYTES:
            raise ValueError(
                f"setting {index} got {len(text)} characters, expected {SETTING_TEXT_BYTES} at most"
            )
        return setting_index(index) + text.ljust(SETTING_TEXT_BYTES, b"\0")
    number = float(value)
    if kind == "float":
        return setting_index(index) + struct.pack("<f", number)
    if number != int(number):
        raise ValueError(f"setting {index} got {number:g}, expected a whole number")
    return setting_index(index) + struct.pack("<I", _within(f"setting {index}", int(number), 0, 0xFFFFFFFF))


def acknowledge(boot: int) -> bytes:
    """Encode FAULTS with a payload: the fault that this boot found has been read."""
    return struct.pack("<I", _within("boot", boot, 0, 0xFFFFFFFF))


def slot_begin(total: int) -> bytes:
    """Encode POLICY_SLOT_BEGIN for a blob of `total` bytes."""
    return struct.pack("<I", _within("size", total, 0, 0xFFFFFFFF))


def slot_write(offset: int, data: bytes) -> bytes:
    """Encode POLICY_SLOT_WRITE of `data`, which stands at `offset` of the blob."""
    _within("number of bytes", len(data), WORD_BYTES, SLOT_BYTES_MAX)
    if offset % WORD_BYTES or len(data) % WORD_BYTES:
        raise ValueError(f"{len(data)} bytes at {offset}, expected multiples of {WORD_BYTES}")
    return struct.pack("<I", _within("offset", offset, 0, 0xFFFFFFFF)) + data


def slot_begun(payload: bytes) -> int:
    """Decode POLICY_SLOT_BEGIN: the lowest sequence number that the blob may have."""
    (sequence,) = Reader(Msp.POLICY_SLOT_BEGIN, payload).fields("I")
    return int(sequence)


def _kind(number: int) -> str:
    if not number < len(SETTING_KINDS):
        raise LinkError(
            f"the firmware has a setting of kind {number}, expected 0..{len(SETTING_KINDS) - 1}; "
            "the firmware is newer: bring it and this tool to the same version"
        )
    return SETTING_KINDS[number]


def setting_info(payload: bytes) -> SettingInfo:
    """Decode SETTING_INFO. Raises LinkError for a kind that this tool does not know."""
    reader = Reader(Msp.SETTING_INFO, payload)
    count, number = reader.fields("HB")
    kind = _kind(number)
    low, high, default = reader.fields("3f" if kind == "float" else "3I")
    name, unit = reader.counted_text(), reader.counted_text()
    return SettingInfo(count, name, unit, low, high, default, kind)


def setting_value(payload: bytes) -> float | str:
    """Decode SETTING_GET; a float's value is exactly the firmware's float32."""
    reader = Reader(Msp.SETTING_GET, payload)
    (number,) = reader.fields("B")
    kind = _kind(number)
    if kind == "text":
        return reader.text(SETTING_TEXT_BYTES)
    (value,) = reader.fields("f" if kind == "float" else "I")
    return float(value) if kind == "float" else int(value)


def refusal(payload: bytes) -> str:
    """Return the text of a refused request's payload; empty if it gives no reason."""
    if len(payload) != struct.calcsize("<Bh"):
        return ""
    reason, detail = struct.unpack("<Bh", payload)
    known = {int(reason): text for reason, text in REASONS.items()}
    setting = SETTINGS[detail].name if 0 <= detail < len(SETTINGS) else f"setting {detail}"
    text = known.get(reason, f"reason {reason}, which this tool does not know")
    return text.format(detail=detail, setting=setting, policy=policy_error(detail))


def refusal_reason(payload: bytes) -> Refusal | None:
    """Return the reason in a refused request's payload; None if this tool knows none such."""
    if len(payload) != struct.calcsize("<Bh") or payload[0] not in set(Refusal):
        return None
    return Refusal(payload[0])
