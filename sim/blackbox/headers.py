"""A file of logs cut into logs, and the header lines of each. Files may be damaged or hostile.

A log begins with lines `H name:value`, of which `Field I name` and its like say what the frames hold; the
frames follow without a gap. Several logs stand one behind the other; a card's file ends in blank bytes.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from toolchain.errors import TraceError
from toolchain.files import file_size

FILE_BYTES_MAX = 256 << 20  # of a file: flash chips have up to 256 MB, our card's files 64 MB
LOGS_MAX = 1000  # in a file
LINE_BYTES_MAX = 8192  # of a header line; 255 names of fields take up to 6,000
LINES_MAX = 8192  # of a log's headers; our state takes some hundred
FIELDS_MAX = 255  # of one kind of frame; the ecosystem's tools take 128
DAMAGE_BYTES_MAX = 1024  # between two header lines, that is taken for a damaged one
INTERVAL_MAX = 1 << 16  # of the headers I interval and P interval
ENCODINGS = frozenset((0, 1, 3, 6, 7, 8, 9))  # that Betaflight writes and orangebox reads
PREDICTORS = frozenset(range(12))
TEXT_MAX = 100  # characters of a header's value in a message
KINDS = "IPSGH"  # of frames that headers describe

_BEGIN = re.compile(rb"H (Product:Blackbox flight data recorder|Field I name:)")
_LINE = re.compile(rb"\nH [A-Za-z][A-Za-z0-9_ .\[\]/-]{0,63}:")
_ODD = re.compile(r"[^A-Za-z0-9_\[\]. -]")  # in a field's name, which becomes a column's in files
_NEXT = b"H Product:"  # of another log
_BLANK = b"\0\xff"


@dataclass(frozen=True)
class Extent:
    """Where a log stands in its file, in bytes: header lines, then frames."""

    start: int
    body: int
    end: int  # of what is not blank


@dataclass(frozen=True)
class FieldDefinition:
    """A field of one kind of frame: its name, and how it was predicted and encoded."""

    name: str
    predictor: int
    encoding: int


@dataclass(frozen=True)
class Headers:
    """Header lines of a log."""

    values: dict[str, str]  # name to value, both printable ASCII
    fields: dict[str, tuple[FieldDefinition, ...]]  # of I, P, S, G and H frames, as far as they are whole
    notes: tuple[str, ...]  # what is wrong with them, a line each

    def integer(self, name: str, default: int) -> int:
        """The number in header `name`, or `default` where there is none."""
        found = _integer(self.values.get(name, ""))
        return default if found is None else found

    def integers(self, name: str) -> list[int]:
        """The numbers in header `name`, separated by commas; none where one is no number."""
        found = [_integer(text) for text in self.values.get(name, "").split(",")]
        return [] if None in found else [value for value in found if value is not None]


def read_bytes(path: Path) -> bytes:
    """The whole file. Raises TraceError where it is too large, OSError where it cannot be read."""
    size = file_size(path)
    if size > FILE_BYTES_MAX:
        raise TraceError(
            f"{path}: {size >> 20} MB, expected at most {FILE_BYTES_MAX >> 20} MB of logs; cut it, or give "
            "a single flight"
        )
    return path.read_bytes()[:FILE_BYTES_MAX]


def find_logs(data: bytes) -> list[Extent]:
    """Where the logs of a file stand, at most LOGS_MAX of them."""
    starts: list[int] = []
    bodies: list[int] = []
    for match in _BEGIN.finditer(data):
        if starts and match.start() < bodies[-1]:
            continue
        starts.append(match.start())
        bodies.append(_header_lines(data, match.start())[1])
        if len(starts) == LOGS_MAX:
            break
    found = []
    limits = [*starts[1:], len(data)] if starts else []
    for start, body, limit in zip(starts, bodies, limits, strict=True):
        end = body + len(data[body:limit].rstrip(_BLANK))
        # A frame may end in zeros: as many as one can are kept.
        found.append(Extent(start, body, min(limit, end + 2 * FIELDS_MAX) if end < limit else limit))
    return found


def read_headers(data: bytes, extent: Extent) -> Headers:
    """The header lines of the log at `extent`; what is wrong with them is told in its notes."""
    values: dict[str, str] = {}
    notes: list[str] = []
    lines, _, damaged = _header_lines(data, extent.start)
    for line in lines:
        name, colon, value = line.partition(b":")
        if not colon:
            damaged += 1
            continue
        values.setdefault(_ascii(name[2:].strip()), _ascii(value.strip()))
    if damaged:
        notes.append(f"{damaged} header line{'s' if damaged > 1 else ''} damaged")
    if len(lines) >= LINES_MAX:
        notes.append(f"more than {LINES_MAX} header lines; the rest is not read")
    return Headers(values, _fields(values, notes), tuple(notes))


def _header_lines(data: bytes, start: int) -> tuple[list[bytes], int, int]:
    """Header lines from `start` on, where the frames begin, and how many lines were no header's."""
    lines: list[bytes] = []
    damaged = 0
    at = start
    while len(lines) < LINES_MAX:
        end = data.find(b"\n", at, at + LINE_BYTES_MAX)
        if end >= 0 and data.startswith(b"H ", at) and b":" in data[at:end]:
            lines.append(data[at:end])
            at = end + 1
            continue
        # No header line: the first frame, or damage with more lines behind it.
        further = _LINE.search(data, at, at + DAMAGE_BYTES_MAX)
        if further is None or _NEXT in data[at + 1 : further.end()]:
            break
        damaged += 1
        at = further.start() + 1
    return lines, at, damaged


