"""Edit values in a hand-written aircraft file: every other byte stays."""

from __future__ import annotations

import copy
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from neuroflight.sim.aircraft.model import FILE_BYTES_MAX, parse_aircraft
from neuroflight.toolchain.errors import AircraftError
from neuroflight.toolchain.files import file_size, write_bytes

Value = str | float | tuple[float, ...]
Changes = Mapping[str, Mapping[str, Value]]  # table ("gyro", "propulsion.response"), key, value

# Strings, then comments: what is not structure.
_OPAQUE = re.compile(
    r'"""(?:\\.|[^\\])*?"""|\'\'\'.*?\'\'\'|"(?:\\.|[^"\\\n])*"|\'[^\'\n]*\'|(?P<comment>#[^\n]*)', re.DOTALL
)
_HEADER = re.compile(r"[ \t]*\[[ \t]*([A-Za-z0-9_-]+(?:[ \t]*\.[ \t]*[A-Za-z0-9_-]+)*)[ \t]*\][ \t]*\r?\n?")
_ASSIGNMENT = re.compile(r"[ \t]*([A-Za-z0-9_-]+)[ \t]*=[ \t]*")


def edit_aircraft(path: Path, changes: Changes) -> None:
    """Give the file at `path` the values of `changes`; keys and tables that it lacks are added.

    What is written has been read back as an aircraft first. Raises AircraftError, the file untouched, on one
    that is missing, too large or not TOML, that keeps a table in another form than [table], or that is no
    valid aircraft afterwards.
    """
    where = f"aircraft file {path}"
    if not path.is_file():
        raise AircraftError(f"{where}: no such file; copy one of sim/aircraft/ there and make it yours")
    if file_size(path) > FILE_BYTES_MAX:
        raise AircraftError(f"{where}: {file_size(path)} bytes, expected at most {FILE_BYTES_MAX}")
    data = path.read_bytes()
    try:
        before = tomllib.loads(data.decode())
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise AircraftError(f"{where}: not TOML: {error}") from error
    text = data.decode()
    for table, values in changes.items():
        for key, value in values.items():
            text = _with_key(text, table, key, _toml(value))
    try:
        after = tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        after = {}
    if after != _expected(before, changes):
        tables = " and ".join(f"[{table}]" for table in changes)
        raise AircraftError(f"{where}: cannot be edited as it is written; give it plain tables {tables}")
    parse_aircraft(text.encode(), str(path), path.parent)
    try:
        write_bytes(path, text.encode())
    except OSError as error:
        raise AircraftError(f"{where}: cannot be written: {error.strerror}") from error


def _with_key(text: str, table: str, key: str, value: str) -> str:
    """Set `key` of `table` in `text`: replace its value, or add a line below the table's header."""
    bare = _OPAQUE.sub(lambda m: (" " if m.group("comment") else "x") * len(m.group()), text)
    newline = "\r\n" if "\r\n" in text else "\n"
    inside, below = False, -1
    for start, end in _statements(bare):
        statement = bare[start:end]
        header = _HEADER.fullmatch(statement)
        if header or statement.lstrip().startswith("[["):
            inside = header is not None and "".join(header.group(1).split()) == table
            below = end if inside else below
        elif inside and (assignment := _ASSIGNMENT.match(statement)) and assignment.group(1) == key:
            first, last = start + assignment.end(), start + len(statement.rstrip())
            return text[:first] + value + text[last:]
    if below >= 0:
        gap = "" if text[:below].endswith("\n") else newline
        return f"{text[:below]}{gap}{key} = {value}{newline}{text[below:]}"
    gap = "" if text.endswith("\n") or not text else newline
    return f"{text}{gap}{newline}[{table}]{newline}{key} = {value}{newline}"


def _statements(bare: str) -> list[tuple[int, int]]:
    """Start and end of each header or assignment, by offset: lines, joined while a bracket is open."""
    found: list[tuple[int, int]] = []
    start = end = depth = 0
    for line in bare.splitlines(keepends=True):
        end += len(line)
        depth += sum(line.count(c) for c in "[{") - sum(line.count(c) for c in "]}")
        if depth <= 0:
            found.append((start, end))
            start, depth = end, 0
    return found


def _expected(before: dict[str, Any], changes: Changes) -> dict[str, Any]:
    after = copy.deepcopy(before)
    for table, values in changes.items():
        at = after
        for name in table.split("."):
            at = at.setdefault(name, {})
            if not isinstance(at, dict):
                return {"": None}  # a list or a number where the table should be: equal to nothing read
        at.update({k: list(v) if isinstance(v, tuple) else v for k, v in values.items()})
    return after


def _toml(value: Value) -> str:
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, tuple):
        return f"[{', '.join(_toml(item) for item in value)}]"
    return repr(float(value))
