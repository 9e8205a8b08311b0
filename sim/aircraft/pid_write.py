"""Write PID settings into an aircraft file: one table changes, all other lines stay."""

from __future__ import annotations

import copy
import re
import tomllib
from pathlib import Path
from typing import Any

from neuroflight.sim.aircraft.model import PidSettings, load_aircraft, parse_aircraft
from neuroflight.toolchain.contract import AXES, POLICY_FILTER_MEAN, Mix
from neuroflight.toolchain.errors import AircraftError
from neuroflight.toolchain.files import write_bytes

NAME = re.compile(r"[A-Za-z0-9_-]{1,32}")
MARKS = tuple(f"# Found by `neuroflight {words}" for words in ("pid tune", "tune-pid"))  # and of before
_HEADER = re.compile(r"\s*\[+\s*([\w.\s-]+?)\s*\]+")


def write_pid(source: Path, target: Path, name: str, settings: PidSettings, comment: str) -> None:
    """Write the aircraft of `source` with `settings` as [pid.NAME] to `target`, which may be the same.

    A table of that name is replaced where it stands; a new one goes before the other PIDs and becomes the
    aircraft's own. comment: goes above it; one that begins with one of MARKS is replaced with it. A mixer is
    not written. Raises AircraftError, with `target` as it was, on a source that is no valid aircraft, a name
    no table can have, or a file kept in another form.
    """
    if not NAME.fullmatch(name):
        raise AircraftError(f"PID name {name!r}: expected 1 to 32 letters, digits, dashes or underscores")
    load_aircraft(source)
    text = source.read_bytes().decode("utf-8-sig")
    newline = "\r\n" if "\r\n" in text else "\n"
    lines = text.splitlines(keepends=True)
    first, last = _place(lines, name)
    block = [*_comment(comment), f"[pid.{name}]", *_keys(settings)]
    after = lines[last:]
    if after and after[0].strip():
        block.append("")
    before = "".join(lines[:first])
    if before and not before.endswith("\n"):
        before += newline
    if first == len(lines) and before:
        before += newline
    edited = before + "".join(line + newline for line in block) + "".join(after)
    expected = copy.deepcopy(tomllib.loads(text))
    expected.setdefault("pid", {})[name] = _document(settings)
    if _parsed(edited) != expected:
        raise AircraftError(
            f"aircraft file {source}: cannot be edited as it is written; give it plain tables [pid.NAME]"
        )
    data = edited.encode()
    parse_aircraft(data, str(target), target.parent)
    write_bytes(target, data)


def _place(lines: list[str], name: str) -> tuple[int, int]:
    """Return the lines to replace: [pid.NAME] and our comment above, or none before the first PID."""
    tables = [(number, match[1]) for number, line in enumerate(lines) if (match := _HEADER.match(line))]
    own = [number for number, table in tables if _is(table, name)]
    if own:
        later = [number for number, _ in tables if number > own[-1]]
        first, last = own[0], _comment_above(lines, later[0]) if later else len(lines)
        top = _comment_above(lines, first)
        marked = [number for number in range(top, first) if lines[number].startswith(MARKS)]
        return min([first, *marked]), last
    pids = [number for number, table in tables if table.split(".")[0].strip() == "pid"]
    place = _comment_above(lines, pids[0]) if pids else len(lines)
    return place, place


def _comment_above(lines: list[str], number: int) -> int:
    """Return the first of the comment lines right above line `number`, or `number` itself."""
    while number > 0 and lines[number - 1].startswith("#"):
        number -= 1
    return number


def _is(table: str, name: str) -> bool:
    parts = [part.strip() for part in table.split(".")]
    return parts[:2] == ["pid", name]


def _comment(comment: str) -> list[str]:
    return [f"# {line}" for line in comment.splitlines()]


def _document(settings: PidSettings) -> dict[str, Any]:
    document: dict[str, Any] = {"idle": settings.idle}
    if settings.derivative_cutoff_hz is not None:
        document["derivative_cutoff_hz"] = settings.derivative_cutoff_hz
    if settings.tpa_rate > 0.0:
        document |= {"tpa_rate": settings.tpa_rate, "tpa_breakpoint": settings.tpa_breakpoint}
    if settings.nominal_voltage is not None:
        document["nominal_voltage_v"] = settings.nominal_voltage
    if settings.mix is not Mix.ATTITUDE_FIRST:
        document["mix"] = settings.mix.text
    if settings.gyro_mean:
        document["gyro_filter"] = POLICY_FILTER_MEAN
    return document | {axis: list(gains) for axis, gains in zip(AXES, settings.gains, strict=True)}


def _keys(settings: PidSettings) -> list[str]:
    return [f"{key} = {value!r}" for key, value in _document(settings).items()]


def _parsed(text: str) -> dict[str, Any] | None:
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return None
