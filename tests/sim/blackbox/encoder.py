"""Logs of any fields, written as a firmware writes them: in 32 bits that wrap. What is written is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from numpy.random import Generator

from tests.sim.blackbox.writer import PRODUCT, header, signed, unsigned

WORD = 1 << 32
SIGNED_VB, UNSIGNED_VB, NEG_14BIT, TAG8_8SVB, TAG2_3S32, TAG8_4S16, NOTHING = 0, 1, 3, 6, 7, 8, 9
ZERO, PREVIOUS, LINE, AVERAGE, MINTHROTTLE, MOTOR_0, STEP, MID, VBATREF, MINMOTOR = (
    0,
    1,
    2,
    3,
    4,
    5,
    6,
    8,
    9,
    11,
)
REFERENCES: dict[str, object] = {"minthrottle": 1070, "vbatref": 1640, "motorOutput": "138,2047"}
CONSTANTS = {ZERO: 0, MINTHROTTLE: 1070, MID: 1500, VBATREF: 1640, MINMOTOR: 138}


@dataclass(frozen=True)
class Field:
    """A field of main frames."""

    name: str
    signed: bool
    intra: tuple[int, int]  # predictor and encoding
    inter: tuple[int, int]


@dataclass
class Written:
    """A log and the rows written to it."""

    fields: list[Field]
    rows: list[list[int]]
    lines: dict[str, object]  # of the header, in their order
    frames: bytes
    intervals: tuple[int, int, int]
    order: list[int] = field(default_factory=list)

    def data(self, without: Sequence[str] = ()) -> bytes:
        """Return the file, except for the header lines `without`."""
        kept = {name: value for name, value in self.lines.items() if name not in without}
        product = PRODUCT.splitlines(keepends=True)
        version = b"" if "Data version" in without else product[1]
        return product[0] + version + header(kept) + self.frames + b"E\xffEnd of log\0"


def lines_of(fields: Sequence[Field]) -> dict[str, object]:
    """Return the header lines that describe the fields."""
    columns: dict[str, list[object]] = {
        "Field I name": [one.name for one in fields],
        "Field I signed": [int(one.signed) for one in fields],
        "Field I predictor": [one.intra[0] for one in fields],
        "Field I encoding": [one.intra[1] for one in fields],
        "Field P predictor": [one.inter[0] for one in fields],
        "Field P encoding": [one.inter[1] for one in fields],
    }
    return {name: ",".join(map(str, values)) for name, values in columns.items()}


def encode(
    fields: list[Field],
    rows: list[list[int]],
    intervals: tuple[int, int, int],
    rng: Generator,
    more: dict[str, object] | None = None,
) -> Written:
    """Encode `rows`, whose first field counts steps; intervals: I, and P and Q of the P interval P/Q.

    The caller gives the rows of the steps in `logged_steps`. Where an encoding has several forms for the same
    values, one is drawn.
    """
    out = bytearray()
    last = before = rows[0]
    for row in rows:
        intra = row[0] % intervals[0] == 0
        out += b"I" if intra else b"P"
        rest = [
            (value - _prediction(one.intra[0] if intra else one.inter[0], at, row, last, before)) % WORD
            for at, (one, value) in enumerate(zip(fields, row, strict=True))
        ]
        rest = [value - WORD if value >= WORD // 2 else value for value in rest]
        out += _fields([one.intra[1] if intra else one.inter[1] for one in fields], rest, rng)
        before, last = (row, row) if intra else (last, row)
    interval, logged, of = intervals
    lines = {"I interval": interval, "P interval": f"{logged}/{of}", **lines_of(fields)}
    return Written(fields, rows, {**lines, **REFERENCES, **(more or {})}, bytes(out), intervals)


def logged_steps(intervals: tuple[int, int, int], count: int) -> list[int]:
    """Return the first `count` steps that are logged, from 0."""
    interval, logged, of = intervals
    found: list[int] = []
    step = 0
    while len(found) < count:
        if (step % interval + logged - 1) % of < logged:
            found.append(step)
        step += 1
    return found


def _prediction(kind: int, at: int, row: list[int], last: list[int], before: list[int]) -> int:
    if kind == PREVIOUS:
        return last[at]
    if kind == LINE:
        return 2 * last[at] - before[at]
    if kind == AVERAGE:
        return int((last[at] + before[at]) / 2)  # towards 0; both are below 2^31
    if kind == MOTOR_0:
        return row[at - 1] if at else 0
    if kind == STEP:
        return row[at]
    return CONSTANTS[kind]


def _fields(encodings: list[int], rest: list[int], rng: Generator) -> bytes:
    out = bytearray()
    at = 0
    while at < len(rest):
        encoding, value = encodings[at], rest[at]
        count = 1
        if encoding == SIGNED_VB:
            out += signed(value)
        elif encoding == UNSIGNED_VB:
            out += unsigned(value)
        elif encoding == NEG_14BIT:
            out += unsigned(-value % (1 << 14))
        elif encoding == TAG2_3S32:
            count = 3
            out += _tag2_3s32(rest[at : at + 3], rng)
        elif encoding == TAG8_4S16:
            count = 4
            out += _tag8_4s16(rest[at : at + 4], rng)
        elif encoding == TAG8_8SVB:
            while count < 8 and at + count < len(rest) and encodings[at + count] == TAG8_8SVB:
                count += 1
            group = rest[at : at + count]
            if count > 1:
                out.append(sum(1 << bit for bit, one in enumerate(group) if one))
            out += b"".join(signed(one) for one in group if one or count == 1)
        at += count
    return bytes(out)


def _fits(value: int, bits: int) -> bool:
    return -(1 << (bits - 1)) <= value < 1 << (bits - 1)


def _tag2_3s32(values: list[int], rng: Generator) -> bytes:
    """Encode three values, in a random one of the forms that they fit into."""
    forms = [form for form, bits in enumerate((2, 4, 6)) if all(_fits(value, bits) for value in values)]
    form = int(rng.choice([*forms, 3]))
    a, b, c = values
    if form == 0:
        return bytes(((a & 3) << 4 | (b & 3) << 2 | c & 3,))
    if form == 1:
        return bytes((0x40 | a & 15, (b & 15) << 4 | c & 15))
    if form == 2:
        return bytes((0x80 | a & 63, b & 63, c & 63))
    lead, rest = 0xC0, b""
    for at, value in enumerate(values):
        size = int(rng.choice([size for size in (1, 2, 3, 4) if _fits(value, 8 * size)]))
        lead |= (size - 1) << 2 * at
        rest += value.to_bytes(size, "little", signed=True)
    return bytes((lead,)) + rest


def _tag8_4s16(values: list[int], rng: Generator) -> bytes:
    """Encode four values in 0, 4, 8 or 16 bits each, a random one that fits, as a row of hex digits."""
    tags, digits = 0, ""
    for at, value in enumerate(values):
        sizes = [tag for tag, bits in ((1, 4), (2, 8), (3, 16)) if _fits(value, bits)] + [0] * (value == 0)
        tag = int(rng.choice(sizes))
        tags |= tag << 2 * at
        count = (0, 1, 2, 4)[tag]
        digits += f"{value % (1 << 4 * count):0{count}x}" if count else ""
    return bytes((tags,)) + bytes.fromhex(digits + "0" * (len(digits) % 2))
