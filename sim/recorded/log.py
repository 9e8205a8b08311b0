"""Recorded commands of a blackbox log, Betaflight's or ours: of its armed part."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sim.blackbox.log import Log, list_logs, read_log
from sim.blackbox.units import channels
from sim.recorded.commands import Commands
from sim.recorded.table import STICK_SPAN
from toolchain.contract import CHANNEL_MAX_US, CHANNEL_MIN_US, RATE_FULL_STICK_DEG_S
from toolchain.errors import ScenarioError, TraceError

SUFFIXES = (".bbl", ".bfl", ".txt")
_NUMBERED = re.compile(r"(.+):(\d{1,6})")


def split_number(path: Path) -> tuple[Path, int | None]:
    """FILE:N as the file and the number of its log, from 1; None: the path names none."""
    found = _NUMBERED.fullmatch(str(path))
    if found is None or Path(found[1]).suffix.lower() not in SUFFIXES:
        return path, None
    return Path(found[1]), int(found[2])


def read_commands(path: Path, number: int | None) -> Commands:
    """The commands of log `number` of a file; None: the last that has frames. Raises ScenarioError.

    They are the setpoints from the first armed row to the last.
    """
    where = f"recording {path}"
    try:
        count = len(list_logs(path))
        log = read_log(path, number)
    except TraceError as error:
        raise ScenarioError(f"recording {error}") from error
    told = channels(log)
    armed = np.flatnonzero(told.armed)
    if not len(armed):
        raise ScenarioError(f"{where}: log {log.number} has no armed row: nothing was commanded")
    part = slice(int(armed[0]), int(armed[-1]) + 1)
    notes = [f"{path.name}: {note}" for note in log.notes]
    if count > 1 and number is None:
        notes.append(f"{path.name} holds {count} logs: number {log.number} is flown; {path.name}:1 names one")
    if lost := int(log.missing[part][1:].sum()):
        notes.append(f"{path.name}: {lost} rows are missing: the command before them is held")
    if told.setpoint is None or told.throttle is None:
        rates, throttle = _sticks(log, where)
        notes.append(
            f"{path.name}: no setpoint was logged: the sticks (rcCommand) are flown, "
            f"{RATE_FULL_STICK_DEG_S} deg/s at full stick"
        )
    else:
        rates, throttle = np.rad2deg(told.setpoint.astype(np.float64)), told.throttle.astype(np.float64)
    try:
        return Commands(
            path.stem,
            told.time(part.start)[: part.stop - part.start],
            rates[part],
            throttle[part],
            tuple(notes),
        )
    except ScenarioError as error:
        raise ScenarioError(f"{where}: {str(error).removeprefix(f'{path.stem}: ')}") from error


def _sticks(log: Log, where: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Rates [deg/s] and throttle of the sticks."""
    sticks = log.matrix("rcCommand", 4)
    if sticks is None:
        raise ScenarioError(
            f"{where}: log {log.number} has neither setpoint nor rcCommand: nothing to fly; log one of them"
        )
    fine = 10.0 if log.headers.integer("blackbox_high_resolution", 0) else 1.0
    rates = sticks[:, :3] / fine * (RATE_FULL_STICK_DEG_S / STICK_SPAN)
    return rates, (sticks[:, 3] / fine - CHANNEL_MIN_US) / (CHANNEL_MAX_US - CHANNEL_MIN_US)
