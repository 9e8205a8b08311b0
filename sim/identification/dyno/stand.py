"""Logs of other people's thrust stands, as their programs write them.

A heading names quantities and units (headings.py); it may have lines above it. Logs with a time base that is
dense enough and a throttle become a recording like ours; the others are steady points.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from neuroflight.sim.aircraft.model import RPM
from neuroflight.sim.arrays import Array, Flags
from neuroflight.sim.identification.dyno.headings import (
    FRACTION,
    SHOWN,
    UNITS,
    Heading,
    Quantity,
    known_unit,
    read_heading,
)
from neuroflight.sim.identification.dyno.recording import (
    FILE_BYTES_MAX,
    ROWS_MAX,
    ROWS_MIN,
    Recording,
    is_ours,
    join_runs,
    read_recordings,
)
from neuroflight.sim.identification.recording import is_log
from neuroflight.sim.identification.table import MISSING, Table, find_table, is_number, numbers, read_text
from neuroflight.toolchain.errors import DynoError

POINTS_MIN = 3
APART_MAX_S = 0.1  # longest time between rows that still shows a rotor's response
PULSE_MIN_US, PULSE_MAX_US = 1.0, 20_000.0  # of --esc-us: the shortest of Multishot to the period of 50 Hz
POLES_MAX = 100
FAST = 0.5  # part of the greatest speed: faster rows decide signs and compare speed sensors
AGREE = 0.02  # part by which two sensors of speed may differ
REST = 0.02  # part of the greatest thrust: a tared stand reads less at rest
LEFT_OUT_MAX = 0.1  # part of the rows that a recording may lack


@dataclass(frozen=True)
class Choices:
    """The user's answers to what a log's headings leave open."""

    columns: Mapping[Quantity, str] = field(default_factory=dict)  # headings
    units: Mapping[Quantity, str] = field(default_factory=dict)  # keys of UNITS
    poles: int | None = None  # of the motor, where the log counts electrical turns
    pulse_us: tuple[float, float] | None = None  # of the ESC's signal, at 0 and at full throttle


@dataclass(frozen=True, eq=False)
class Stand:
    """N rows of a stand; thrust and torque are above 0 where the rotor turns.

    Sensors of a stand may be read in turns: thrust and torque are NaN in rows that lack them.
    """

    path: Path
    time: Array | None  # (N,) [s], not always rising; None: the log has no clock
    throttle: Array | None  # (N,) 0..1; None: not logged, or in a unit that is not known
    speed: Array  # (N,) [rad/s]
    thrust: Array  # (N,) [N]
    torque: Array | None  # (N,) [N m]; None: not measured
    notes: tuple[str, ...]  # how columns were read, a line each


def choices(
    columns: Sequence[str], units: Sequence[str], poles: int | None, pulse_us: Sequence[float] | None
) -> Choices:
    """Read the user's QUANTITY=HEADING and QUANTITY=UNIT. Raises DynoError for other text."""
    pairs: list[dict[Quantity, str]] = []
    for option, texts in (("--column", columns), ("--unit", units)):
        found: dict[Quantity, str] = {}
        for text in texts:
            name, equals, value = text.partition("=")
            try:
                quantity = Quantity(name.strip().lower())
            except ValueError:
                quantity = None
            if quantity is None or not equals or not value.strip():
                names = ", ".join(one.value for one in Quantity)
                raise DynoError(f"{option} {text[:60]!r}, expected QUANTITY=... with one of: {names}")
            found[quantity] = value.strip()
        pairs.append(found)
    for quantity, text in pairs[1].items():
        unit = known_unit(quantity, text)
        if unit is None:
            raise DynoError(
                f"--unit {quantity.value}={text[:40]}: unknown; expected one of: {SHOWN[quantity]}, ..."
            )
        pairs[1][quantity] = unit
    if poles is not None and not (2 <= poles <= POLES_MAX and poles % 2 == 0):
        raise DynoError(
            f"--poles {poles}, expected an even number from 2 to {POLES_MAX}: the magnets of the bell"
        )
    if pulse_us is not None:
        low, high = pulse_us
        if not PULSE_MIN_US <= low < high <= PULSE_MAX_US:
            raise DynoError(
                f"--esc-us {low:g} {high:g}, expected the pulse of 0 and a longer one of full throttle, "
                f"{PULSE_MIN_US:g} to {PULSE_MAX_US:g} us"
            )
        pulse_us = (low, high)
    return Choices(pairs[0], pairs[1], poles, pulse_us)


