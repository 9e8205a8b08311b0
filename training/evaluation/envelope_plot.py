"""Plot of a flight envelope: the error of each command over its rates, all controllers on one scale."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter
from mpl_toolkits.mplot3d import Axes3D

from neuroflight.sim.plotting import INK, dress, dress_cube, line_colour, titled_figure
from neuroflight.training.evaluation.comparison import Entry
from neuroflight.training.evaluation.envelope import EDGES_DEG_S, Envelope, by_magnitude, envelope

CELL_DEG_S = 150.0  # of the map of |roll| and |pitch|
CELLS = 6  # of each of its axes; larger commands count in the last
MAE_MIN_DEG_S = 0.1  # least end of the scale of colours


def draw_envelope(entries: Sequence[Entry], title: str) -> Figure:
    """Draw commands in three axes, their mean over |roll| and |pitch|, and both figures by magnitude.

    Raises ValueError if a task holds no command for a second.
    """
    found = [envelope(entry) for entry in entries]
    shown = [each for each in found if each is not None]
    if len(shown) < len(entries):
        raise ValueError("an entry without held commands, expected a task that holds them")
    columns = max(2, len(entries))
    figure = titled_figure((1.0 + 4.3 * columns, 13.0), title)
    grid = figure.add_gridspec(3, 2 * columns, height_ratios=(1.15, 1.0, 0.85))
    errors = np.concatenate([each.mae for each in shown])
    low = max(MAE_MIN_DEG_S, float(errors.min()))
    colours = LogNorm(low, max(2.0 * low, float(errors.max())))
    reach = float(max(np.abs(each.commands).max() for each in shown))
    panels: list[Axes] = []
    for number, (entry, each) in enumerate(zip(entries, shown, strict=True)):
        place = slice(2 * number, 2 * number + 2)
        name = (
            f"{entry.controller.label}: MAE {each.mae.mean():.3g} deg/s, held {100 * each.held.mean():.0f} %"
        )
        cube = figure.add_subplot(grid[0, place], projection="3d")
        assert isinstance(cube, Axes3D)
        upper = np.argsort(each.mae)  # the largest last, on top
        points = cube.scatter(
            *each.commands[upper].T, c=each.mae[upper], norm=colours, cmap="viridis", s=9, lw=0, alpha=0.9
        )
        cube.set_title(name, loc="left", fontsize=10, fontweight="bold", color=INK)
        dress_cube(cube, reach)
        panels += [cube, _draw_map(figure.add_subplot(grid[1, place]), each, colours)]
    bar = figure.colorbar(points, ax=panels, shrink=0.6, pad=0.03)
    bar.set_label("mean absolute error of a command, deg/s", color=INK)
    plain = FuncFormatter(lambda value, _: f"{value:g}")
    bar.ax.yaxis.set_major_formatter(plain)
    bar.ax.yaxis.set_minor_formatter(FuncFormatter(lambda value, _: ""))
    below = (figure.add_subplot(grid[2, :columns]), figure.add_subplot(grid[2, columns:]))
    _draw_magnitudes(*below, entries, shown)
    return figure


def _draw_map(panel: Axes, each: Envelope, colours: LogNorm) -> Axes:
    """Draw mean error in cells of |roll| and |pitch|, with the number of commands in each."""
    cells = np.minimum(np.abs(each.commands[:, :2]) // CELL_DEG_S, CELLS - 1).astype(int)
    place = cells[:, 1] * CELLS + cells[:, 0]
    count = np.bincount(place, minlength=CELLS**2)
    mean = np.bincount(place, each.mae, CELLS**2) / np.where(count > 0, count, np.nan)
    edges = CELL_DEG_S * np.arange(CELLS + 1)
    panel.pcolormesh(edges, edges, mean.reshape(CELLS, CELLS), norm=colours, cmap="viridis")
    for cell in np.flatnonzero(count):
        y, x = (CELL_DEG_S * (part + 0.5) for part in divmod(int(cell), CELLS))
        light = colours(mean[cell]) < 0.6
        panel.text(
            x, y, f"{mean[cell]:.3g}", ha="center", va="center", fontsize=8, color="white" if light else INK
        )
    dress(panel, "mean error, deg/s")
    panel.grid(visible=False)
    panel.set_xlabel("|roll|, deg/s", color=INK)
    panel.set_ylabel("|pitch|, deg/s", color=INK)
    return panel


def _draw_magnitudes(errors: Axes, shares: Axes, entries: Sequence[Entry], shown: Sequence[Envelope]) -> None:
    middles = (np.array(EDGES_DEG_S[:-1]) + EDGES_DEG_S[1:]) / 2
    for number, (entry, each) in enumerate(zip(entries, shown, strict=True)):
        _, error, held = by_magnitude(each)
        colour = line_colour(number)
        errors.plot(middles, error, "o-", ms=4, color=colour, label=entry.controller.label)
        shares.plot(middles, 100 * held, "o-", ms=4, color=colour)
    errors.set_ylim(bottom=0)
    shares.set_ylim(0, 102)
    dress(errors, "mean error, deg/s")
    dress(shares, "held from 500 ms on, %")
    for panel in (errors, shares):
        panel.set_xlabel("magnitude of the command, deg/s", color=INK)
    errors.legend(frameon=False, fontsize=9)
