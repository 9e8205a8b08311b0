"""Stored results: the output of commands with --json, validated when read."""

from __future__ import annotations

import json
import math
import shlex
from collections.abc import Mapping, MutableMapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from neuroflight.toolchain.errors import NeuroflightError
from neuroflight.toolchain.files import read_limited
from neuroflight.training.dissertation.quotes import Axes

FILE_BYTES_MAX = 4 << 20
FILES_MAX = 200
WIDTH = 160  # characters of a line of a stored file
COMMANDS = "commands.txt"  # in a folder of results: a line NAME.json neuroflight COMMAND... for each


class ResultsError(NeuroflightError):
    """A stored result that is damaged, or is not a result."""


@dataclass(frozen=True)
class Interval:
    """A figure, or the difference of two, and its 95 % confidence interval."""

    value: float
    low: float
    high: float

    def text(self, digits: int, factor: float = 1.0, sign: str = "") -> str:
        """Return the value and half its width; sign: "+" for a difference."""
        margin = (self.high - self.low) / 2
        return f"{factor * self.value:{sign},.{digits}f} ± {factor * margin:,.{digits}f}"

    def difference(self, digits: int, factor: float = 1.0) -> str:
        """Return it as a difference, marked where it may be none."""
        mark = "" if self.low > 0 or self.high < 0 else "≈ "
        return mark + self.text(digits, factor, "+")


@dataclass(frozen=True)
class Stored:
    """A file of results, or an object in it."""

    name: str
    document: MutableMapping[str, Any]

    def error(self, key: str, got: object, expected: str) -> ResultsError:
        """Return the exception about `key`, for the caller to raise."""
        return ResultsError(
            f"{self.name}: {key}: got {str(got)[:60]!r}, expected {expected}; "
            f"make the file anew by its command"
        )

    def get(self, *path: str) -> Any:  # noqa: ANN401 - any JSON value
        """Return the value at a path of keys. Raises ResultsError naming the path if there is none."""
        value: Any = self.document
        for depth, key in enumerate(path, start=1):
            if not isinstance(value, Mapping) or key not in value:
                raise self.error(".".join(path[:depth]), "nothing", "a value")
            value = value[key]
        return value

    def has(self, *path: str) -> bool:
        """Return True if there is a value at a path of keys."""
        value: Any = self.document
        for key in path:
            if not isinstance(value, Mapping) or key not in value:
                return False
            value = value[key]
        return True

    def entries(self, *path: str) -> list[Stored]:
        """Return the objects of the list at a path, at least one."""
        value = self.get(*path)
        if not isinstance(value, list) or not value or not all(isinstance(item, dict) for item in value):
            raise self.error(".".join(path), value, "a list of objects")
        where = f"{self.name}: {'.'.join(path)}"
        return [Stored(f"{where}[{number}]", item) for number, item in enumerate(value)]

    def number(self, *path: str) -> float:
        """Return the finite number at a path."""
        value = self.get(*path)
        if not _finite(value):
            raise self.error(".".join(path), value, "a finite number")
        return float(value)

    def optional(self, *path: str) -> float | None:
        """Return the finite number at a path, or None where there is none."""
        return self.number(*path) if self.has(*path) else None

    def interval(self, *path: str) -> Interval:
        """Return the figure with its interval at a path."""
        return Interval(*(self.number(*path, part) for part in ("value", "low", "high")))

    def numbers(self, *path: str) -> list[float]:
        """Return the list of finite numbers at a path, at least one."""
        value = self.get(*path)
        if not isinstance(value, list) or not value or not all(map(_finite, value)):
            raise self.error(".".join(path), value, "a list of numbers")
        return [float(each) for each in value]

    def text(self, *path: str) -> str:
        """Return the line of text at a path."""
        value = self.get(*path)
        if not isinstance(value, str) or not value.isprintable():
            raise self.error(".".join(path), value, "a line of text")
        return value

    def axes(self, *path: str) -> Axes:
        """Return the three finite numbers at a path."""
        value = self.get(*path)
        if not isinstance(value, list) or len(value) != 3 or not all(map(_finite, value)):
            raise self.error(".".join(path), value, "three finite numbers")
        roll, pitch, yaw = value
        return (float(roll), float(pitch), float(yaw))


def _finite(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def read_results(folder: Path, fewest: int = 1) -> list[Stored]:
    """Read the stored results of a folder, by name. Raises ResultsError naming a file that is none."""
    paths = sorted(folder.glob("*.json"))
    if not fewest <= len(paths) <= FILES_MAX:
        raise ResultsError(
            f"{folder}: {len(paths)} .json files, expected {fewest} to {FILES_MAX}; "
            f"`neuroflight compare --one ... --json > {folder}/NAME.json` makes one"
        )
    results = []
    for path in paths:
        data = read_limited(path, f"{path}", FILE_BYTES_MAX, ResultsError)
        try:
            document = json.loads(data)
        except (ValueError, RecursionError) as error:
            raise ResultsError(f"{path}: not JSON ({error}); make it anew") from error
        if not isinstance(document, dict):
            raise ResultsError(f"{path}: holds a {type(document).__name__}, expected an object; make it anew")
        results.append(Stored(path.name, document))
    return results


def read_commands(folder: Path) -> dict[str, list[str]]:
    """Return the command that makes each file of a folder of results: words after `neuroflight`, no --json.

    They stand in its commands.txt, a line for each file; # begins a remark. Raises ResultsError naming a /
    wrong line.
    """
    path = folder / COMMANDS
    if not path.is_file():
        raise ResultsError(
            f"{path}: not there; write a line `NAME.json neuroflight COMMAND...` for each file"
        )
    lines = read_limited(path, f"{path}", FILE_BYTES_MAX, ResultsError).decode(errors="replace").splitlines()
    found: dict[str, list[str]] = {}
    for number, line in enumerate(lines, start=1):
        where = f"{path}: line {number}"
        try:
            name, program, *words = shlex.split(line, comments=True) or ("", "neuroflight")
        except ValueError:
            name, program, words = line, "", []
        if not name and not words:
            continue
        if program != "neuroflight" or not words or not name.endswith(".json") or Path(name).name != name:
            raise ResultsError(f"{where}: {line[:60]!r}, expected NAME.json neuroflight COMMAND...")
        if name in found:
            raise ResultsError(f"{where}: {name} for a second time, expected each file once")
        found[name] = words
    return found


def compact(value: Any, margin: str = "") -> str:  # noqa: ANN401 - any JSON value
    """Return JSON of as few lines as WIDTH allows: what fits stands on one, beside its neighbours."""
    line = json.dumps(value)
    if not isinstance(value, dict | list) or len(margin) + len(line) <= WIDTH:
        return line
    inner = f"{margin} "
    names = [f"{json.dumps(key)}: " for key in value] if isinstance(value, dict) else [""] * len(value)
    entries = value.values() if isinstance(value, dict) else value
    lines: list[str] = []
    for name, entry in zip(names, entries, strict=True):
        text = name + compact(entry, inner)
        beside = f"{lines[-1]}, {text}" if lines else ""
        if beside and "\n" not in beside and len(inner) + len(beside) <= WIDTH:
            lines[-1] = beside
        else:
            lines.append(text)
    return f"{line[0]}\n{inner}" + f",\n{inner}".join(lines) + f"\n{margin}{line[-1]}"
