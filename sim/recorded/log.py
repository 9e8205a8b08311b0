"""Recorded commands of a blackbox log, Betaflight's or ours: of its armed part."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from neuroflight.sim.blackbox.flight import WHOLE, Part, armed_rows, check_sticks
from neuroflight.sim.blackbox.log import list_logs, read_log
from neuroflight.sim.blackbox.units import channels
from neuroflight.sim.recorded.commands import Commands
from neuroflight.toolchain.errors import ScenarioError, TraceError

SUFFIXES = (".bbl", ".bfl", ".txt")
_NUMBERED = re.compile(r"(.+):(\d{1,6})")


def split_number(path: Path) -> tuple[Path, int | None]:
    """Split FILE:N into the file and the number of its log, from 1; None: the path names none."""
    found = _NUMBERED.fullmatch(str(path))
    if found is None or Path(found[1]).suffix.lower() not in SUFFIXES:
        return path, None
    return Path(found[1]), int(found[2])


def read_commands(
    path: Path,
    number: int | None,
    part: Part = WHOLE,
    told: Mapping[str, str] | None = None,
    *,
    cut: bool = False,
) -> Commands:
    """Read the commands of log `number` of a file; None: the last with frames. Raises ScenarioError.

    Commands are the setpoints of the armed rows in `part`. told: header lines that the user gives, by name;
    cut: see Commands.
    """
    where = f"recording {path}"
    try:
        count = len(list_logs(path))
        log = read_log(path, number, lines=told)
        flown = channels(log)
        if not flown.armed.any():
            raise TraceError(f"{path}: log {log.number} has no armed row: nothing was commanded")
        rows = armed_rows(log, flown, part)
        asked = flown.pilot
        if asked.rates is None:
            raise TraceError(f"{path}: log {log.number} has {asked.lacks}")
        if np.isnan(asked.rates[rows]).any():
            check_sticks(log, flown, rows)
    except TraceError as error:
        raise ScenarioError(f"recording {error}") from error
    first = int(np.flatnonzero(flown.armed)[0])
    seconds = flown.time(first)[rows.start - first : rows.stop - first]
    odd = [*log.notes, *filter(None, [asked.note])]
    if asked.level is not None and (angled := float(asked.level[rows].mean())):
        odd.append(f"in {100 * angled:.0f} % of the rows ANGLE or HORIZON mode made the rates, not the stick")
    if lost := int(log.missing[rows][1:].sum()):
        odd.append(f"{lost} rows are missing: the command before them is held")
    throttle = np.zeros(len(log)) if asked.throttle is None else asked.throttle
    if asked.throttle is None:
        odd.append("no throttle was logged: it is flown without")
    notes = [f"{path.name}: {'; '.join(odd)}"] if odd else []
    if count > 1 and number is None:
        notes.append(f"{path.name} holds {count} logs: number {log.number} is flown; {path.name}:1 names one")
    name, since_s = path.stem, float(seconds[0])
    try:
        return Commands(
            name, seconds - since_s, asked.rates[rows], throttle[rows], tuple(notes), rows.start, since_s, cut
        )
    except ScenarioError as error:
        raise ScenarioError(f"{where}: log {log.number}: {str(error).removeprefix(f'{name}: ')}") from error
