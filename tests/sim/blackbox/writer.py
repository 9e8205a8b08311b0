"""A small writer of logs in Betaflight's format, for tests: what is written is known."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

PRODUCT = b"H Product:Blackbox flight data recorder by Nicholas Sherlock\nH Data version:2\n"
UNSIGNED, GROUP, NONE, SIGNED = 1, 6, 9, 0  # encodings


@dataclass(frozen=True)
class Column:
    """A field, predicted in P frames by the frame before it; the first two are predicted as ever."""

    name: str
    encoding: int = SIGNED  # in P frames


def unsigned(value: int) -> bytes:
    """An integer of 7 bits a byte, the lowest first."""
    value %= 1 << 32
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes((*out, value))


def signed(value: int) -> bytes:
    """The sign in the lowest bit, of 32 bits that wrap."""
    value = (value + (1 << 31)) % (1 << 32) - (1 << 31)
    return unsigned((value << 1) ^ (value >> 63))


def header(lines: Mapping[str, object]) -> bytes:
    """Header lines."""
    return b"".join(f"H {name}:{value}\n".encode() for name, value in lines.items())


def fields(columns: Sequence[Column], slow: Sequence[str] = ()) -> bytes:
    """The lines that tell loopIteration, time, `columns` and the slow fields."""

    def row(*values: object) -> str:
        return ",".join(str(value) for value in values)

    names = ["loopIteration", "time", *(column.name for column in columns)]
    count = len(columns)
    told: dict[str, object] = {
        "Field I name": row(*names),
        "Field I signed": row(*[0, 0], *[1] * count),
        "Field I predictor": row(*[0] * (count + 2)),
        "Field I encoding": row(UNSIGNED, UNSIGNED, *[SIGNED] * count),
        "Field P predictor": row(6, 2, *[1] * count),
        "Field P encoding": row(NONE, SIGNED, *(column.encoding for column in columns)),
    }
    if slow:
        told |= {
            "Field S name": row(*slow),
            "Field S signed": row(*[0] * len(slow)),
            "Field S predictor": row(*[0] * len(slow)),
            "Field S encoding": row(*[UNSIGNED] * len(slow)),
        }
    return header(told)


def intra(step: int, time: int, values: Sequence[int]) -> bytes:
    """An I frame."""
    return b"I" + unsigned(step) + unsigned(time) + b"".join(signed(value) for value in values)


def inter(columns: Sequence[Column], jitter: int, before: Sequence[int], values: Sequence[int]) -> bytes:
    """A P frame; jitter: of the time, from a straight line."""
    out = bytearray(b"P" + signed(jitter))
    at = 0
    while at < len(columns):
        end = at + 1
        if columns[at].encoding == GROUP:
            while end < min(at + 8, len(columns)) and columns[end].encoding == GROUP:
                end += 1
        changes = [new - old for new, old in zip(values[at:end], before[at:end], strict=True)]
        if columns[at].encoding == GROUP and end - at > 1:
            out.append(sum(1 << bit for bit, change in enumerate(changes) if change))
            changes = [change for change in changes if change]
        out += b"".join(signed(change) for change in changes)
        at = end
    return bytes(out)


def slow(values: Sequence[int]) -> bytes:
    """A slow frame."""
    return b"S" + b"".join(unsigned(value) for value in values)


def event(kind: int, *values: int) -> bytes:
    """An event."""
    return bytes((0x45, kind)) + b"".join(unsigned(value) for value in values)


END = b"E\xffEnd of log\0"


def flight(
    columns: Sequence[Column],
    rows: Sequence[Sequence[int]],
    *,
    interval: int = 32,
    period: int = 1000,
    divider: int = 1,
    start: int = 5_000_000,
    clock: Sequence[int] | None = None,
) -> bytes:
    """Write frames of rows from `start` [us], `period` [us] and `divider` control steps apart.

    Every `interval` rows there is an I frame. clock: the time of each row [us] instead.
    """
    clock = [start + number * period for number in range(len(rows))] if clock is None else clock
    out = bytearray()
    for number, values in enumerate(rows):
        if number % interval == 0:
            out += intra(number * divider, clock[number], values)
        else:
            # After an I frame both frames before are that one: the line is level.
            before = clock[number - 1], clock[number - (1 if number % interval == 1 else 2)]
            out += inter(columns, clock[number] - 2 * before[0] + before[1], rows[number - 1], values)
    return bytes(out)
