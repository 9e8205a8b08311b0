"""A file of logs cut into logs, and the header lines of each. Files may be damaged or hostile.

A log begins with lines `H name:value`, of which `Field I name` and its like say what the frames hold; the
frames follow without a gap. Several logs stand one behind the other; a card's file ends in blank bytes.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from neuroflight.sim.blackbox.encodings import NEG_14BIT, READERS, TAG8_4S16, UNSIGNED_VB
from neuroflight.sim.blackbox.firmware import Maker, firmware, has_mapped_throttle
from neuroflight.sim.blackbox.scales import gyro_count, header_number, is_adc
from neuroflight.toolchain.errors import TraceError
from neuroflight.toolchain.files import file_size

FILE_BYTES_MAX = 256 << 20  # of a file: flash chips have up to 256 MB, our card's files 64 MB
LOGS_MAX = 1000  # in a file
LINE_BYTES_MAX = 8192  # of a header line; 255 names of fields take up to 6,000
LINES_MAX = 8192  # of a log's headers; our state takes some hundred
FIELDS_MAX = 255  # of one kind of frame; the ecosystem's tools take 128
DAMAGE_BYTES_MAX = 1024  # between two header lines, that is taken for a damaged one
INTERVAL_MAX = 1 << 16  # of the headers I interval and P interval
PREDICTORS = frozenset(range(12))
MINTHROTTLE, MOTOR_0, STEP, HOME, VBATREF, MINMOTOR = 4, 5, 6, 7, 9, 11  # predictors
TEXT_MAX = 100  # characters of a header's value in a message
KINDS = "IPSGH"  # of frames that headers describe
# Betaflight's versions that first wrote the lines named in `_lost`
OUTPUT_FROM, DEADBAND_FROM, FINE_FROM = (3, 1), (4, 2), (4, 4)
# The values that blackbox_decode assumes where the line is lost.
DEFAULTS = {"Data version": 2, "I interval": 32, "minthrottle": 1150, "vbatref": 4095}

_BEGIN = re.compile(rb"H (Product:Blackbox flight data recorder|Field I name:)")
_LINE = re.compile(rb"\nH [A-Za-z][A-Za-z0-9_ .\[\]/-]{0,63}:")
_ODD = re.compile(r"[^A-Za-z0-9_\[\]. -]")  # in a field's name, which becomes a column's in files
_COMMIT = re.compile(r"[0-9a-f]{7,9}")  # Cleanflight's whole revision before 2.0
_WORDS = ("Firmware revision", "Firmware type", "nf_version")  # whose lines need not hold numbers
_NUMBER = re.compile(r"0x[0-9a-fA-F]{1,8}|-?\d+(\.\d+)?")
_PAIR, _AXES = re.compile(r"-?\d+,-?\d+"), re.compile(r"\d+,\d+,\d+")
_NUMBERS = {"motorOutput": _PAIR, "currentMeter": _PAIR, "rate_limits": _AXES}  # lines that hold several
_NUMBERS |= {"P interval": re.compile(r"(\d+\s*/\s*)?\d+")}
_NEXT = b"H Product:"  # of another log
_BLANK = b"\0\xff"


@dataclass(frozen=True)
class Extent:
    """The place of a log in its file, in bytes: header lines, then frames."""

    start: int
    body: int
    end: int  # end of the non-blank bytes


@dataclass(frozen=True)
class FieldDefinition:
    """A field of one kind of frame: its name, and how it was predicted and encoded."""

    name: str
    predictor: int
    encoding: int
    signed: bool


@dataclass(frozen=True)
class Headers:
    """Header lines of a log."""

    values: dict[str, str]  # name to value, both printable ASCII
    fields: dict[str, tuple[FieldDefinition, ...]]  # of I, P, S, G and H frames, as far as they are whole
    notes: tuple[str, ...]  # what is wrong with them, a line each
    told: frozenset[str] = frozenset()  # names of values that come from the user, not from the file

    def integer(self, name: str, default: int) -> int:
        """Return the number in header `name`, or `default` if there is none."""
        found = _integer(self.values.get(name, ""))
        return default if found is None else found

    def lost(self) -> dict[str, str]:
        """Return missing header lines that the fields depend on, each with the consequence.

        They are those that predictors and encodings of the fields name, and of a known firmware those that it
        always writes.
        """
        return _lost(self)

    def integers(self, name: str) -> list[int]:
        """Return the numbers in header `name`, separated by commas; none if one is no number."""
        found = [_integer(text) for text in self.values.get(name, "").split(",")]
        return [] if None in found else [value for value in found if value is not None]


def read_bytes(path: Path) -> bytes:
    """Read the whole file. Raises TraceError if it is too large, OSError if it cannot be read."""
    size = file_size(path)
    if size > FILE_BYTES_MAX:
        raise TraceError(
            f"{path}: {size >> 20} MB, expected at most {FILE_BYTES_MAX >> 20} MB of logs; cut it, or give "
            "a single flight"
        )
    return path.read_bytes()[:FILE_BYTES_MAX]


def find_logs(data: bytes) -> list[Extent]:
    """Find the logs of a file, at most LOGS_MAX of them."""
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
    """Read the header lines of the log at `extent`; its notes tell what is wrong with them."""
    values: dict[str, str] = {}
    notes: list[str] = []
    lines, _, damaged = _header_lines(data, extent.start)
    for line in lines:
        name, colon, value = line.partition(b":")
        if not colon:
            damaged += 1
            continue
        values.setdefault(_ascii(name[2:].strip()), _ascii(value.strip()))
    if sum(line.endswith(b"\r") for line in lines) > len(lines) / 2:
        notes.append("header lines end in CR LF: the file was transferred as text, values may be wrong")
    if damaged:
        notes.append(f"{damaged} header line{'s' if damaged > 1 else ''} damaged")
    if len(lines) >= LINES_MAX:
        notes.append(f"more than {LINES_MAX} header lines; the rest is not read")
    return Headers(values, _fields(values, notes), tuple(notes))


def _header_lines(data: bytes, start: int) -> tuple[list[bytes], int, int]:
    """Return header lines from `start` on, the start of the frames, and the number of damaged lines."""
    lines: list[bytes] = []
    damaged = 0
    at = start
    while len(lines) < LINES_MAX:
        end = data.find(b"\n", at, at + LINE_BYTES_MAX)
        if lines and data.startswith(_NEXT, at):
            break
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
    """Return the definitions of each kind of frame, without those that contradict each other."""
    found: dict[str, tuple[FieldDefinition, ...]] = {}
    for kind in KINDS:
        if kind not in "IP" and not any(name.startswith(f"Field {kind} ") for name in values):
            continue  # every log has all other lines
        named = values.get(f"Field {'I' if kind == 'P' else kind} name", "").split(",")
        try:
            found[kind] = _definitions(kind, named, values)
        except ValueError as error:
            notes.append(f"{kind} frames cannot be read: {error}")
    if "I" not in found:
        return {}
    return found


def _definitions(kind: str, named: Sequence[str], values: dict[str, str]) -> tuple[FieldDefinition, ...]:
    """Read the definitions of one kind of frame. Raises ValueError for missing or unequal header lines."""
    if named == [""]:
        raise ValueError(f"the header line Field {'I' if kind == 'P' else kind} name is lost")
    if not 1 <= len(named) <= FIELDS_MAX:
        raise ValueError(f"{len(named)} fields, expected 1 to {FIELDS_MAX}")
    columns = []
    for what, known in (("predictor", PREDICTORS), ("encoding", READERS.keys())):
        name = f"Field {kind} {what}"
        if name not in values:
            raise ValueError(f"the header line {name} is lost")
        numbers = [_integer(text) for text in values[name].split(",")]
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
    if MOTOR_0 in columns[0] and "motor[0]" not in names[: columns[0].index(MOTOR_0)]:
        raise ValueError("a field is predicted by motor[0], which is not before it")
    signs = _signs(kind, values, len(named))
    if signs is None:  # the encoding shows it as well, except for motors, whose unsigned encoding may wrap
        signs = [encoding not in (UNSIGNED_VB, NEG_14BIT) for encoding in columns[1]]
    return tuple(FieldDefinition(*row) for row in zip(names, *columns, signs, strict=True))


def _signs(kind: str, values: dict[str, str], count: int) -> list[bool] | None:
    """Return for each field if it is signed, in P and I frames alike; None where that line is lost."""
    numbers = [
        _integer(text) for text in values.get(f"Field {'I' if kind == 'P' else kind} signed", "").split(",")
    ]
    return None if len(numbers) != count or None in numbers else [number != 0 for number in numbers]


def intervals(headers: Headers) -> tuple[int, int, int]:
    """Return I, P, Q: an I frame comes every I steps, and P of Q steps are logged.

    They are within limits that let every search for the next step end.
    """
    intra = headers.integer("I interval", DEFAULTS["I interval"])
    parts = re.fullmatch(r"\s*(?:([0-9]{1,6})\s*/)?\s*([0-9]{1,6})\s*", headers.values.get("P interval", "1"))
    logged, of = (int(parts[1] or 1), int(parts[2])) if parts else (1, 1)
    if not 1 <= logged <= of <= INTERVAL_MAX:
        logged = of = 1
    return intra if 1 <= intra <= INTERVAL_MAX else 1, logged, of


def _lost(headers: Headers) -> dict[str, str]:
    """Return lost header lines and what follows from each: the value of `Headers.lost`."""
    told, fields = headers.values, headers.fields
    predictors = {one.predictor for kind in fields.values() for one in kind}
    names = {one.name for kind in fields.values() for one in kind}
    found: dict[str, str] = {}

    def need(line: str, needed: object, follows: str) -> None:
        if not needed or line in found:
            return
        if not told.get(line):
            found[line] = follows
        elif line not in _WORDS and not _NUMBERS.get(line, _NUMBER).fullmatch(told[line].strip()):
            found[line] = f"{told[line][:TEXT_MAX]!r} cannot be read, {follows}"

    for kind, described in fields.items():
        if kind != "P" and _signs(kind, told, len(described)) is None:
            found[f"Field {kind} signed"] = "numbers have the sign of their encoding"
    steps = any(one.predictor == STEP for one in fields.get("P", ()))
    need("P interval", steps, "steps are counted as if each were logged")
    need("I interval", steps and intervals(headers)[2] > 1, "32 is taken, and steps may be counted wrong")
    packed = any(one.encoding == TAG8_4S16 for kind in fields.values() for one in kind)
    need("Data version", packed, "2 is taken")
    for line, predictor in (("minthrottle", MINTHROTTLE), ("vbatref", VBATREF), ("motorOutput", MINMOTOR)):
        based = [
            one.name.partition("[")[0]
            for kind in fields.values()
            for one in kind
            if one.predictor == predictor
        ]
        mend = f"--header {line}={'LOW,HIGH' if line == 'motorOutput' else 'NUMBER'}"
        columns = ", ".join(dict.fromkeys(based))
        need(line, based, f"values of {columns} may be wrong by a constant, tell it by {mend}")
    if HOME in predictors and "H" not in fields:
        found["Field H name"] = "positions are told without the home that they are relative to"
    if not told.get("Firmware revision") and "Firmware type" not in told:
        return found  # written by an unknown firmware
    need("Firmware revision", True, "whose log it is is not known")
    whose = firmware(told)
    if whose.maker is Maker.OTHER and _COMMIT.fullmatch(told.get("Firmware revision", "")):
        found["Firmware type"] = "whose log it is is not known"
    if header_number(told, "gyro.scale") is None:
        follows = "a count of the gyro is taken as 1 deg/s"
        if gyro_count(told, whose) is None:
            follows = "the gyro cannot be read, tell it by --header gyro_scale=DEG_S"
        need("gyro_scale", {"gyroADC[0]", "gyroData[0]"} & names, follows)
    need("acc_1G", "accSmooth[0]" in names, "what a count of accSmooth is is not known")
    if has_mapped_throttle(whose):
        for line, taken in (("minthrottle", DEFAULTS["minthrottle"]), ("maxthrottle", 2000)):
            follows = f"{taken} us is taken for the throttle, tell it by --header {line}=US"
            need(line, "rcCommand[3]" in names, follows)
    if is_adc(whose):
        need("vbatscale", "vbatLatest" in names, "voltage cannot be read")
        need("currentMeter", "amperageLatest" in names, "current cannot be read")
    if whose.maker is Maker.INAV:
        need("motorOutput", "motor[0]" in names, "what motors have at zero thrust is not known")
    ours = any(name.startswith("nf_") for name in told)
    need("nf_version", ours, "our log is taken for Betaflight's")
    if whose.maker is Maker.BETAFLIGHT and not ours:
        need(
            "motorOutput",
            whose.version >= OUTPUT_FROM and "motor[0]" in names,
            "what motor values mean is not known",
        )
        fine = whose.version >= FINE_FROM and {"gyroADC[0]", "setpoint[0]", "rcCommand[0]"} & names
        by_stick = whose.version >= DEADBAND_FROM and "rcCommand[0]" in names and "setpoint[0]" not in names
        by_stick &= "rates" in told  # otherwise the user is asked for all of them
        need("rate_limits", by_stick, "1998 deg/s is taken, tell it by --header rate_limits=ROLL,PITCH,YAW")
        for line in ("deadband", "yaw_deadband"):
            need(line, by_stick, f"0 us is taken of the sticks, tell it by --header {line}=US")
        need("blackbox_high_resolution", fine, "numbers are taken as whole deg/s, they may be tenths")
    return found


def _integer(text: str) -> int | None:
    """Parse the integer, decimal or with 0x, in `text`; None if there is none, or one beyond 64 bits."""
    match = re.fullmatch(r"\s*(?:0x([0-9a-fA-F]{1,16})|(-?[0-9]{1,18}))\s*", text)
    if match is None:
        return None
    return int(match[1], 16) if match[1] else int(match[2])


def _ascii(line: bytes) -> str:
    """Replace what is not printable ASCII in `line` by question marks."""
    return "".join(chr(byte) if 32 <= byte < 127 else "?" for byte in line)
