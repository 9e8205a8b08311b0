"""Plot of a comparison: step responses, error over time and spectra of all controllers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sim.analysis.response import BAND
from sim.analysis.spectrum_plot import Line, draw_spectra
from sim.plotting import INK, MOTOR_COLOURS, SHADE, dress, plain_numbers, titled_figure
from toolchain.contract import AXES
from training.evaluation.comparison import Entry

ERROR_MIN_DEG_S = 0.1  # lower end of the error axis


def draw(entries: Sequence[Entry], title: str) -> Figure:
    """Median and 90 % of the commands of each entry; the first in front."""
    held = all(len(entry.curves.step_t) for entry in entries)
    figure = titled_figure((12, 8.6 if held else 4.6), title)
    grid = figure.add_gridspec(2 if held else 1, 3)
    if held:
        first = figure.add_subplot(grid[0, 0])
        others = [figure.add_subplot(grid[0, n], sharex=first, sharey=first) for n in (1, 2)]
        _draw_steps([first, *others], entries)
    _draw_errors(figure.add_subplot(grid[-1, :2]), entries)
    lines = [
        Line(entry.controller.label, entry.evaluation.spectrum, entry.evaluation.smoothness)
        for entry in entries
    ]
    draw_spectra(figure.add_subplot(grid[-1, 2]), lines)
    return figure


def _draw_steps(panels: Sequence[Axes], entries: Sequence[Entry]) -> None:
    for axis, (panel, name) in enumerate(zip(panels, AXES, strict=True)):
        panel.axhspan(100 * (1 - BAND), 100 * (1 + BAND), color=SHADE, zorder=0)
        panel.axhline(100, color=INK, lw=1.0, ls=(0, (4, 2)), zorder=1)
        for number, entry in enumerate(entries):
            low, median, high = entry.curves.step[:, axis]
            t, front = 1e3 * entry.curves.step_t, len(entries) - number
            colour = MOTOR_COLOURS[number % len(MOTOR_COLOURS)]
            panel.fill_between(t, low, high, color=colour, alpha=0.14, lw=0, zorder=2)
            panel.plot(t, median, color=colour, lw=1.7, label=entry.controller.label, zorder=2 + front)
        dress(panel, name)
        panel.set_xlabel("time since the command, ms", color=INK)
    panels[0].set_ylabel("rate, % of the command", color=INK)
    panels[0].set_xlim(0, 1e3 * float(entries[0].curves.step_t[-1]))
    top = max(float(np.nanmax(entry.curves.step[2], initial=135.0)) for entry in entries)
    panels[0].set_ylim(-15, min(300.0, 1.05 * top))
    panels[-1].legend(loc="lower right", frameon=False, fontsize=9, handlelength=1.6)


def _draw_errors(panel: Axes, entries: Sequence[Entry]) -> None:
    for number, entry in enumerate(entries):
        low, median, high = np.maximum(entry.curves.error, ERROR_MIN_DEG_S)
        front, colour = len(entries) - number, MOTOR_COLOURS[number % len(MOTOR_COLOURS)]
        panel.fill_between(entry.curves.t, low, high, color=colour, alpha=0.14, lw=0, zorder=2)
        panel.plot(
            entry.curves.t, median, color=colour, lw=1.3, label=entry.controller.label, zorder=2 + front
        )
    panel.set_yscale("log")
    plain_numbers(panel.yaxis)
    panel.set_ylim(bottom=ERROR_MIN_DEG_S)
    panel.set_xlim(0, float(entries[0].curves.t[-1]))
    panel.set_xlabel("time of the episode, s", color=INK)
    panel.set_ylabel("deg/s", color=INK)
    dress(panel, "error, mean of the axes: median and 90 % of the commands")
    panel.legend(loc="upper right", frameon=False, fontsize=9, handlelength=1.6)