def read_stand(text: str, path: Path, chosen: Choices) -> Stand:
    """Read the text of a log. Raises DynoError naming file, line and how to mend it."""
    named = set(chosen.columns.values())

    def score(cells: Sequence[str]) -> int:
        found = [read_heading(cell) for cell in cells]
        have = {one.quantity for one in found if one} | {
            q for q, text in chosen.columns.items() if text in cells
        }
        return len(have) if {Quantity.THRUST, Quantity.SPEED} <= have else 0

    def keep(name: str) -> bool:
        return name in named or read_heading(name) is not None

    table = find_table(text, score, 2, keep, ROWS_MAX, str(path), DynoError)
    if table is None:
        lines = (line.strip() for line in text.splitlines())
        first = next((line for line in lines if line and not line.startswith("#")), "")
        asked = f", among them {', '.join(sorted(named))}" if named else ""
        raise DynoError(
            f"{path}: no line names a thrust and a speed{asked} (the first is {first[:80]!r}); expected "
            "headings like Time (s), ESC signal (us), Thrust (gf), Torque (N m), Motor Speed (RPM); --column "
            "thrust=HEADING names one"
        )
    table = _units_in_heading(table)
    if not table.rows:
        raise DynoError(f"{path}: no rows below the heading; is the log empty?")
    return _stand(table, _columns(table, path, chosen), path, chosen)


def _units_in_heading(table: Table) -> Table:
    """Return `table` with units from a line below the heading, if there is one, added to the names."""
    known = [at for at, name in enumerate(table.names) if read_heading(name) is not None]
    if not table.rows or any(is_number(table.rows[0][at]) or not table.rows[0][at] for at in known):
        return table
    names = list(table.names)
    for at in known:
        cell = table.rows[0][at].strip("()[] ")
        heading = read_heading(names[at])
        if heading is None or known_unit(heading.quantity, cell) is None:
            return table
        if not heading.shown:
            names[at] = f"{names[at]} ({cell})"
    return Table(table.heading, tuple(names), table.rows[1:], table.lines[1:])


def read_logs(paths: Sequence[Path], chosen: Choices) -> tuple[Recording | None, list[Stand], str]:
    """Read logs of stands, ours or others'.

    Returns the recording of all runs, or None and why there is none; and, unless all logs are ours, the rows
    of each. Raises DynoError naming file, line and how to mend it.
    """
    for path in paths:
        if is_log(path):
            raise DynoError(
                f"{path}: a blackbox log, which has no thrust and no torque; give a thrust stand's log (.csv)"
            )
    texts = [read_text(path, FILE_BYTES_MAX, DynoError) for path in paths]
    if all(is_ours(text) for text in texts):
        return read_recordings(paths), [], ""
    stands = [read_stand(text, path, chosen) for text, path in zip(texts, paths, strict=True)]
    files = []
    for path, stand in zip(paths, stands, strict=True):
        rows, lacks = _run(stand)
        if rows is None:
            reason = f"the response cannot be known: {path.name} {lacks}, its rows are taken as steady points"
            return None, stands, reason
        files.append(rows)
    return join_runs(files), stands, ""


def _run(stand: Stand) -> tuple[Array | None, str]:
    """Return the rows as a run (n, 5) in the order of COLUMNS, or None and what the log lacks for one."""
    if stand.time is None:
        return None, "has no clock"
    torque = stand.torque
    whole = np.isfinite(stand.thrust) if torque is None else np.isfinite(stand.thrust) & np.isfinite(torque)
    # Programs write their first rows while the clock is still being set: drop rows whose time goes back.
    whole[1:] &= stand.time[1:] > np.maximum.accumulate(stand.time)[:-1]
    time = stand.time[whole]
    apart = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
    if apart > APART_MAX_S:
        return None, f"has a row each {apart:.2g} s"
    if stand.throttle is None:
        return None, "has no throttle that is known"
    if len(time) < ROWS_MIN:
        return None, f"has {len(time)} rows with all values and a rising time, fewer than {ROWS_MIN}"
    if whole.mean() < 1.0 - LEFT_OUT_MAX:
        return None, f"lacks values or a rising time in {100 * (1.0 - whole.mean()):.0f} % of its rows"
    columns = (time, stand.throttle[whole], stand.speed[whole] / RPM, stand.thrust[whole])
    return np.column_stack([*columns, np.full(len(time), np.nan) if torque is None else torque[whole]]), ""


