"""Recorded commands from a CSV table: a plain one, or the export of a Betaflight log.

Known columns:

    t_s, roll_deg_s, pitch_deg_s, yaw_deg_s         body frame; `throttle`, 0..1, if there is one
    time (us) | time | time (s), setpoint[0..2]     as blackbox_decode, the Blackbox Explorer and
                                                    `neuroflight log decode` write them; `time` is in us
    axisRate[0..2]                                  INAV's setpoint
    rcCommand[0..2]                                 sticks, -500 to 500, where no setpoint was logged
    setpoint[3], 0 to 1000, or rcCommand[3], 1000 to 2000, is the throttle

Other columns are passed over. Settings stand before the heading, as the Explorer writes them, or in the file
NAME.headers.csv beside the table. Those count that say that setpoint[0..2] and rcCommand are in tenths, the
throttle's range, and the rates: sticks are flown by these, held against gyroADC[0..2] if the table has it.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from neuroflight.sim.arrays import Array, Flags
from neuroflight.sim.blackbox.firmware import firmware, has_box_mask
from neuroflight.sim.blackbox.flight import WHOLE, Part
from neuroflight.sim.blackbox.proof import choose
from neuroflight.sim.blackbox.rates import RatesError, readings
from neuroflight.sim.blackbox.scales import fine, gyro_count
from neuroflight.sim.blackbox.sticks import (
    AIRBORNE,
    ANGLE_BITS,
    ANGLE_FLAGS,
    ask_rates,
    is_stick,
    throttle_range,
)
from neuroflight.sim.recorded.commands import ROWS_MAX, Commands, part_of
from neuroflight.toolchain.contract import CHANNEL_MAX_US, CHANNEL_MIN_US
from neuroflight.toolchain.errors import ScenarioError

if TYPE_CHECKING:
    from _csv import Reader

HEADING_LINES_MAX = 4096  # of settings before the heading
LOG_TIMES = {"time (us)": 1e-6, "time": 1e-6, "time (s)": 1.0}  # [s] of a column's unit
PLAIN_TIMES = {"t_s": 1.0}
PLAIN = ("roll_deg_s", "pitch_deg_s", "yaw_deg_s")
SETPOINT, TARGET, STICKS, GYRO = (
    tuple(f"{name}[{axis}]" for axis in range(3)) for name in ("setpoint", "axisRate", "rcCommand", "gyroADC")
)
# The first that a table has.
KINDS = ((PLAIN, PLAIN_TIMES), (SETPOINT, LOG_TIMES), (TARGET, LOG_TIMES), (STICKS, LOG_TIMES))
FLAGS = ("flightModeFlags (flags)", "flightModeFlags")
LEVEL = ("ANGLE", "HORIZON")  # modes in which a stick commands an angle
# Column of the throttle: its value at none and at full.
THROTTLES = {
    "throttle": (0.0, 1.0),
    "setpoint[3]": (0.0, 1000.0),
    "rcCommand[3]": (CHANNEL_MIN_US, CHANNEL_MAX_US),
}

EXPECTED = f"t_s, {', '.join(PLAIN)}, or time (us), setpoint[0], setpoint[1], setpoint[2] of a Betaflight log"


@dataclass(frozen=True)
class _Columns:
    """The columns of the table that are read, and the settings before them."""

    time: str
    unit_s: float  # of the time
    rates: tuple[str, ...]
    throttle: str | None
    gyro: tuple[str, ...]  # beside sticks; () for none
    flags: str | None  # likewise
    settings: Mapping[str, str]

    @property
    def names(self) -> tuple[str, ...]:
        """All that hold numbers, in the order of reading."""
        return (self.time, *self.rates, *([] if self.throttle is None else [self.throttle]), *self.gyro)


def parse_table(
    data: bytes,
    where: str,
    name: str,
    part: Part = WHOLE,
    told: Mapping[str, str] | None = None,
    *,
    cut: bool = False,
    chosen: bool = False,
) -> Commands:
    """Read commands from the bytes of a CSV file; `where` names it in messages. Raises ScenarioError.

    part: the part to read; told: settings of the log that stand elsewhere, by name; cut: see Commands;
    chosen: the user told the rates.
    """
    try:
        rows = csv.reader(io.StringIO(data.decode("utf-8-sig"), newline=""), strict=True)
        heading, columns = _heading(rows, where, told or {})
        values, level = _values(rows, heading, columns, where)
    except (csv.Error, UnicodeDecodeError) as error:
        raise ScenarioError(f"{where}: no table of text and commas: {error}") from error
    if len(values) < 2:
        raise ScenarioError(f"{where}: {len(values)} rows of commands, expected at least 2")
    parts = 1.0 if columns.rates == PLAIN else fine(columns.settings)
    time, rates, notes = values[:, 0] * columns.unit_s, values[:, 1:4] / parts, tuple[str, ...]()
    throttle = np.zeros(len(values))
    if columns.throttle is not None:
        least, most = THROTTLES[columns.throttle]
        counts = values[:, 4] / (parts if columns.throttle == "rcCommand[3]" else 1.0)
        throttle = (counts - least) / (most - least)
        if columns.throttle == "rcCommand[3]":
            low, high = throttle_range(columns.settings, firmware(columns.settings))
            throttle = np.where(
                is_stick(throttle), np.clip((counts - low) / (high - low), 0.0, 1.0), throttle
            )
    if columns.rates != PLAIN and not columns.settings:
        notes = (
            f"{where}: no header of the log above or beside it: rates are taken as whole deg/s; where they "
            "are tenths, add --header blackbox_high_resolution=1",
        )
    if columns.rates == STICKS:
        gyro = values[:, -3:] / parts if columns.gyro else None
        flown = throttle >= AIRBORNE
        rates, note = _by_rates(rates, gyro, flown, time, columns.settings, level, where, told=chosen)
        notes = (f"{where}: {note}",)
    return part_of(where, (time, rates, throttle), part, name, notes, cut=cut)


def _by_rates(
    sticks: Array,
    gyro: Array | None,
    flown: Flags,
    time: Array,
    settings: Mapping[str, str],
    level: Flags,
    where: str,
    *,
    told: bool,
) -> tuple[Array, str]:
    """Return the rates (N, 3) [deg/s] that the settings give the sticks, and a note. Raises ScenarioError.

    gyro (N, 3): its counts; flown (N,): True with thrust; level (N,): True if an angle is commanded;
    told: the user gave the rates.
    """
    whose = firmware(settings)
    count = gyro_count(settings, whose)
    turning = None if gyro is None or count is None else gyro * np.rad2deg(count)
    if level.any():
        row = int(level.argmax())
        raise ScenarioError(
            f"{where}: row {row} ({time[row] - time[0]:.3f} s) and {int(level.sum()) - 1} more command an "
            f"angle ({' or '.join(LEVEL)} mode), expected a rate; delete these rows"
        )
    apart = np.diff(time)
    rate_hz = 1.0 / float(np.median(apart)) if (apart > 0).all() else 0.0
    try:
        chosen, note = choose(readings(settings, whose), sticks, turning, flown, rate_hz, told=told)
    except RatesError as error:
        raise ScenarioError(f"{where}: no column setpoint[0], and {ask_rates(str(error))}") from error
    words = f"no column setpoint[0]: rcCommand is flown by {chosen.name}"
    return chosen.curve(sticks), f"{words}{note and ', '}{note}"


def _heading(rows: Reader, where: str, told: Mapping[str, str]) -> tuple[list[str], _Columns]:
    """Find the heading line, the first with all columns of a kind; return it and the columns to read."""
    first: list[str] | None = None
    settings: dict[str, str] = {}
    for row in rows:
        heading = [cell.strip() for cell in row]
        first = heading if first is None else first
        if (columns := _columns(heading, {**settings, **told})) is not None:
            twice = [name for name in columns.names if heading.count(name) != 1]
            if twice:
                raise ScenarioError(
                    f"{where}: column {twice[0]} stands {heading.count(twice[0])} times in the heading line, "
                    f"expected once"
                )
            return heading, columns
        if len(heading) == 2:
            settings.setdefault(*heading)
        if rows.line_num >= HEADING_LINES_MAX:
            break
    shown = ", ".join(first or [])[:60]
    raise ScenarioError(f"{where}: no heading line with known columns ({shown!r}); expected {EXPECTED}")


def _columns(heading: Sequence[str], settings: Mapping[str, str]) -> _Columns | None:
    """Return the columns of a heading line; None: it is no heading, or lacks some."""
    throttle = next((name for name in THROTTLES if name in heading), None)
    if "gyroScale" in settings:  # as the Explorer calls it
        settings = {"gyro_scale": settings["gyroScale"], **settings}
    for rates, times in KINDS:
        time = next((name for name in times if name in heading), None)
        if time is not None and set(rates) <= set(heading):
            gyro = GYRO if rates == STICKS and set(GYRO) <= set(heading) else ()
            flags = next((name for name in FLAGS if name in heading), None) if rates == STICKS else None
            return _Columns(time, times[time], rates, throttle, gyro, flags, settings)
    return None


def _values(rows: Reader, heading: Sequence[str], columns: _Columns, where: str) -> tuple[Array, Flags]:
    """Return the cells of the number columns (N, ..), and whether a mode flag commands an angle (N,)."""
    names = columns.names
    order = [heading.index(each) for each in names]
    flags = None if columns.flags is None else heading.index(columns.flags)
    bits = ANGLE_BITS if has_box_mask(firmware(columns.settings)) else ANGLE_FLAGS
    values: list[list[float]] = []
    level: list[bool] = []
    for row in rows:
        if not row:
            continue
        if len(values) == ROWS_MAX:
            raise ScenarioError(f"{where}: more than {ROWS_MAX} rows; cut it")
        numbers = []
        for name, index in zip(names, order, strict=True):
            cell = row[index].strip() if index < len(row) else ""
            try:
                number = float(cell)
            except ValueError:
                number = math.nan
            if not math.isfinite(number):
                raise ScenarioError(
                    f"{where}: line {rows.line_num}: {name} is {cell[:40]!r}, expected a number"
                )
            numbers.append(number)
        values.append(numbers)
        modes = row[flags].strip() if flags is not None and flags < len(row) else ""
        level.append(
            bool(int(modes) & bits) if modes.isdecimal() else any(one in LEVEL for one in modes.split("|"))
        )
    return np.array(values).reshape(len(values), len(names)), np.array(level, bool)
