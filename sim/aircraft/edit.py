"""Edit values in a hand-written aircraft file: every other byte stays."""

from __future__ import annotations

import copy
import re
import tomllib
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from neuroflight.sim.aircraft.known import Known, is_named, known_line
from neuroflight.sim.aircraft.model import FILE_BYTES_MAX, over_base, parse_aircraft
from neuroflight.toolchain.errors import AircraftError
from neuroflight.toolchain.files import read_limited, write_bytes
from neuroflight.toolchain.strict_toml import parse_toml

Value = str | float | tuple[float, ...]
# Table ("gyro", "propulsion.response"), key, value; None: the key goes.
Changes = Mapping[str, Mapping[str, Value | None]]

# Strings, then comments: what is not structure.
_OPAQUE = re.compile(
    r'"""(?:\\.|[^\\])*?"""|\'\'\'.*?\'\'\'|"(?:\\.|[^"\\\n])*"|\'[^\'\n]*\'|(?P<comment>#[^\n]*)', re.DOTALL
)
_HEADER = re.compile(r"[ \t]*\[[ \t]*([A-Za-z0-9_-]+(?:[ \t]*\.[ \t]*[A-Za-z0-9_-]+)*)[ \t]*\][ \t]*\r?\n?")
_MARK = re.compile(r"""[ \t]*("(?:\\.|[^"\\\n])*"|'[^'\n]*')[ \t]*=""")  # a quoted key, as [known] has
_ASSIGNMENT = re.compile(r"[ \t]*([A-Za-z0-9_-]+)[ \t]*=[ \t]*")


@dataclass(frozen=True)
class Statement:
    """One statement of a file, its line end included: lines, joined while a bracket is open."""

    text: str
    table: str  # it stands in; "" also within a list of tables
    heads: bool  # whether it is that table's header
    key: str  # it assigns, "": none
    value: tuple[int, int]  # begin and end of that key's value in `text`


def edit_aircraft(
    source: Path,
    changes: Changes,
    target: Path | None = None,
    note: tuple[str, str] | None = None,
    known: Mapping[str, Known] | None = None,
) -> None:
    """Give the file at `source` the values of `changes`; keys and tables that it lacks are added.

    target: gets the edited file; None: `source` does. note: begin and end of a comment below the header of
    the first table, in place of one that begins so. known: marks of numbers, in place of what marked them.
    A mark whose number goes, goes with it. What is written has been read back as an aircraft first.
    Raises AircraftError, the file untouched, on one that is missing, too large or not TOML, that keeps a
    table in another form than [table], or that is no valid aircraft afterwards.
    """
    where = f"aircraft file {source}"
    if not source.is_file():
        raise AircraftError(f"{where}: no such file; copy one of sim/aircraft/ there and make it yours")
    data = read_limited(source, where, FILE_BYTES_MAX, AircraftError)
    before = parse_toml(data, where, AircraftError)
    text = data.decode("utf-8-sig")
    for table, values in changes.items():
        for key, value in values.items():
            text = with_key(text, table, key, value)
    if note is not None:
        text = _with_note(text, next(iter(changes)), *note)
    expected = _expected(before, changes)
    if isinstance(marks := expected.get("known"), dict) and "" not in expected:
        whole = over_base(expected, str(source))
        gone = [key for key in marks if not is_named(whole, key)]
        text = without_marks(text, gone)
        expected["known"] = {key: mark for key, mark in marks.items() if key not in gone}
    if known:
        text = with_known(text, known)
        kept = {key: mark for key, mark in expected.get("known", {}).items() if not _replaced(key, known)}
        expected["known"] = kept | tomllib.loads("\n".join(known_line(*mark) for mark in known.items()))
    tables = " and ".join(f"[{table}]" for table in changes)
    write_edited(source, target or source, text, expected, tables)


def with_known(text: str, known: Mapping[str, Known]) -> str:
    """Return the text of an aircraft file with these marks in [known], in place of what marked the same.

    A mark replaces those of its list's or its table's single numbers too. The numbers must be in the file.
    """
    newline = newline_of(text)
    marked = [key for each in statements(text) if (key := _marked(each)) and _replaced(key, known)]
    text = without_marks(text, marked)
    lines = [f"{known_line(*mark)}{newline}" for mark in known.items()]
    if text and not text.endswith("\n"):
        text += newline
    found = statements(text)
    within = [number for number, each in enumerate(found, 1) if each.table == "known" and each.text.strip()]
    if not within:
        return "".join([text, f"{newline}[known]{newline}", *lines])
    texts = [each.text for each in found]
    return "".join([*texts[: within[-1]], *lines, *texts[within[-1] :]])


