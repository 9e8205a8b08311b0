"""A log as a picture: each axis with what was asked and what the gyro saw, motors, battery, events."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from neuroflight.sim.arrays import Array, Flags, Indices
from neuroflight.sim.blackbox.events import words
from neuroflight.sim.blackbox.log import Log
from neuroflight.sim.blackbox.units import Channels, channels
from neuroflight.sim.plotting import (
    AXIS_COLOURS,
    INK,
    MOTOR_COLOURS,
    MUTED,
    SHADE,
    dress,
    legend_above,
    titled_figure,
)
from neuroflight.toolchain.contract import AXES
from neuroflight.toolchain.errors import TraceError

POINTS_MAX = 4000  # of a line; longer logs are drawn by the least and largest of each stretch
BREAKS_MAX = 300  # places where rows are missing, that break a line
LABELS_MAX = 24  # events that get their name
LABEL_PART = 0.06  # of the width: labels closer than that go one line lower
LABEL_LINES = 3
EVENT_COLOUR, GAP_COLOUR = "#cc79a7", "#f0e442"


@dataclass(frozen=True, eq=False)
class _Picture:
    """The part of a log that is drawn."""

    rows: Flags  # (N,) of the log
    t: Array  # (K,) [s] of these rows
    breaks: Indices  # among these rows, those that others are missing before


def draw_log(log: Log, title: str, start_s: float = 0.0, stop_s: float | None = None) -> Figure:
    """Draw the rows from `start_s` to `stop_s` [s] since the first row.

    Raises TraceError where no row lies there, or nothing that is drawn is in the log.
    """
    told = channels(log)
    t = log.t
    shown = (t >= start_s) & (t <= (np.inf if stop_s is None else stop_s))
    breaks = np.flatnonzero(log.missing[shown][1:]) + 1
    picture = _Picture(shown, t[shown], breaks if len(breaks) < BREAKS_MAX else breaks[:0])
    if not shown.any():
        raise TraceError(
            f"{log.where} has no row from {start_s:g} s to "
            f"{'its end' if stop_s is None else f'{stop_s:g} s'}; it is {log.seconds:.3f} s long"
        )
    wanted = _panels(told)
    if not wanted:
        raise TraceError(f"{log.where} has no setpoint, gyro, motors or battery to draw")
    heights = [3.0 if name in AXES else 2.2 if name == "motors" else 1.5 for name in wanted]
    figure = titled_figure((12, 1.2 + 0.95 * sum(heights)), title, (0.06, 0.08))
    grid = figure.subplots(len(wanted), 1, sharex=True, height_ratios=heights, squeeze=False)
    panels: list[Axes] = list(np.ravel(grid))
    for panel, name in zip(panels, wanted, strict=True):
        if name in AXES:
            _draw_axis(panel, picture, told, AXES.index(name))
        elif name == "motors":
            _draw_motors(panel, picture, told)
        else:
            _draw_battery(panel, picture, told)
        dress(panel, name)
        _mark(panel, log, told, shown)
    if log.missing[shown][1:].any():
        panels[0].plot([], [], color=GAP_COLOUR, alpha=0.6, lw=8, label="rows lost")
    legend_above(panels[0])
    for panel, name in zip(panels[1:], wanted[1:], strict=True):
        if name not in AXES:
            legend_above(panel)
    _name_events(panels[-1], log, shown)
    panels[-1].set_xlabel("time since the log's first row, s", color=INK)
    first, last = float(t[shown][0]), float(t[shown][-1])
    panels[-1].set_xlim(first, last if last > first else first + 1.0)
    figure.align_ylabels(panels)
    return figure


def thinned(t: Array, values: Array, points: int = POINTS_MAX) -> tuple[Array, Array]:
    """Thin a line to `points` points that show every peak: (K,), (K,)."""
    if len(t) <= points:
        return t, values
    count = points // 2
    bounds = np.linspace(0, len(t), count + 1).astype(np.intp)[:-1]
    low, high = np.minimum.reduceat(values, bounds), np.maximum.reduceat(values, bounds)
    return np.repeat(t[bounds], 2), np.column_stack((low, high)).ravel()


def _panels(told: Channels) -> list[str]:
    names = list(AXES) if told.setpoint is not None or told.gyro is not None else []
    if told.motors is not None:
        names.append("motors")
    if told.voltage is not None or told.current is not None:
        names.append("battery")
    return names


def _line(panel: Axes, picture: _Picture, values: NDArray[np.floating], **style: object) -> None:
    """Draw a line that is broken where rows are missing."""
    shown = np.asarray(values[picture.rows], np.float64)
    pieces = [
        thinned(t, part, max(4, POINTS_MAX * len(t) // len(shown)))
        for t, part in zip(np.split(picture.t, picture.breaks), np.split(shown, picture.breaks), strict=True)
    ]
    nothing = np.full(1, np.nan)
    t, line = (np.concatenate([one for piece in pieces for one in (piece[side], nothing)]) for side in (0, 1))
    panel.plot(t, line, **style)  # type: ignore[arg-type]


def _draw_axis(panel: Axes, picture: _Picture, told: Channels, axis: int) -> None:
    if told.gyro is not None:
        gyro = np.rad2deg(told.gyro[:, axis])
        _line(panel, picture, gyro, color=AXIS_COLOURS[axis], lw=1.0, label="gyro", zorder=3)
    if told.setpoint is not None:
        setpoint = np.rad2deg(told.setpoint[:, axis])
        _line(panel, picture, setpoint, color=INK, lw=1.0, ls=(0, (4, 2)), label="setpoint", zorder=4)
    panel.set_ylabel("deg/s", color=INK)
    low, high = panel.get_ylim()
    if high - low < 20:  # noise of an axis at rest is not to fill the panel
        middle = (high + low) / 2
        panel.set_ylim(middle - 10, middle + 10)


def _draw_motors(panel: Axes, picture: _Picture, told: Channels) -> None:
    assert told.motors is not None
    for motor in range(told.motors.shape[1]):
        values = 100 * told.motors[:, motor]
        _line(panel, picture, values, color=MOTOR_COLOURS[motor], lw=0.8, alpha=0.8, label=str(motor + 1))
    panel.set_ylabel("%", color=INK)
    panel.set_ylim(0, 104)


def _draw_battery(panel: Axes, picture: _Picture, told: Channels) -> None:
    if told.voltage is not None:
        _line(panel, picture, told.voltage, color=AXIS_COLOURS[0], lw=1.2, label="V")
        panel.set_ylabel("V", color=INK)
    if told.current is not None:
        right = panel if told.voltage is None else panel.twinx()
        _line(right, picture, told.current, color=AXIS_COLOURS[1], lw=1.0, label="A")
        right.set_ylabel("A", color=INK)
        right.tick_params(colors=INK, labelsize=9)
        for spine in right.spines.values():
            spine.set_visible(False)
        if right is not panel:
            panel.plot([], [], color=AXIS_COLOURS[1], lw=1.0, label="A")


def _mark(panel: Axes, log: Log, told: Channels, shown: Flags) -> None:
    """Shade disarmed and missing rows; draw a line for each event."""
    for start, stop in _runs(~told.armed):
        panel.axvspan(log.t[start], log.t[min(stop, len(log) - 1)], color=SHADE, lw=0, zorder=0)
    for row in np.flatnonzero((log.missing > 0) & shown)[:1000]:
        if row:
            panel.axvspan(log.t[row - 1], log.t[row], color=GAP_COLOUR, alpha=0.6, lw=0, zorder=1)
    for at, _ in _events(log, shown):
        panel.axvline(at, color=EVENT_COLOUR, lw=0.9, ls=":", zorder=2)


def _events(log: Log, shown: Flags) -> list[tuple[float, str]]:
    """Return time and name of each event in the range shown, except the log's end."""
    rows = np.flatnonzero(shown)
    found = []
    for event in log.events:
        row = min(event.row, len(log) - 1)
        if event.name != "end" and rows[0] <= row <= rows[-1]:
            found.append((float(log.t[row]), words(log, event)))
    return found


def _name_events(panel: Axes, log: Log, shown: Flags) -> None:
    """Write the names of events below the lowest panel's axis, close ones in lines of their own."""
    events = _events(log, shown)
    span = max(1e-9, float(np.ptp(log.t[shown])))
    line, last = 0, -np.inf
    for at, name in events[:LABELS_MAX]:
        line = (line + 1) % LABEL_LINES if at - last < LABEL_PART * span else 0
        last = at
        late = at - log.t[shown][0] > 0.85 * span
        panel.annotate(
            name,
            (at, 0),
            xycoords=("data", "axes fraction"),
            xytext=(0, -20 - 11 * line),
            textcoords="offset points",
            ha="right" if late else "left",
            fontsize=8,
            color=MUTED,
            annotation_clip=False,
        )


def _runs(mask: Flags) -> Sequence[tuple[int, int]]:
    """Return first and one past the last index of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False])).astype(np.int8)))
    return [(int(start), int(stop)) for start, stop in edges.reshape(-1, 2)]
