"""Files of settings: lines `set NAME = VALUE`, as `dump` and the firmware's command line print them.

They are read, never executed: besides settings only blank lines, comments (#) and the words that a copy of
the command line has around them are taken, and those do nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from neuroflight.flash.settings.text import (
    RATES,
    STYLE,
    Value,
    beside_style,
    default_of,
    known_setting,
    parse_value,
    same,
)
from neuroflight.flash.settings.values import Settings, Stored
from neuroflight.toolchain.errors import LinkError
from neuroflight.toolchain.files import file_size

FILE_BYTES_MAX = 64 << 10
SHOWN = 60  # characters of a line in an error
PASSED_OVER = frozenset({"batch", "defaults", "diff", "dump", "exit", "save"})  # first words


@dataclass(frozen=True)
class Line:
    """A setting in a file."""

    number: int  # from 1
    value: Value


def read_file(path: Path) -> dict[str, Line]:
    """Read the settings of a file, by name. Raises LinkError, naming the line, for anything else in it."""
    size = file_size(path)
    if size > FILE_BYTES_MAX:
        raise LinkError(f"{path}: {size} bytes, expected settings, {FILE_BYTES_MAX} bytes at most")
    with path.open("rb") as file:
        data = file.read(FILE_BYTES_MAX + 1)
    try:
        text = data.decode("ascii")
    except UnicodeDecodeError as error:
        number = data.count(b"\n", 0, error.start) + 1
        raise LinkError(f"{path}:{number}: byte 0x{data[error.start]:02X}, expected ASCII") from None
    lines: dict[str, Line] = {}
    for number, line in enumerate(text.replace("\r\n", "\n").split("\n"), start=1):
        try:
            found = _parse_line(line)
        except LinkError as error:
            raise LinkError(f"{path}:{number}: {error}") from None
        if found is None:
            continue
        name, value = found
        if name in lines:
            raise LinkError(f"{path}:{number}: {name} is set in line {lines[name].number} already")
        lines[name] = Line(number, value)
    return lines


def _parse_line(line: str) -> tuple[str, Value] | None:
    words = line.split(maxsplit=1)
    if not words or words[0].startswith("#") or words[0].lower() in PASSED_OVER:
        return None
    name, equals, value = words[1].partition("=") if len(words) == 2 else ("", "", "")
    if words[0].lower() != "set" or not equals:
        shown = line if len(line) <= SHOWN else f"{line[:SHOWN]}..."
        raise LinkError(
            f"got {shown!r}, expected set NAME = VALUE; Betaflight's diff goes by `neuroflight board "
            "settings import`"
        )
    name = name.strip()
    return name, parse_value(name, value)


def restored(settings: Settings, path: Path, lines: Mapping[str, Line], *, keep: bool) -> dict[str, Value]:
    """Return the changes that give the firmware the file's settings, and defaults for the others.

    keep: settings that the file does not name stay as they are. Raises LinkError, naming the line, for \\
    values that the firmware does not accept.
    """
    now = {stored.name: stored for stored in settings.read()}
    style = _style(now, lines, keep)
    for name, line in lines.items():
        try:
            settings.check({STYLE: style, name: line.value} if STYLE in now else {name: line.value})
        except LinkError as error:
            raise LinkError(f"{path}:{line.number}: {error}") from None
    turned = STYLE in now and not same(STYLE, now[STYLE].value, style)
    target = {
        name: lines[name].value if name in lines else _untold(stored, style, keep=keep, turned=turned)
        for name, stored in now.items()
    }
    return {
        name: value
        for name, value in target.items()
        if not same(name, now[name].value, value) or (turned and name in RATES)
    }


def _style(now: Mapping[str, Stored], lines: Mapping[str, Line], keep: bool) -> Value:
    if STYLE in lines:
        return lines[STYLE].value
    if STYLE not in now:
        return default_of(known_setting(STYLE))
    return now[STYLE].value if keep else now[STYLE].default


def _untold(stored: Stored, style: Value, *, keep: bool, turned: bool) -> Value:
    """Return the value of a setting that the file does not name."""
    if stored.name in RATES and turned:  # the new style's default: the old number has no meaning in it
        return default_of(beside_style(known_setting(stored.name), float(style)))
    return stored.value if keep else stored.default
