"""Plot of step responses: all commands of an evaluation, each response in parts of its command."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from neuroflight.sim.analysis.response import (
    BAND,
    LATE_S,
    LATER_S,
    RISE,
    Hold,
    ResponseFigures,
    in_band,
    large,
    progress,
)
from neuroflight.sim.analysis.spectrum_plot import Line, draw_spectra
from neuroflight.sim.arrays import Array, Flags
from neuroflight.sim.plotting import AXIS_COLOURS, INK, MUTED, SHADE, dress, legend_above, titled_figure
from neuroflight.toolchain.contract import AXES

WINDOW_S = 1.0  # the most that is shown of a held command
PERCENTILES = (5, 25, 50, 75, 95)


def draw_response(held: Hold, figures: ResponseFigures, line: Line, title: str) -> Figure:
    """Draw a panel for each axis with median, percentiles, rise and peak; below, the share of commands in the
    band over time, and the spectrum of the motors."""
    figure = titled_figure((12, 8), title)
    grid = figure.add_gridspec(2, 3, height_ratios=(3, 2))
    shown = held.t < WINDOW_S
    part, enough = 100 * progress(held)[:, shown], large(held, figures.floor_deg_s)
    first: Axes | None = None
    for axis, name in enumerate(AXES):
        panel = figure.add_subplot(grid[0, axis], sharex=first, sharey=first)
        first = first or panel
        _draw_axis(panel, 1e3 * held.t[shown], part[enough[:, axis], :, axis], figures, axis)
        dress(panel, name, "time since the command, ms")
    assert first is not None
    first.set_ylabel("rate, % of the command", color=INK)
    first.set_xlim(0, 1e3 * float(held.t[shown][-1] + held.step_s))
    first.set_ylim(-15, max(135.0, _top(part, enough)))
    first.legend(loc="lower right", frameon=False, fontsize=9, handlelength=1.6)
    _draw_band(figure.add_subplot(grid[1, :2]), held, figures, shown)
    draw_spectra(figure.add_subplot(grid[1, 2]), [line])
    return figure


def _draw_axis(panel: Axes, t: Array, part: Array, figures: ResponseFigures, axis: int) -> None:
    """Draw the responses (E, L) of one axis [%] over t [ms]."""
    colour = AXIS_COLOURS[axis]
    panel.axhspan(100 * (1 - BAND), 100 * (1 + BAND), color=SHADE, zorder=0)
    panel.axhline(100, color=INK, lw=1.0, ls=(0, (4, 2)), zorder=2)
    if not len(part):
        panel.text(0.5, 0.5, "no command above the floor", transform=panel.transAxes, ha="center", color=INK)
        return
    lowest, low, median, high, highest = np.percentile(part, PERCENTILES, axis=0)
    panel.fill_between(t, lowest, highest, color=colour, alpha=0.15, lw=0, label="90 % of commands")
    panel.fill_between(t, low, high, color=colour, alpha=0.35, lw=0, label="half of them")
    panel.plot(t, median, color=colour, lw=1.8, label="median", zorder=3)
    for level in RISE:
        if (median >= 100 * level).any():
            at = t[(median >= 100 * level).argmax()]
            panel.plot([at, at], [-15, 100 * level], color=MUTED, lw=0.9, ls=":", zorder=2)
            panel.plot([at], [100 * level], marker="o", ms=4, color=INK, zorder=4)
    crest = int(median.argmax())
    if median[crest] > 100 * (1 + BAND) or (median[crest] > 100 and crest < len(t) // 2):
        panel.plot([t[crest]], [median[crest]], marker="^", ms=6, color=INK, zorder=4)
    lines = [f"success {100 * figures.success.value[axis]:.1f} %"]
    if figures.rise_ms.count[axis]:
        lines.append(f"rise {figures.rise_ms.value[axis]:.1f} ms")
    lines.append(f"peak {figures.peak.value[axis]:.1f} %")
    lines.append(f"n = {len(part)}")
    panel.text(
        0.97,
        0.96,
        "\n".join(lines),
        transform=panel.transAxes,
        ha="right",
        va="top",
        fontsize=10,
        color=INK,
        linespacing=1.4,
        bbox={"facecolor": "white", "alpha": 0.8, "edgecolor": "none"},
        zorder=5,
    )


def _draw_band(panel: Axes, held: Hold, figures: ResponseFigures, shown: Flags) -> None:
    t = 1e3 * held.t[shown]
    floored, bare = (
        100 * in_band(held, floor)[:, shown].mean(axis=0) for floor in (figures.floor_deg_s, 0.0)
    )
    for axis, (name, colour) in enumerate(zip(AXES, AXIS_COLOURS, strict=True)):
        panel.plot(t, floored[:, axis], color=colour, lw=1.8, label=name, zorder=3)
        panel.plot(t, bare[:, axis], color=colour, lw=1.0, ls=(0, (1, 1.2)), zorder=2)
    for mark in (LATE_S, LATER_S):
        panel.axvline(1e3 * mark, color=MUTED, lw=0.9, ls=":")
    panel.plot([], [], color=MUTED, lw=1.0, ls=(0, (1, 1.2)), label="no floor")
    panel.set_xlim(0, float(t[-1]) + 1e3 * held.step_s)
    panel.set_ylim(0, 104)
    dress(
        panel, f"within 10 % or {figures.floor_deg_s:g} deg/s", "time since the command, ms", "% of commands"
    )
    legend_above(panel)


def _top(part: Array, enough: Flags) -> float:
    """Return the upper end of the rates' scale [%]: above nearly every response, three commands at most."""
    tops = [np.percentile(part[enough[:, a], :, a], 95, axis=0).max() for a in range(3) if enough[:, a].any()]
    return min(300.0, 1.06 * float(max(tops, default=0.0)))
