"""Plots of one episode as several controllers flew it: step responses of a command, tracking of many."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from neuroflight.sim.analysis.response import BAND
from neuroflight.sim.plotting import AXIS_COLOURS, INK, SHADE, dress, line_colour, titled_figure
from neuroflight.toolchain.contract import AXES
from neuroflight.training.evaluation.comparison import Example

BEFORE_S, AFTER_S = 0.05, 1.0  # drawn around the begin of a named command
CLOSE_S = 4.0  # of the close-up
CLOSE_FROM = 0.5  # of the episode
LINE_WIDTH = 1.3
DASHES = (0, (4, 2))
MOTORS_NOTE = "motors, 0 to 1 (PWM: 1000 to 2000 µs)"


@dataclass(frozen=True, eq=False)
class Tracked:
    """An episode of one controller."""

    label: str
    t: NDArray[np.float64]  # (T,) [s]
    example: Example


def draw_step(flown: Sequence[Tracked], title: str) -> Figure:
    """Draw rates of each axis with the band of 10 % around the command; motors of each below."""
    begin = _begin(flown[0])
    figure = titled_figure((12, 8.2), title)
    grid = figure.add_gridspec(2, 1, height_ratios=(3, 2))
    rates, motors = grid[0].subgridspec(1, len(AXES)), grid[1].subgridspec(1, len(flown))
    for axis, name in enumerate(AXES):
        panel = figure.add_subplot(rates[axis])
        command = float(flown[0].example.setpoint[begin:, axis][0])
        _draw_band(panel, command)
        for number, one in enumerate(flown):
            t = 1e3 * (one.t - one.t[_begin(one)])
            panel.plot(
                t, one.example.rate[:, axis], color=line_colour(number), lw=LINE_WIDTH, label=one.label
            )
        dress(panel, f"{name}, {command:g} deg/s")
        panel.set_xlabel("time since the command, ms", color=INK)
        panel.set_xlim(*_window(flown[0], begin))
    handles = [
        *(
            Line2D([], [], color=line_colour(number), lw=LINE_WIDTH, label=one.label)
            for number, one in enumerate(flown)
        ),
        Line2D([], [], color=INK, lw=1.0, ls=DASHES, label="command"),
        Line2D([], [], color=AXIS_COLOURS[1], lw=1.0, ls=DASHES, label="± 10 % of it"),
    ]
    figure.legend(handles=handles, loc="outside lower left", ncols=6, frameon=False, fontsize=9)
    for number, one in enumerate(flown):
        panel = figure.add_subplot(motors[number])
        t = 1e3 * (one.t - one.t[_begin(one)])
        _draw_motors(panel, t, one)
        dress(panel, one.label)
        panel.set_xlim(*_window(flown[0], begin))
        panel.set_xlabel("time since the command, ms", color=INK)
        if not number:
            panel.set_ylabel(MOTORS_NOTE, color=INK, fontsize=8)
    return figure


def draw_long(flown: Sequence[Tracked], title: str) -> Figure:
    """Draw the whole episode, a row for each axis; a close-up, and each controller's motors in that time."""
    figure = titled_figure((13, 9.0 + 1.4 * len(flown)), title)
    grid = figure.add_gridspec(3 + len(flown), 2, width_ratios=(3, 2))
    last = float(flown[0].t[-1])
    length = min(CLOSE_S, last)
    start = min(CLOSE_FROM * last, last - length)
    for axis, name in enumerate(AXES):
        row = [figure.add_subplot(grid[axis, column]) for column in (0, 1)]
        for panel, (low, high), width in zip(
            row, ((0.0, last), (start, start + length)), (0.7, LINE_WIDTH), strict=True
        ):
            for number, one in enumerate(flown):
                panel.plot(one.t, one.example.rate[:, axis], color=line_colour(number), lw=width, zorder=3)
            setpoint = flown[0].example.setpoint[:, axis]
            panel.plot(flown[0].t, setpoint, color=INK, lw=width, ls=DASHES, zorder=4)
            panel.set_xlim(low, high)
        dress(row[0], f"{name}, deg/s")
        dress(row[1], f"{name}, from {start:.3g} s")
        row[1].sharey(row[0])
    errors = figure.add_subplot(grid[3:, 0])
    for number, one in enumerate(flown):
        error = np.abs(one.example.setpoint - one.example.rate).mean(axis=1)
        mean = np.cumsum(error) / np.arange(1, len(error) + 1)
        errors.plot(
            one.t, mean, color=line_colour(number), lw=LINE_WIDTH, label=f"{one.label}: {mean[-1]:.2f} deg/s"
        )
    dress(errors, "error so far: mean of time and axes, deg/s")
    errors.set_xlim(0.0, last)
    errors.set_ylim(bottom=0.0)
    errors.set_xlabel("time of the episode, s; dashed: commanded", color=INK)
    errors.legend(loc="lower right", frameon=False, fontsize=9, handlelength=1.6)
    for number, one in enumerate(flown):
        panel = figure.add_subplot(grid[3 + number, 1])
        _draw_motors(panel, one.t, one)
        dress(panel, f"{one.label}: motors, of full")
        panel.set_xlim(start, start + length)
        if number == len(flown) - 1:
            panel.set_xlabel("time of the episode, s", color=INK)
    return figure


def _draw_band(panel: Axes, command: float) -> None:
    panel.axhline(command, color=INK, lw=1.0, ls=DASHES, zorder=1)
    if command:
        for part in (1 - BAND, 1 + BAND):
            panel.axhline(part * command, color=AXIS_COLOURS[1], lw=1.0, ls=DASHES, zorder=1)
        panel.axhspan((1 - BAND) * command, (1 + BAND) * command, color=SHADE, zorder=0)


def _draw_motors(panel: Axes, t: NDArray[np.float64], one: Tracked) -> None:
    motors = one.example.motors
    if motors is None:
        panel.text(0.5, 0.5, "not recorded", transform=panel.transAxes, ha="center", color=INK)
        return
    for motor, fractions in enumerate(motors.T):
        colour = line_colour(motor)
        panel.plot(t, fractions, color=colour, lw=0.9, label=f"{motor + 1}")
    panel.set_ylim(0, 1)
    panel.legend(
        loc="upper right", frameon=False, fontsize=8, handlelength=1.0, ncols=len(motors.T), columnspacing=0.8
    )


def _begin(one: Tracked) -> int:
    """Return the first sample with a command."""
    return int((one.example.setpoint != 0.0).any(axis=1).argmax())


def _window(one: Tracked, begin: int) -> tuple[float, float]:
    """Return the drawn times around the begin of the command [ms]."""
    before = min(BEFORE_S, float(one.t[begin]))
    return -1e3 * before, 1e3 * min(AFTER_S, float(one.t[-1] - one.t[begin]))
