"""Strict reading of TOML: a key of the wrong type, out of its range or unknown is an error that names it."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from neuroflight.toolchain.errors import NeuroflightError

Value = TypeVar("Value")
SHOWN_MAX = 60  # characters of a wrong value in a message
TEXT_MAX = 200  # characters
LINES_MAX = 4000  # of text with several lines


def parse_toml(data: bytes, where: str, failure: type[NeuroflightError]) -> dict[str, Any]:
    """Parse the bytes of a file that others wrote. Raises `failure`, naming `where` and the line."""
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        byte = data[error.start]
        raise failure(
            f"{where}: not UTF-8: byte 0x{byte:02x} at {error.start}; save it as UTF-8 text"
        ) from error
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # ValueError: also numbers of thousands of digits
        lines = text.splitlines()
        found = re.search(r"at line (\d+)", str(error))
        line = lines[int(found[1]) - 1].strip() if found and int(found[1]) <= len(lines) else ""
        at = f": {line[:SHOWN_MAX]!r}" if line else ""
        raise failure(f"{where}: not TOML: {error or 'nested too deep'}{at}") from error


class StrictTable:
    """One table of a parsed file. `finish()` raises the error on keys that were never read."""

    def __init__(
        self, values: Mapping[str, Any], where: str, error: type[NeuroflightError], path: str = ""
    ) -> None:
        self._values = values
        self._where = where
        self._error = error
        self._path = path
        self._read: set[str] = set()
        self._known: set[str] = set()

    def has(self, key: str) -> bool:
        """Return True if the file gives `key`."""
        self._known.add(key)
        return key in self._values

    def either(self, *keys: str) -> str:
        """Return the one of `keys` that the file gives; none or more than one is an error."""
        given = [key for key in keys if self.has(key)]
        if not given:
            raise self.error(keys[0], f"missing; give it or one of: {', '.join(keys[1:])}")
        if len(given) > 1:
            raise self.error(given[1], f"stands beside {given[0]}; give one of the two")
        return given[0]

    def error(self, key: str, message: str) -> NeuroflightError:
        """Return the error about `key`, for the caller to raise."""
        name = f"{self._path}{key}"
        return self._error(f"{self._where}: {name if name.isprintable() else shown(name)}: {message}")

    def number(self, key: str, low: float, high: float, default: float | None = None) -> float:
        """Read a finite number in [low, high]."""
        return self._number(key, self._get(key, default), low, high)

    def optional_number(self, key: str, low: float, high: float) -> float | None:
        """Read a finite number in [low, high]; None if the file does not give it."""
        return self.number(key, low, high) if self.has(key) else None

    def integer(self, key: str, low: int, high: int, default: int | None = None) -> int:
        """Read a whole number in [low, high]."""
        value = self._get(key, default)
        if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
            raise self.error(key, f"got {shown(value)}, expected a whole number from {low} to {high}")
        return value

    def text(self, key: str, default: str | None = None) -> str:
        """Read a line of 1 to 200 characters (the default may be empty)."""
        value = self._get(key, default)
        if value == default and key not in self._values:
            return str(value)
        if not isinstance(value, str) or not 1 <= len(value) <= TEXT_MAX or not value.isprintable():
            raise self.error(key, f"got {shown(value)}, expected one line of 1 to {TEXT_MAX} characters")
        return value

    def texts(self, key: str, fewest: int, most: int) -> tuple[str, ...]:
        """Read a list of `fewest` to `most` lines, each of 1 to 200 characters."""
        value = self._get(key, None)
        if not isinstance(value, list) or not fewest <= len(value) <= most:
            raise self.error(key, f"got {shown(value)}, expected a list of {fewest} to {most} texts")
        parts = StrictTable(
            {str(at): item for at, item in enumerate(value)}, self._where, self._error, f"{self._path}{key}."
        )
        return tuple(parts.text(name) for name in parts.names())

    def lines(self, key: str) -> list[str]:
        """Read text of one or more lines, unchanged."""
        value = self._get(key, None)
        printable = isinstance(value, str) and all(line.isprintable() for line in value.split("\n"))
        if not printable or not 1 <= len(value) <= LINES_MAX:
            raise self.error(key, f"got {shown(value)}, expected text of 1 to {LINES_MAX} characters")
        return str(value).strip().split("\n")

    def choice(self, key: str, values: Mapping[str, Value], default: str | None = None) -> Value:
        """Return the value of `values` whose name the file gives."""
        value = self._get(key, default)
        if not isinstance(value, str) or value not in values:
            raise self.error(key, f"got {shown(value)}, expected one of: {', '.join(values)}")
        return values[value]

    def names(self) -> tuple[str, ...]:
        """Return all keys, in the file's order: for a table whose keys are names."""
        return tuple(self._values)

    def vector(
        self, key: str, low: float, high: float, default: tuple[float, float, float] | None = None
    ) -> tuple[float, float, float]:
        """Read three finite numbers, each in [low, high]."""
        if default is not None and not self.has(key):
            return default
        value = self._get(key, None)
        if not isinstance(value, list) or len(value) != 3:
            raise self.error(key, f"got {shown(value)}, expected a list of three numbers")
        x, y, z = (self._number(f"{key}[{i}]", item, low, high) for i, item in enumerate(value))
        return (x, y, z)

    def numbers(self, key: str, fewest: int, most: int, low: float, high: float) -> tuple[float, ...]:
        """Read a number, or a list of `fewest` to `most` of them; each finite and in [low, high]."""
        value = self._get(key, None)
        if not isinstance(value, list):
            value = [value]
        if not fewest <= len(value) <= most:
            expected = f"{fewest}" if fewest == most else f"{fewest} to {most}"
            raise self.error(key, f"got {len(value)} numbers, expected {expected}")
        many = len(value) > 1
        return tuple(
            self._number(f"{key}[{i}]" if many else key, item, low, high) for i, item in enumerate(value)
        )

    def table(self, key: str) -> StrictTable:
        """Return the table called `key`."""
        value = self._get(key, None)
        if not isinstance(value, dict):
            raise self.error(key, f"got {shown(value)}, expected a table [{self._path}{key}]")
        return self._within(value, key)

    def part(self, key: str, read: Callable[[StrictTable], Value]) -> Value:
        """Return what `read` makes of the table called `key`, in which no key may be left over."""
        return self.table(key).whole(read)

    def optional_part(self, key: str, read: Callable[[StrictTable], Value]) -> Value | None:
        """Return `part`; None if the file has no such table."""
        return self.part(key, read) if self.has(key) else None

    def parts(self, key: str, low: int, high: int, read: Callable[[StrictTable], Value]) -> tuple[Value, ...]:
        """Return what `read` makes of each table [[key]], `low` to `high` of them."""
        return tuple(table.whole(read) for table in self.tables(key, low, high))

    def whole(self, read: Callable[[StrictTable], Value]) -> Value:
        """Return what `read` makes of this table, and `finish` it."""
        value = read(self)
        self.finish()
        return value

    def tables(self, key: str, low: int, high: int) -> list[StrictTable]:
        """Return the list of tables [[key]], `low` to `high` of them."""
        value = self._get(key, None)
        if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
            raise self.error(key, f"expected tables [[{self._path}{key}]]")
        if not low <= len(value) <= high:
            raise self.error(key, f"got {len(value)} of them, expected {low} to {high}")
        return [self._within(item, f"{key}[{i}]") for i, item in enumerate(value)]

    def finish(self) -> None:
        """Raise the error if the file has a key that was never read: most often a misspelt one."""
        unknown = sorted(set(self._values) - self._read)
        if unknown:
            raise self.error(unknown[0], f"unknown key; known here: {', '.join(sorted(self._known))}")

    def _within(self, values: Mapping[str, Any], key: str) -> StrictTable:
        return type(self)(values, self._where, self._error, f"{self._path}{key}.")

    def _get(self, key: str, default: object) -> Any:  # noqa: ANN401 - any TOML value
        self._known.add(key)
        self._read.add(key)
        if key not in self._values and default is None:
            raise self.error(key, "missing")
        return self._values.get(key, default)

    def _number(self, key: str, value: object, low: float, high: float) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.error(key, f"got {shown(value)}, expected a number")
        if not low <= value <= high:  # NaN included
            raise self.error(key, f"got {shown(value)}, expected {low:g} to {high:g}")
        return value if isinstance(value, float) else float(value)  # a float may know how it was written


def shown(value: object) -> str:
    """Format a value for a message: on one line, shortened if it is long."""
    try:
        text = repr(value)
    except ValueError:  # Python does not print integers of thousands of digits
        text = "a number of thousands of digits"
    return text if len(text) <= SHOWN_MAX else f"{text[:SHOWN_MAX]}..."