def _columns(table: Table, path: Path, chosen: Choices) -> dict[Quantity, list[int]]:
    """Return the columns of each quantity; speed sensors are sorted, the most trusted first."""
    found: dict[Quantity, list[int]] = {}
    headings = [read_heading(name) for name in table.names]
    for quantity in Quantity:
        if (text := chosen.columns.get(quantity)) is not None:
            places = [at for at, name in enumerate(table.names) if name == text]
            if len(places) != 1:
                shown = ", ".join(repr(name) for name in table.heading if name)[:300]
                raise DynoError(
                    f"{path}: --column {quantity.value}={text[:60]}: {len(places)} columns of that name in "
                    f"{shown}"
                )
        else:
            places = [at for at, one in enumerate(headings) if one and one.quantity is quantity]
            known = [at for at in places if _unit(headings[at], quantity, chosen) is not None]
            places = known or places
        if quantity is Quantity.SPEED:
            places.sort(key=lambda at: _belief(headings[at]))
        elif len(places) > 1:
            shown = ", ".join(repr(table.names[at]) for at in places[:6])
            raise DynoError(
                f"{path}: {len(places)} columns may be the {quantity.value}: {shown}; choose by "
                f"--column {quantity.value}={table.names[places[0]]!r}"
            )
        if places:
            found[quantity] = places
    return found


def _belief(heading: Heading | None) -> int:
    """Return a speed sensor's rank: optical ones, which count turns, before those that need the poles."""
    if heading is None:
        return 1
    return 0 if heading.optical else 2 if heading.electrical else 1


def _unit(heading: Heading | None, quantity: Quantity, chosen: Choices) -> str | None:
    told = heading.unit if heading is not None and heading.quantity is quantity else None
    return chosen.units.get(quantity) or told


def _units(table: Table, columns: dict[Quantity, list[int]], path: Path, chosen: Choices) -> dict[int, str]:
    """Return the unit of each column, a key of UNITS. Raises DynoError naming all units that are missing."""
    units: dict[int, str] = {}
    asked: list[str] = []
    for quantity, places in columns.items():
        for at in places:
            heading = read_heading(table.names[at])
            unit = _unit(heading, quantity, chosen)
            shown = heading.shown if heading is not None and heading.quantity is quantity else ""
            if heading is None and unit is None:  # a name of the user's choice may have a unit in brackets
                shown = table.names[at].rpartition("(")[2].rpartition("[")[2].rstrip(")] ")
                shown = "" if shown == table.names[at] else shown
                unit = known_unit(quantity, shown)
            if unit is None and quantity is Quantity.THROTTLE and _in_percent(table, at):
                unit = "%"
            if unit is not None:
                units[at] = unit
            else:
                lacks = f"has a unit that is not known, {shown!r}" if shown else "names no unit"
                asked.append(
                    f"{table.names[at]!r} {lacks}: --unit {quantity.value}=UNIT ({SHOWN[quantity]}, ..)"
                )
    if asked:
        raise DynoError(f"{path}: column {', and '.join(asked)}")
    return units


def _in_percent(table: Table, at: int) -> bool:
    """Return True if every cell of the column ends in a percent sign."""
    cells = [row[at] for row in table.rows if row[at]]
    return bool(cells) and all(cell.endswith("%") for cell in cells)


def _stand(table: Table, columns: dict[Quantity, list[int]], path: Path, chosen: Choices) -> Stand:
    where = str(path)
    notes: list[str] = []
    for quantity in (Quantity.TIME, Quantity.THROTTLE):  # a date, or IDLE: they are not needed
        at = columns.get(quantity, [-1])[0]
        words = [row[at] for row in table.rows if row[at].lower() not in MISSING and not is_number(row[at])]
        if at >= 0 and words:
            notes.append(f"{table.names[at]!r} holds {words[0][:40]!r}: it is left out")
            columns = {other: places for other, places in columns.items() if other is not quantity}
    units = _units(table, columns, path, chosen)
    wanted = [at for places in columns.values() for at in places]
    values = dict(zip(wanted, numbers(table, wanted, where, DynoError).T, strict=True))

    def scaled(quantity: Quantity, at: int) -> Array:
        return np.asarray(values[at] * UNITS[quantity][units[at]])

    speeds = [
        (at, _forward(_turns(table, at, scaled(Quantity.SPEED, at), path, chosen)))
        for at in columns[Quantity.SPEED]
    ]
    speed = _believed(table, speeds, notes)
    thrust = scaled(Quantity.THRUST, columns[Quantity.THRUST][0])
    torque = scaled(Quantity.TORQUE, columns[Quantity.TORQUE][0]) if Quantity.TORQUE in columns else None
    if torque is not None and np.isnan(torque).all():
        torque = None
    throttle = _throttle(table, columns, values, units, path, chosen, notes)
    time = scaled(Quantity.TIME, columns[Quantity.TIME][0]) if Quantity.TIME in columns else None
    if time is not None and np.isnan(time).any():
        notes.append(f"{table.names[columns[Quantity.TIME][0]]!r} has empty cells: rows are taken one by one")
        time = None
    if throttle is not None:  # stands leave it empty while they send nothing
        throttle = np.where(np.isnan(throttle), 0.0, throttle)
    pushing = np.isfinite(speed) & np.isfinite(thrust)
    if not pushing.any():
        raise DynoError(f"{path}: no row has a thrust and a speed; is the log empty?")
    if not (speed[pushing] > 0.0).any():
        raise DynoError(f"{path}: the rotor's speed is 0 in every row; is its sensor connected?")
    kept = np.isfinite(speed)
    fast = kept & (speed > FAST * speed[kept].max())
    thrust = _upright("thrust", thrust, fast, notes)
    if torque is not None:
        torque = _upright("torque", torque, fast, notes)
    rest = thrust[pushing & (speed == 0.0)]
    if len(rest) and abs(float(np.median(rest))) > REST * float(thrust[pushing].max()):
        notes.append(
            f"the stand reads {float(np.median(rest)):.3g} N at rest, over {100 * REST:g} % of the largest "
            "thrust: it was not tared, or it drifts"
        )
    return Stand(
        path=path,
        time=None if time is None else time[kept],
        throttle=None if throttle is None else throttle[kept],
        speed=speed[kept],
        thrust=thrust[kept],
        torque=None if torque is None else torque[kept],
        notes=tuple(notes),
    )