def _fields(values: dict[str, str], notes: list[str]) -> dict[str, tuple[FieldDefinition, ...]]:
    """Definitions of each kind of frame, those left out that do not fit together."""
    found: dict[str, tuple[FieldDefinition, ...]] = {}
    for kind in KINDS:
        if f"Field {kind} predictor" not in values and f"Field {kind} name" not in values:
            continue
        named = values.get(f"Field {'I' if kind == 'P' else kind} name", "").split(",")
        try:
            found[kind] = _definitions(kind, named, values)
        except ValueError as error:
            notes.append(f"{kind} frames cannot be read: {error}")
    if "I" not in found:
        return {}
    return found


def _definitions(kind: str, named: Sequence[str], values: dict[str, str]) -> tuple[FieldDefinition, ...]:
    """Definitions of one kind of frame. Raises ValueError where header lines lack or do not fit together."""
    if not 1 <= len(named) <= FIELDS_MAX:
        raise ValueError(f"{len(named)} fields, expected 1 to {FIELDS_MAX}")
    columns = []
    for what, known in (("predictor", PREDICTORS), ("encoding", ENCODINGS)):
        name = f"Field {kind} {what}"
        numbers = [_integer(text) for text in values.get(name, "").split(",")]
        if len(numbers) != len(named):
            raise ValueError(f"{name} has {len(numbers)} entries, expected {len(named)}")
        unknown = [text for text in values[name].split(",") if _integer(text) not in known]
        if unknown:
            raise ValueError(f"{name} has {unknown[0][:TEXT_MAX]!r}, which is not known")
        columns.append([number or 0 for number in numbers])
    names: list[str] = []
    for number, told in enumerate(named):
        name = _ODD.sub("?", told)
        names.append(name if name and name not in names else f"{name or 'field'}#{number}")
    return tuple(FieldDefinition(*row) for row in zip(names, *columns, strict=True))


def _integer(text: str) -> int | None:
    """The integer, decimal or with 0x, in `text`; None where there is none, or one beyond 64 bits."""
    match = re.fullmatch(r"\s*(?:0x([0-9a-fA-F]{1,16})|(-?[0-9]{1,18}))\s*", text)
    if match is None:
        return None
    return int(match[1], 16) if match[1] else int(match[2])


def _ascii(line: bytes) -> str:
    """`line` with a question mark for what is not printable ASCII."""
    return "".join(chr(byte) if 32 <= byte < 127 else "?" for byte in line)
