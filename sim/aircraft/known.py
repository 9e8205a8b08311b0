"""Marks of an aircraft's numbers: whether each was measured, is typical of its kind, or guessed.

Table [known] of the aircraft file. A key names a number of the file: "propulsion.delay_s",
"part.battery.mass_kg" by the part's name, "rotor.propeller_m" of all rotors, "propulsion.speed_curve_rpm[1]"
one of a list; or a table, "body" or "part", for all of its numbers that have no mark of their own. Marks do
not change what the twin flies.
"""

from __future__ import annotations

import copy
import json
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any

from neuroflight.toolchain.strict_toml import StrictTable

SOURCE_MAX = 160  # characters that a measuring command says of its log, at most
_KEY = re.compile(r"([^\[\]]+?)(?:\[(\d{1,2})\])?")
_UNMARKED = ("known", "logged", "pid", "format")  # a PID's gains are chosen, not known


class How(Enum):
    """The way in which a number of an aircraft came to be known."""

    MEASURED = "measured"
    TYPICAL = "typical"
    GUESSED = "guessed"


@dataclass(frozen=True)
class Known:
    """A mark of one number."""

    how: How
    range: tuple[float, float] | None = None  # in which it lies by 95 %, in the key's unit; None: not known
    source: str = ""  # the log, the page, the rule that it comes from; "" only of a guess


def read_known(table: StrictTable, document: Mapping[str, Any]) -> dict[str, Known]:
    """Read [known] of an aircraft's file, `document`. Raises the table's error, which names the key."""
    found: dict[str, Known] = {}
    for key in table.names():
        if not is_named(document, key):
            raise table.error(
                key,
                "names no number of this file; expected one such as propulsion.delay_s, part.NAME.mass_kg, "
                "rotor.propeller_m, propulsion.speed_curve_rpm[1], or a table such as body",
            )
        mark = table.part(key, _read_mark)
        if mark.range is not None and not _is_number(value_of(document, key)):
            raise table.error(key, "has several numbers: give the range to one of them")
        found[key] = mark
    return found


def is_named(document: Mapping[str, Any], key: str) -> bool:
    """Return True if a mark's key names a number of a file, a list of them, or a table that has some."""
    return value_of(document, key) is not None or any(
        each.startswith(f"{key}.") for each in keys_of(document)
    )


def value_of(document: Mapping[str, Any], key: str) -> float | list[Any] | None:
    """Return the number, or the list of numbers, that a mark's key names in a file; None: there is none."""
    match = _KEY.fullmatch(key)
    if match is None:
        return None
    head, _, last = match[1].rpartition(".")
    for at in _tables(document, head):
        value = at.get(last)
        numbers = value if isinstance(value, list) else [value]
        if not numbers or not all(_is_number(each) for each in numbers):
            continue
        if match[2] is None:
            return value  # type: ignore[no-any-return]
        if isinstance(value, list) and int(match[2]) < len(value):
            return value[int(match[2])]  # type: ignore[no-any-return]
    return None


def keys_of(document: Mapping[str, Any]) -> list[str]:
    """List every key that can be marked: the numbers of a file, in its order; those of all rotors once."""
    found: dict[str, None] = {}

    def walk(table: Mapping[str, Any], path: str) -> None:
        for name, value in table.items():
            key = f"{path}{name}"
            if isinstance(value, dict):
                walk(value, f"{key}.")
            elif value_of(document, key) is not None:
                found[key] = None

    for name, value in document.items():
        if name in _UNMARKED:
            continue
        for each in value if isinstance(value, list) else [value]:
            if isinstance(each, dict):
                walk(each, f"part.{each.get('name')}." if name == "part" else f"{name}.")
            elif value_of(document, name) is not None:
                found[name] = None
    return list(found)


def mark_of(known: Mapping[str, Known], key: str) -> Known | None:
    """Return the mark of a number: its own, or that of the nearest table around it; None: it has none."""
    return known.get(_nearest(known, key))


def numbers_of(document: Mapping[str, Any], known: Mapping[str, Known], key: str) -> list[str]:
    """List the keys of the numbers that a mark counts for: its own, or of a table those without their own."""
    inside = [each for each in keys_of(document) if each.startswith(f"{key}.")]
    return [each for each in inside if _nearest(known, each) == key] if inside else [key]


def scaled(document: Mapping[str, Any], keys: Collection[str], factor: float) -> dict[str, Any]:
    """Return a copy of a file whose numbers that these keys name are `factor` times as large."""
    changed = copy.deepcopy(dict(document))
    for key in keys:
        match = _KEY.fullmatch(key)
        each = match[1] if match else key
        head, _, last = each.rpartition(".")
        for table in _tables(changed, head):
            value = table.get(last)
            if isinstance(value, list):
                chosen = range(len(value)) if match is None or match[2] is None else [int(match[2])]
                table[last] = [item * factor if at in chosen else item for at, item in enumerate(value)]
            elif isinstance(value, int | float):
                table[last] = value * factor
    return changed


def known_line(key: str, mark: Known) -> str:
    """Return a mark as the line of its file."""
    parts = [f"how = {json.dumps(mark.how.value)}"]
    if mark.range is not None:
        parts.append("range = [{:.6g}, {:.6g}]".format(*mark.range))
    if mark.source:
        parts.append(f"from = {json.dumps(mark.source, ensure_ascii=False)}")
    return f"{json.dumps(key, ensure_ascii=False)} = {{ {', '.join(parts)} }}"


def _nearest(known: Mapping[str, Known], key: str) -> str:
    """Return the key of the mark that counts for a number; "": none does."""
    at = key
    while at and at not in known:
        at = at.removesuffix("]").rpartition("[")[0] if at.endswith("]") else at.rpartition(".")[0]
    return at


def _tables(document: Mapping[str, Any], path: str) -> list[dict[str, Any]]:
    """Return the tables that the part of a key before its last dot names: several for the rotors."""
    if path in _UNMARKED or path.startswith("pid."):
        return []
    first, _, rest = path.partition(".")
    if first == "part":
        parts = document.get("part")
        return [each for each in parts if each.get("name") == rest] if isinstance(parts, list) else []
    if path == "rotor":
        rotors = document.get("rotor")
        return list(rotors) if isinstance(rotors, list) else []
    at: Any = document
    for name in path.split(".") if path else []:
        at = at.get(name) if isinstance(at, dict) else None
    return [at] if isinstance(at, dict) else []


def _read_mark(table: StrictTable) -> Known:
    how = table.choice("how", {each.value: each for each in How})
    source = "" if how is How.GUESSED and not table.has("from") else table.text("from")
    bounds = table.numbers("range", 2, 2, -1e12, 1e12) if table.has("range") else None
    if bounds is not None and bounds[0] > bounds[1]:
        raise table.error("range", f"got {list(bounds)}, expected the lower bound first")
    return Known(how, None if bounds is None else (bounds[0], bounds[1]), source)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
