"""Write PID settings into an aircraft file: one table changes, all other lines stay."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

from neuroflight.sim.aircraft.edit import newline_of, statements, write_edited
from neuroflight.sim.aircraft.model import PidSettings, load_aircraft
from neuroflight.toolchain.contract import AXES, Mix
from neuroflight.toolchain.errors import AircraftError

NAME = re.compile(r"[A-Za-z0-9_-]{1,32}")
MARKS = tuple(f"# Found by `neuroflight {words}" for words in ("pid tune", "tune-pid"))  # and of before
Lines = list[tuple[str, list[str]]]  # each with the first two names of the table that it stands in


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
    newline, lines = newline_of(text), [(each.text, each.table.split(".")[:2]) for each in statements(text)]
    first, last = _place(lines, name)
    block = [*_comment(comment), f"[pid.{name}]", *_keys(settings)]
    before, after = ("".join(line for line, _ in part) for part in (lines[:first], lines[last:]))
    if after and lines[last][0].strip():
        block.append("")
    if before and not before.endswith("\n"):
        before += newline
    if first == len(lines) and before:
        before += newline
    expected = tomllib.loads(text)
    expected.setdefault("pid", {})[name] = _document(settings)
    edited = before + "".join(line + newline for line in block) + after
    write_edited(source, target, edited, expected, "[pid.NAME]")


def _place(lines: Lines, name: str) -> tuple[int, int]:
    """Return the lines to replace: [pid.NAME] and our comment above, or none before the first PID."""
    own = [number for number, (_, table) in enumerate(lines) if table == ["pid", name]]
    if own:
        above = range(_comment_above(lines, own[0]), own[0])
        marked = [number for number in above if lines[number][0].startswith(MARKS)]
        return min([own[0], *marked]), _comment_above(lines, own[-1] + 1)
    pids = [number for number, (_, table) in enumerate(lines) if table[:1] == ["pid"]]
    place = _comment_above(lines, pids[0]) if pids else len(lines)
    return place, place


def _comment_above(lines: Lines, number: int) -> int:
    """Return the first of the comment lines right above line `number`, or `number` itself."""
    while 0 < number < len(lines) and lines[number - 1][0].startswith("#"):
        number -= 1
    return number


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
    if settings.gyro_filters.every_sample:
        document["gyro_filter"] = settings.gyro_filters.text
    return document | {axis: list(gains) for axis, gains in zip(AXES, settings.gains, strict=True)}


def _keys(settings: PidSettings) -> list[str]:
    return [f"{key} = {value!r}" for key, value in _document(settings).items()]
