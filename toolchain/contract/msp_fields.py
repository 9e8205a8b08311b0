"""Fields of MSP messages: of what a payload is made, in order, and what they mean.

Numbers are little-endian. `flash.link.layouts` packs and unpacks by them, the firmware's table of
configuration messages and docs/reference/msp.md are rendered from them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import partial

__all__ = ["Bound", "MspField", "MspGroup", "MspHow", "MspSource"]
NUMBERS = {"u8": "B", "i8": "b", "u16": "H", "i16": "h", "u32": "I", "i32": "i", "f32": "f"}  # in struct
TEXTS = ("text", "counted", "bytes")


class MspHow(IntEnum):
    """Ways in which the firmware reads a field of a configuration message, and a SET writes it."""

    CONSTANT = 0  # a fixed number; a SET must bring the same
    UNUSED = 1  # told as that number; a SET may bring any
    SCALED = 2  # a setting times a gain plus an offset
    CHOICE = 3  # a setting with names, each a number of its own
    SOURCE = 4  # what the firmware computes: MspSource


class MspSource(IntEnum):
    """Fields of configuration messages that the firmware computes, some of them with an argument."""

    FEATURES = 0
    MIXER = 1
    MOTOR_COUNT = 2
    PROCESS_DENOMINATOR = 3  # gyro samples a control step
    IDLE = 4  # of the controller that flies, 0.01 %
    SMALL_ANGLE = 5
    PROVIDER = 6  # of the serial receiver
    RATES_TYPE = 7
    RATE = 8  # argument: 3 x axis, + 0 rate, 1 max, 2 expo
    PID = 9  # argument: 3 x axis, + 0 P, 1 I, 2 D
    LOWPASS_HZ = 10  # argument: stage of the filter chain, 0 or 1
    LOWPASS_TYPE = 11
    NOTCH_HZ = 12  # argument: stage, 2 or 3
    NOTCH_CUTOFF = 13
    D_LOWPASS_HZ = 14
    TPA_RATE = 15
    TPA_BREAKPOINT = 16
    BEEPERS = 17
    DIVIDER = 18  # argument: 0 scale, 1 divider, 2 multiplier of the battery's voltage
    LOG_RATE = 19  # logarithm to base 2 of the control steps from one frame to the next
    LOG_INTRA = 20  # frames from one that stands alone to the next
    LOG_FIELDS_OFF = 21  # groups of fields that no log has; those that the ecosystem knows
    LOG_CARD = 22  # argument: 0 state, 1 error, 2 free, 3 total [KB] of the card for logs
    CURRENT = 24  # scale of the current sensor, 0.1 mV/A
    GYRO_HARDWARE = 23  # the ecosystem's number of the gyro chip; 0: it has none


@dataclass(frozen=True)
class Bound:
    """The origin of a field of a configuration message; made by the functions below."""

    how: MspHow
    setting: str = ""
    number: int = 0  # the constant, or the argument of a source
    gain: float = 1.0
    offset: float = 0.0
    choices: tuple[int, ...] = ()  # number of each choice of the setting
    source: MspSource = MspSource.FEATURES


def constant(number: int) -> Bound:
    """Bind a field to a constant."""
    return Bound(MspHow.CONSTANT, number=number)


def unused(number: int = 0) -> Bound:
    """Bind a field to a number that is sent; what a SET brings is ignored."""
    return Bound(MspHow.UNUSED, number=number)


def scaled(setting: str, gain: float = 1.0, offset: float = 0.0) -> Bound:
    """Bind a field to the setting times gain plus offset, rounded."""
    return Bound(MspHow.SCALED, setting, gain=gain, offset=offset)


def choice(setting: str, *numbers: int) -> Bound:
    """Bind a field to the number of the setting's choice."""
    return Bound(MspHow.CHOICE, setting, choices=numbers)


def source(which: MspSource, argument: int = 0) -> Bound:
    """Bind a field to a value that the firmware computes."""
    return Bound(MspHow.SOURCE, number=argument, source=which)


@dataclass(frozen=True)
class MspField:
    """A number, `count` numbers, or a text: of `count` characters (0: up to the end) or behind its length."""

    name: str
    kind: str  # of NUMBERS or TEXTS; "counted": u8 length, then characters
    unit: str = ""
    meaning: str = ""
    count: int = 1
    bound: Bound | None = None
    told_only: bool = False  # a SET may bring any: another field has it too


@dataclass(frozen=True)
class MspGroup:
    """Fields that are repeated: so often as a u8 before them says, `count` times, or (0) up to the end."""

    name: str
    fields: tuple[MspField, ...]
    counted: bool = False
    count: int = 0
    meaning: str = ""


Fields = tuple[MspField | MspGroup, ...]


# --- How the tables of the other files are written ------------------------------------------------
def number(kind: str, name: str, unit: str = "", meaning: str = "", count: int = 1) -> MspField:
    """Describe a field with one number, or with `count`."""
    return MspField(name, kind, unit, meaning, count)


u8, i8, u16, i16, u32, i32, f32 = (partial(number, kind) for kind in NUMBERS)


def numbers(kind: str, names: str, unit: str = "", meaning: str = "") -> tuple[MspField, ...]:
    """Describe several numbers of one kind, one field each; names are separated by spaces."""
    return tuple(MspField(name, kind, unit, meaning) for name in names.split())


def text(name: str, meaning: str = "", count: int = 0) -> MspField:
    """Describe a text of `count` characters; 0: up to the end."""
    return MspField(name, "text", "", meaning, count)


def counted(name: str, meaning: str = "") -> MspField:
    """Describe a text behind its length."""
    return MspField(name, "counted", "", meaning)


def octets(name: str, meaning: str = "", count: int = 0) -> MspField:
    """Describe `count` bytes; 0: up to the end."""
    return MspField(name, "bytes", "", meaning, count)


def bound(
    kind: str, name: str, to: Bound | MspSource | int, unit: str = "", meaning: str = "", count: int = 1
) -> MspField:
    """Describe a field of a configuration message; to: a number alone is a constant."""
    if isinstance(to, MspSource):
        to = source(to)
    return MspField(name, kind, unit, meaning, count, to if isinstance(to, Bound) else constant(to))


def told(kind: str, name: str, to: Bound | MspSource | int, unit: str = "", meaning: str = "") -> MspField:
    """Describe a field that a SET ignores, because another field brings its value too."""
    return replace(bound(kind, name, to, unit, meaning), told_only=True)


def zeros(kind: str, names: str) -> tuple[MspField, ...]:
    """Describe fields that this firmware does not use: only 0 is sent and accepted."""
    return tuple(MspField(name, kind, bound=constant(0)) for name in names.split())


def ignored(kind: str, names: str) -> tuple[MspField, ...]:
    """Describe fields that are told as 0, of which a SET may bring any."""
    return tuple(MspField(name, kind, bound=unused()) for name in names.split())


def flat(fields: Fields) -> Iterator[MspField]:
    """Yield every field in order, also those of groups."""
    for field in fields:
        if isinstance(field, MspGroup):
            yield from field.fields
        else:
            yield field
