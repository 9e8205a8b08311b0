"""Plot of the study of sizes: what a policy gives against what it costs."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator

from neuroflight.sim.plotting import GRID, INK, MOTOR_COLOURS, MUTED, dress, titled_figure
from neuroflight.training.results_page.studies import Point

UNFIT = "#d55e00"  # rim of what is too large for the board
TICKS = [mark * 10.0**power for power in range(1, 6) for mark in (1, 2, 5)]
ROOM = 0.1  # beside the outermost points, of an axis' span


def draw_sizes(drawn: Sequence[Point], title: str) -> Figure:
    """Draw error and change of the motors, a panel each, over the instructions of at least one point."""
    figure = titled_figure((11, 4.8), title)
    error, change = figure.subplots(1, 2, sharex=True)
    _draw(error, drawn, [point.mae for point in drawn], [point.margin for point in drawn])
    _draw(
        change,
        drawn,
        [1e3 * point.change for point in drawn],
        [1e3 * point.change_margin for point in drawn],
    )
    dress(error, "MAE, mean over the thrusts, deg/s")
    dress(change, "abs Δu of the motors in 1 ms, thousandths")
    for panel in (error, change):
        panel.set_xlabel("instructions of policy_step", color=INK)
        panel.set_xscale("log")
        panel.xaxis.set_major_locator(FixedLocator(TICKS))
        panel.xaxis.set_minor_locator(NullLocator())
        panel.xaxis.set_major_formatter("{x:,.0f}")
    low, high = drawn[0].instructions, drawn[-1].instructions
    room = 1.15 * (high / low) ** ROOM
    error.set_xlim(low / room, high * room)
    if any(not point.fits for point in drawn):
        change.scatter([], [], s=60, color="white", edgecolor=UNFIT, lw=1.8, label="too large for the board")
        change.legend(loc="best", fontsize=9, facecolor="white", edgecolor=GRID)
    return figure


def _draw(panel: Axes, drawn: Sequence[Point], values: Sequence[float], margins: Sequence[float]) -> None:
    """Draw dots with bars of 95 % confidence, each with its name beside it, alternately above and below."""
    at = [point.instructions for point in drawn]
    panel.errorbar(at, values, yerr=margins, fmt="none", ecolor=GRID, elinewidth=1.6, zorder=2)
    colour = MOTOR_COLOURS[0]
    fills = [colour if point.fits else "white" for point in drawn]
    rims = [colour if point.fits else UNFIT for point in drawn]
    panel.scatter(at, values, s=60, color=fills, edgecolor=rims, lw=1.8, zorder=3)
    for number, (point, value) in enumerate(zip(drawn, values, strict=True)):
        above = number % 2 == 0
        panel.annotate(
            point.name,
            (point.instructions, value),
            xytext=(0, 9 if above else -9),
            textcoords="offset points",
            ha="center",
            va="bottom" if above else "top",
            fontsize=9,
            color=MUTED,
        )
    low, high = (f(v + s * m for v, m in zip(values, margins, strict=True)) for f, s in ((min, -1), (max, 1)))
    room = ROOM * (high - low) or 0.1 * abs(high) or 1.0
    panel.set_ylim(low - room, high + room)
