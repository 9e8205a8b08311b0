"""Scripts of channels: files of times and values, CSV or TOML.

    t_s,  throttle, roll, aux1         [[frame]]
    0,    1000,     1500, 1000         t_s = 0.0
    1.5,  ,         ,     2000         throttle = 1000
    2,    1200,     ,                  ...

A value holds until a later row names another; what no row names is at rest (sticks centred, throttle down,
switches low). The last row's time is the end. Values are pulse widths in microseconds.
"""

from __future__ import annotations

import bisect
import csv
import io
import math
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from neuroflight.flash.channels.layout import NAMES, REST, Channels, Layout, throttle_low
from neuroflight.flash.channels.source import Instead
from neuroflight.toolchain.contract import CHANNEL_VALID_MAX_US, CHANNEL_VALID_MIN_US
from neuroflight.toolchain.errors import LinkError
from neuroflight.toolchain.files import file_size

FILE_BYTES_MAX = 1 << 20
ROWS_MAX = 100_000
SECONDS_MAX = 3600.0
TIME = "t_s"


@dataclass(frozen=True)
class Script:
    """Channels that change at given times; a Source."""

    name: str
    times_s: tuple[float, ...]  # rising, from 0
    rows: tuple[Channels, ...]  # channels from each time on; the last row is the end

    def at(self, elapsed_s: float) -> Channels | Instead:
        """See Source."""
        if elapsed_s >= self.times_s[-1]:
            return Instead.END
        return self.rows[bisect.bisect_right(self.times_s, elapsed_s) - 1]


def read_script(path: Path) -> Script:
    """Read a file that ends in .csv or .toml. Raises LinkError that names the row."""
    try:
        size = file_size(path)
        data = path.read_bytes() if size <= FILE_BYTES_MAX else b""
    except OSError as error:
        raise LinkError(f"script {path}: cannot be read: {error.strerror}; check its name") from None
    if size > FILE_BYTES_MAX:
        raise LinkError(f"script {path}: {size} bytes, expected at most {FILE_BYTES_MAX}")
    return parse_script(data, str(path), path.suffix.lower())


def parse_script(data: bytes, where: str, suffix: str) -> Script:
    """Parse the bytes of a script file; `where` names it in messages. Raises LinkError."""
    if suffix not in (".csv", ".toml"):
        raise LinkError(f"script {where}: expected a name that ends in .csv or .toml")
    try:
        text = data.decode()
        rows = list(_csv_rows(text) if suffix == ".csv" else _toml_rows(text))
        times_s, channels = _followed(rows)
    except (UnicodeDecodeError, csv.Error, tomllib.TOMLDecodeError, ValueError) as error:
        raise LinkError(f"script {where}: {' '.join(str(error).split())}") from None
    return Script(where, times_s, channels)


def check_script(script: Script, layout: Layout, *, may_arm: bool) -> None:
    """Raise LinkError for a script that begins otherwise than at rest, or arms without leave to."""
    first = script.rows[0]
    if not throttle_low(first) or layout.arms(first):
        what = "the arm switch on" if layout.arms(first) else "throttle"
        raise LinkError(
            f"script {script.name}: its first row has {what}, "
            "expected the throttle low and the arm switch off to begin with; nothing was sent"
        )
    for time_s, channels in zip(script.times_s, script.rows, strict=True):
        if layout.arms(channels) and not may_arm:
            raise LinkError(
                f"script {script.name}: at {time_s:g} s the arm switch is on, expected off without "
                "--allow-arm; give it if the motors may turn; nothing was sent"
            )


def _csv_rows(text: str) -> Iterator[tuple[str, Mapping[str, object]]]:
    reader = csv.reader(io.StringIO(text), skipinitialspace=True, strict=True)
    heads = [head.strip() for head in next(reader, [])]
    _check_names("the first line", heads)
    for cells in reader:
        if not cells or not any(cell.strip() for cell in cells) or cells[0].startswith("#"):
            continue
        where = f"line {reader.line_num}"
        if len(cells) != len(heads):
            raise ValueError(f"{where} has {len(cells)} values, expected {len(heads)} as the first line")
        yield (
            where,
            {head: _number(where, cell) for head, cell in zip(heads, cells, strict=True) if cell.strip()},
        )


def _number(where: str, cell: str) -> object:
    try:
        return float(cell)
    except ValueError:
        raise ValueError(f"{where} has {cell.strip()!r}, expected a number") from None


def _toml_rows(text: str) -> Iterator[tuple[str, Mapping[str, object]]]:
    document = tomllib.loads(text)
    unknown = sorted(set(document) - {"frame"})
    if unknown:
        raise ValueError(f"unknown key {unknown[0]}, expected [[frame]] alone")
    frames = document.get("frame")
    if not isinstance(frames, list) or not all(isinstance(frame, dict) for frame in frames):
        raise ValueError("expected tables [[frame]]")
    for number, frame in enumerate(frames, 1):
        _check_names(f"frame {number}", list(frame))
        yield f"frame {number}", frame


def _check_names(where: str, names: list[str]) -> None:
    known = {TIME, *NAMES}
    for index, name in enumerate(names):
        if name not in known:
            raise ValueError(
                f"{where} names {name!r}, expected {TIME}, {', '.join(NAMES[:4])}, aux1 to aux12"
            )
        if name in names[:index]:
            raise ValueError(f"{where} names {name} twice, expected once")
    if TIME not in names:
        raise ValueError(f"{where} lacks {TIME}, the time in seconds")


def _followed(
    rows: list[tuple[str, Mapping[str, object]]],
) -> tuple[tuple[float, ...], tuple[Channels, ...]]:
    """Return times and channels of the rows, each of which changes the one before it. Raises ValueError."""
    if not 2 <= len(rows) <= ROWS_MAX:
        raise ValueError(f"{len(rows)} rows, expected 2 to {ROWS_MAX}: the last one is the end")
    times_s: list[float] = []
    channels: list[Channels] = []
    for where, row in rows:
        time_s = _time(where, row.get(TIME), times_s)
        held = dict(zip(NAMES, channels[-1] if channels else REST, strict=True))
        held |= {name: _width(where, name, value) for name, value in row.items() if name != TIME}
        times_s.append(time_s)
        channels.append(tuple(held[name] for name in NAMES))
    return tuple(times_s), tuple(channels)


def _time(where: str, value: object, before: list[float]) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"{where} has no time {TIME}, expected seconds")
    if not before and value != 0:
        raise ValueError(f"{where} begins at {value:g} s, expected 0")
    if before and not before[-1] < value <= SECONDS_MAX:
        raise ValueError(
            f"{where} is at {value:g} s, expected later than {before[-1]:g} s and at most {SECONDS_MAX:g} s"
        )
    return float(value)


def _width(where: str, name: str, value: object) -> int:
    if isinstance(value, bool) or not isinstance(value, int | float) or value != value or value % 1:
        raise ValueError(f"{where}, {name}: got {value!r}, expected whole microseconds")
    if not CHANNEL_VALID_MIN_US <= value <= CHANNEL_VALID_MAX_US:
        raise ValueError(
            f"{where}, {name}: got {value:g} us, expected {CHANNEL_VALID_MIN_US} to {CHANNEL_VALID_MAX_US}"
        )
    return int(value)
