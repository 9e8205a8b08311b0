"""Lines of numbers that a sensor sends over its serial port.

One line a reading; cells apart by commas, semicolons, tabs or spaces; lines that begin with # are skipped. A
heading line, or `--columns`, names the columns; those not known here are skipped.

    time_s, time_ms, time_us   the sensor's own clock; the last two may begin anew at 2^32
    thrust_n, thrust_raw       thrust [N], or counts of a load cell
    torque_n_m, torque_raw     torque [N m], or counts
    torque_left_raw, torque_right_raw   counts of two cells that share the torque
    rpm, pulses                speed [1/min], or blades counted so far, which may begin anew at 2^16 or 2^32
    pulse_us                   time of the last pulse on the clock of time_us
    volts, amps, temperature_c of the supply and the motor or ESC [V], [A], [deg C]
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

from neuroflight.toolchain.errors import DynoError

TIMES = {"time_s": 1.0, "time_ms": 1e-3, "time_us": 1e-6}  # seconds of one
WRAP = 2.0**32  # at which counters of a microcontroller begin anew
THRUSTS = ("thrust_n", "thrust_raw")
TORQUES = ("torque_n_m", "torque_raw", "torque_left_raw", "torque_right_raw")
SPEEDS = ("rpm", "pulses")
CELLS = ("thrust_raw", "torque_raw", "torque_left_raw", "torque_right_raw")
MONITORED = ("volts", "amps", "temperature_c")
KNOWN = (*TIMES, *THRUSTS, *TORQUES, *SPEEDS, "pulse_us", *MONITORED)

LINE_BYTES_MAX = 512
CELLS_MAX = 64
NUMBER_MAX = 1e15
_APART = re.compile(r"[,;\s]+")


@dataclass(frozen=True)
class Layout:
    """The places of the known columns in a line of `width` cells."""

    names: tuple[str, ...]  # known columns, in the order of the line
    places: tuple[int, ...]
    width: int

    def has(self, name: str) -> bool:
        """Return True if the sensor sends it."""
        return name in self.names

    @property
    def time(self) -> str | None:
        """Column of the sensor's own clock, None without one."""
        return next((name for name in self.names if name in TIMES), None)


@dataclass(frozen=True, slots=True)
class SensorRow:
    """One line: when it was read, and the values of the known columns in the layout's order."""

    arrival: float  # [s], of the host's clock
    values: tuple[float, ...]


def parse_layout(names: Sequence[str]) -> Layout:
    """Find the known columns by their names. Raises DynoError if they are ambiguous or incomplete."""
    given = [name.strip().strip('"').lower() for name in names]
    twice = [name for name in given if name in KNOWN and given.count(name) > 1]
    if twice:
        raise DynoError(f"the sensor's column {twice[0]} stands twice, expected it once; rename one")
    found = tuple((name, place) for place, name in enumerate(given) if name in KNOWN)
    layout = Layout(tuple(name for name, _ in found), tuple(place for _, place in found), len(given))
    _one(layout, tuple(TIMES), needed=False)
    _one(layout, THRUSTS)
    _one(layout, SPEEDS)
    if layout.has("torque_left_raw") != layout.has("torque_right_raw"):
        raise DynoError("one of the columns torque_left_raw and torque_right_raw lacks, expected both")
    _one(layout, TORQUES[:3])
    if layout.has("pulse_us") and not (layout.has("pulses") and layout.has("time_us")):
        raise DynoError("the column pulse_us stands without pulses and time_us, expected all three")
    return layout


def _one(layout: Layout, names: tuple[str, ...], needed: bool = True) -> None:
    there = [name for name in names if layout.has(name)]
    if len(there) > 1:
        raise DynoError(f"the sensor has columns {there[0]} and {there[1]}, expected one of them")
    if needed and not there:
        raise DynoError(
            f"the sensor's columns are {', '.join(layout.names) or 'none that is known'}, expected one of "
            f"{', '.join(names)} too; see docs/guides/dynamometer.md"
        )


class LineReader:
    """A reader from bytes to rows. Lines that are no reading are counted and skipped."""

    def __init__(self, layout: Layout | None = None) -> None:
        """layout: None waits for a heading line."""
        self.layout = layout
        self.bad = 0  # lines that could not be read
        self.headless = 0  # lines of numbers before a heading
        self._rest = b""
        self._torn = True  # the first line may have begun before we listened

    def feed(self, data: bytes, arrival: float) -> list[SensorRow]:
        """Return the rows that `data`, read at `arrival` [s], completes.

        Raises DynoError for a heading line that names too little, or other columns than before.
        """
        *lines, rest = (self._rest + data).replace(b"\r", b"\n").split(b"\n")
        rows = []
        for line in lines:
            torn, self._torn = self._torn, False
            if (row := self._read(line, arrival, torn)) is not None:
                rows.append(row)
        if len(rest) > LINE_BYTES_MAX:  # a line without an end: discard it up to its end
            self.bad += not self._torn
            self._torn, rest = True, b""
        self._rest = rest
        return rows

    def _read(self, line: bytes, arrival: float, torn: bool) -> SensorRow | None:
        text = line.decode("ascii", "replace").strip()
        if not text or text.startswith("#"):
            return None
        cells = _APART.split(text)
        if text[0].isalpha() or text[0] == '"':
            self._head(cells, torn)
            return None
        if self.layout is None:
            self.headless += 1
            return None
        values = _numbers(cells, self.layout) if len(line) <= LINE_BYTES_MAX else None
        if values is None:
            self.bad += not torn
            return None
        return SensorRow(arrival, values)

    def _head(self, cells: list[str], torn: bool) -> None:
        """Process a line that begins with a letter: a heading if it names a column, or noise."""
        if not any(cell.strip('"').lower() in KNOWN for cell in cells) or len(cells) > CELLS_MAX:
            self.bad += not torn
            return
        try:
            layout = parse_layout(cells)
        except DynoError:
            if torn:
                return
            raise
        if self.layout is not None and layout != self.layout:
            raise DynoError(
                f"the sensor's heading names {', '.join(layout.names)}, expected "
                f"{', '.join(self.layout.names)} as before; do not give --columns, or correct them"
            )
        self.layout = layout


def _numbers(cells: list[str], layout: Layout) -> tuple[float, ...] | None:
    """Parse the known columns; None unless the line has as many cells as the heading, all numbers."""
    if len(cells) != layout.width:
        return None
    try:
        values = tuple(float(cells[place]) for place in layout.places)
    except ValueError:
        return None
    return values if all(math.isfinite(value) and abs(value) < NUMBER_MAX for value in values) else None