def write_edited(source: Path, target: Path, text: str, expected: dict[str, Any], tables: str) -> None:
    """Write an edited aircraft file that says `expected` and is an aircraft.

    Raises AircraftError, `target` as it was, on another one: `source` has not the plain `tables` that can be
    edited.
    """
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        document = {}
    if document != expected:
        raise AircraftError(
            f"aircraft file {source}: cannot be edited as it is written; give it plain tables {tables}"
        )
    parse_aircraft(text.encode(), str(target), target.parent)
    try:
        write_bytes(target, text.encode())
    except OSError as error:
        raise AircraftError(f"aircraft file {target}: cannot be written: {error.strerror}") from error


def statements(text: str) -> list[Statement]:
    """Split a file into its statements; a comment or an empty line is one too."""
    bare = _OPAQUE.sub(lambda m: (" " if m.group("comment") else "x") * len(m.group()), text)
    found: list[Statement] = []
    table = ""
    start = end = depth = 0
    for line in bare.splitlines(keepends=True):
        end += len(line)
        depth += sum(line.count(c) for c in "[{") - sum(line.count(c) for c in "]}")
        if depth > 0:
            continue
        statement = bare[start:end]
        header, assignment = _HEADER.fullmatch(statement), _ASSIGNMENT.match(statement)
        if header or statement.lstrip().startswith("[["):
            table = "".join(header.group(1).split()) if header else ""
        key = assignment.group(1) if assignment else ""
        value = (assignment.end(), len(statement.rstrip())) if assignment else (0, 0)
        found.append(Statement(text[start:end], table, header is not None, key, value))
        start, depth = end, 0
    return found


def newline_of(text: str) -> str:
    """Return the line end of a file."""
    return "\r\n" if "\r\n" in text else "\n"


def with_key(text: str, table: str, key: str, value: Value | None) -> str:
    """Set `key` of `table` in `text`: replace its value, or add a line below the table's header."""
    newline, found = newline_of(text), statements(text)
    lines = [line.text for line in found]
    for number, line in enumerate(found):
        if (line.table, line.key) == (table, key):
            first, last = line.value
            lines[number] = "" if value is None else line.text[:first] + _toml(value) + line.text[last:]
            return "".join(lines)
    if value is None:
        return text
    if lines and not text.endswith("\n"):
        lines[-1] += newline
    below = [number for number, line in enumerate(found, 1) if line.heads and line.table == table]
    if not below:
        lines.append(f"{newline}[{table}]{newline}")
    lines.insert(below[-1] if below else len(lines), f"{key} = {_toml(value)}{newline}")
    return "".join(lines)


def _marked(statement: Statement) -> str:
    """Return the key of a mark; "" of another statement."""
    if statement.table != "known" or statement.heads:
        return ""
    quoted = _MARK.match(statement.text)
    return str(tomllib.loads(f"key = {quoted[1]}")["key"]) if quoted else statement.key


def without_marks(text: str, keys: Collection[str]) -> str:
    """Return the text of an aircraft file without the marks of these keys."""
    return "".join(each.text for each in statements(text) if (_marked(each) or None) not in keys)


def _replaced(key: str, known: Mapping[str, Known]) -> bool:
    """Return True if one of `known` marks what `key` marked, or all of it."""
    return any(key == new or key.startswith((f"{new}.", f"{new}[")) for new in known)


def _with_note(text: str, table: str, begin: str, end: str) -> str:
    """Return `text` with that comment below the header of `table`, in place of one with the same begin."""
    lines = []
    for line in statements(text):
        if line.table != table or not line.text.startswith(begin):
            lines.append(line.text)
        if line.table == table and line.heads:
            lines.append(f"{begin}{end}{newline_of(text)}")
    return "".join(lines)


def _expected(before: dict[str, Any], changes: Changes) -> dict[str, Any]:
    after = copy.deepcopy(before)
    for table, values in changes.items():
        at = after
        for name in table.split("."):
            at = at.setdefault(name, {})
            if not isinstance(at, dict):
                return {"": None}  # a list or a number where the table should be: equal to nothing read
        at |= {k: list(v) if isinstance(v, tuple) else v for k, v in values.items()}
        for key in [key for key, value in values.items() if value is None]:
            del at[key]
    return after


def _toml(value: Value) -> str:
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, tuple):
        return f"[{', '.join(_toml(item) for item in value)}]"
    return repr(float(value))
