"""Recorded commands from a CSV table: a plain one, or the export of a Betaflight log.

Known columns:

    t_s, roll_deg_s, pitch_deg_s, yaw_deg_s         body frame; `throttle`, 0..1, if there is one
    time (us) | time | time (s), setpoint[0..2]     as blackbox_decode, the Blackbox Explorer and
                                                    `neuroflight log decode` write them; `time` is in us
    rcCommand[0..2]                                 sticks, -500 to 500, where no setpoint was logged
    setpoint[3], 0 to 1000, or rcCommand[3], 1000 to 2000, is the throttle

Other columns are passed over, and so are the lines of settings that the Explorer writes before the heading,
except the one that says that setpoint[0..2] and rcCommand are in tenths.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sim.recorded.commands import ROWS_MAX, Commands
from toolchain.contract import CHANNEL_MAX_US, CHANNEL_MIN_US, RATE_FULL_STICK_DEG_S
from toolchain.errors import ScenarioError

if TYPE_CHECKING:
    from _csv import Reader

FINE = ["blackbox_high_resolution", "1"]  # a setting that the Explorer writes before the heading
HEADING_LINES_MAX = 4096  # of settings before the heading
LOG_TIMES = {"time (us)": 1e-6, "time": 1e-6, "time (s)": 1.0}  # [s] of a column's unit
PLAIN_TIMES = {"t_s": 1.0}
PLAIN = ("roll_deg_s", "pitch_deg_s", "yaw_deg_s")
SETPOINT = tuple(f"setpoint[{axis}]" for axis in range(3))  # [deg/s]
STICKS = tuple(f"rcCommand[{axis}]" for axis in range(3))
KINDS = ((PLAIN, PLAIN_TIMES), (SETPOINT, LOG_TIMES), (STICKS, LOG_TIMES))  # the first that a table has
STICK_SPAN = 500.0  # of rcCommand at full stick
# Column of the throttle: its value at none, and from there to full.
THROTTLES = {
    "throttle": (0.0, 1.0),
    "setpoint[3]": (0.0, 1000.0),
    "rcCommand[3]": (CHANNEL_MIN_US, CHANNEL_MAX_US - CHANNEL_MIN_US),
}
EXPECTED = f"t_s, {', '.join(PLAIN)}, or time (us), setpoint[0], setpoint[1], setpoint[2] of a Betaflight log"


@dataclass(frozen=True)
class _Columns:
    """Which columns of the table are read."""

    time: str
    unit_s: float  # of the time
    rates: tuple[str, ...]
    throttle: str | None
    parts: int = 1  # of a log's units: its numbers are tenths with 10

    @property
    def names(self) -> tuple[str, ...]:
        """All of them, in the order of reading."""
        return (self.time, *self.rates, *([] if self.throttle is None else [self.throttle]))


def parse_table(data: bytes, where: str, name: str) -> Commands:
    """Commands of the bytes of a CSV file; `where` names it in messages. Raises ScenarioError."""
    try:
        rows = csv.reader(io.StringIO(data.decode("utf-8-sig"), newline=""), strict=True)
        heading, columns = _heading(rows, where)
        values = _values(rows, [heading.index(each) for each in columns.names], columns.names, where)
    except (csv.Error, UnicodeDecodeError) as error:
        raise ScenarioError(f"{where}: no table of text and commas: {error}") from error
    if len(values) < 2:
        raise ScenarioError(f"{where}: {len(values)} rows of commands, expected at least 2")
    rates, notes = values[:, 1:4] / columns.parts, tuple[str, ...]()
    if columns.rates == STICKS:
        rates = rates * (RATE_FULL_STICK_DEG_S / STICK_SPAN)
        notes = (
            f"{where}: no column setpoint[0]: the sticks (rcCommand) are flown, "
            f"{RATE_FULL_STICK_DEG_S} deg/s at full stick",
        )
    throttle = np.zeros(len(values))
    if columns.throttle is not None:
        least, span = THROTTLES[columns.throttle]
        parts = columns.parts if columns.throttle.startswith("rcCommand") else 1
        throttle = (values[:, 4] / parts - least) / span
    try:
        return Commands(name, values[:, 0] * columns.unit_s, rates, throttle, notes)
    except ScenarioError as error:
        raise ScenarioError(f"{where}: {str(error).removeprefix(f'{name}: ')}") from error


def _heading(rows: Reader, where: str) -> tuple[list[str], _Columns]:
    """The heading line and the columns to read: the first line that has all of a kind."""
    first: list[str] | None = None
    parts = 1
    for row in rows:
        heading = [cell.strip() for cell in row]
        first = heading if first is None else first
        if (columns := _columns(heading)) is not None:
            twice = [name for name in columns.names if heading.count(name) != 1]
            if twice:
                raise ScenarioError(
                    f"{where}: column {twice[0]} stands {heading.count(twice[0])} times in the heading line, "
                    f"expected once"
                )
            return heading, replace(columns, parts=1 if columns.rates == PLAIN else parts)
        if heading == FINE:
            parts = 10
        if rows.line_num >= HEADING_LINES_MAX:
            break
    told = ", ".join(first or [])[:60]
    raise ScenarioError(f"{where}: no heading line with known columns ({told!r}); expected {EXPECTED}")


def _columns(heading: Sequence[str]) -> _Columns | None:
    """The columns of a heading line; None: it is no heading, or lacks some."""
    throttle = next((name for name in THROTTLES if name in heading), None)
    for rates, times in KINDS:
        time = next((name for name in times if name in heading), None)
        if time is not None and set(rates) <= set(heading):
            return _Columns(time, times[time], rates, throttle)
    return None


def _values(rows: Reader, order: Sequence[int], names: Sequence[str], where: str) -> NDArray[np.float64]:
    """The cells of these columns, (N, len(order))."""
    values: list[list[float]] = []
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
    return np.array(values).reshape(len(values), len(order))