def _turns(table: Table, at: int, speed: Array, path: Path, chosen: Choices) -> Array:
    """Return the rotor's speed from a column that may count electrical turns."""
    heading = read_heading(table.names[at])
    if heading is None or not heading.electrical:
        return speed
    if chosen.poles is not None:
        return speed / (chosen.poles / 2)
    if "erpm" in table.names[at].lower():
        raise DynoError(
            f"{path}: column {table.names[at]!r} counts electrical turns; give the motor's magnets by "
            "--poles, such as 14"
        )
    return speed  # the stand's program divides by the poles it was told


def _forward(speed: Array) -> Array:
    """Return `speed`, positive when fast; taking magnitudes would turn noise around 0 into speed."""
    fast = np.abs(speed) > FAST * np.nanmax(np.abs(speed), initial=0.0)
    return -speed if fast.any() and float(np.median(speed[fast])) < 0.0 else speed


def _believed(table: Table, speeds: Sequence[tuple[int, Array]], notes: list[str]) -> Array:
    """Return the speed of the first sensor that shows rotation, and note how another one differs."""
    turning = [(at, speed) for at, speed in speeds if np.nanmax(speed, initial=0.0) > 0.0]
    if not turning:
        return speeds[0][1]
    at, speed = turning[0]
    if len(speeds) > 1:
        notes.append(f"speed is {table.names[at]!r}")
    for other, values in turning[1:]:
        both = (speed > FAST * np.nanmax(speed)) & (values > 0.0)
        if both.any() and abs((ratio := float(np.median(values[both] / speed[both]))) - 1.0) > AGREE:
            notes.append(
                f"{table.names[other]!r} is {ratio:.3g} times as large; is its number of poles right?"
            )
    return speed


def _upright(name: str, values: Array, fast: Flags, notes: list[str]) -> Array:
    """Return `values` with the sign that makes them positive while the rotor is fast."""
    there = values[fast & np.isfinite(values)]
    if not len(there) or float(np.median(there)) >= 0.0:
        return values
    notes.append(
        f"{name} is below 0 while the rotor turns: its sign is turned, as of a stand mounted the other way"
    )
    return -values


def _throttle(
    table: Table,
    columns: dict[Quantity, list[int]],
    values: Mapping[int, Array],
    units: Mapping[int, str],
    path: Path,
    chosen: Choices,
    notes: list[str],
) -> Array | None:
    if Quantity.THROTTLE not in columns:
        return None
    (at,) = columns[Quantity.THROTTLE]
    unit = units[at]
    factor, throttle = UNITS[Quantity.THROTTLE][unit], values[at]
    if math.isnan(factor):
        if chosen.pulse_us is None:
            notes.append(
                f"{table.names[at]!r} is a pulse: --esc-us 1000 2000, what the ESC takes for 0 and for full "
                "throttle, gives the speed curve"
            )
            return None
        low, high = chosen.pulse_us
        return np.asarray(np.clip((throttle - low) / (high - low), 0.0, 1.0))
    throttle = throttle * factor
    if np.nanmax(throttle, initial=0.0) > 1.1:
        mend = "; is it in percent or microseconds? --unit throttle=% or =us" if unit == FRACTION else ""
        raise DynoError(
            f"{path}: {table.names[at]!r} reaches {np.nanmax(values[at]):g}, expected 0 to "
            f"{1 / factor:g}{mend}"
        )
    return np.asarray(np.clip(throttle, 0.0, 1.0))
