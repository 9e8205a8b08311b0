"""Plot of a sweep: tracking error against the change of outputs, and the cycles of each network."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize, to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter

from neuroflight.sim.plotting import GRID, INK, dress, log_numbers, titled_figure
from neuroflight.training.sweeps.config import Validation, described
from neuroflight.training.sweeps.summary import Configuration, pareto

COSTS = LinearSegmentedColormap.from_list("costs", ("#5fb0e0", "#0072b2", "#12355b"))
UNPRICED = "#6b7480"  # colour of a network with unknown cycles
FRONT = "#d55e00"
LISTED_MAX = 26  # configurations with a line of text; the front's first if there are more
LINE_MAX = 44  # characters of it
WIDE = 6.0  # an axis is logarithmic if its greatest value is more than this times its least


def draw_sweep(found: Sequence[Configuration], title: str, validation: Validation) -> Figure:
    """Draw a large dot for each configuration, joined with small ones for its seeds; colour: cycles."""
    figure = titled_figure((12, 6.8), title, (0.1, 0.1))
    panel, listing = figure.subplots(1, 2, width_ratios=(2.0, 1.0))
    cycles = [c.predicted_cycles for c in found if c.predicted_cycles is not None]
    scale = ScalarMappable(Normalize(min(cycles, default=0.0), max(cycles, default=1.0)), COSTS)
    colours = {c.number: _colour(c, scale) for c in found}
    names = {c.number: str(place) for place, c in enumerate(found, 1)}
    _draw_front(panel, found)
    for layer, configuration in enumerate(sorted(found, key=lambda c: c.front)):
        name, colour = names[configuration.number], colours[configuration.number]
        _draw_configuration(panel, configuration, name, colour, 4.0 + layer / len(found))
    throttle = f", throttle {validation.throttle:g}" if validation.throttle else ""
    dress(panel, f"{validation.episodes} commands of {validation.task}, seed {validation.seed}{throttle}")
    panel.set_xlabel("mean |Δu| in 1 ms, % of the range", color=INK)
    panel.set_ylabel("MAE, deg/s", color=INK)
    for axis, values in (("x", [1e2 * v for v in _seen(found, "change")]), ("y", _seen(found, "mae"))):
        _scale(panel, axis, values)
    _legend(panel, found)
    _list(listing, found, names, colours)
    if len(set(cycles)) > 1:
        bar = figure.colorbar(scale, ax=panel, location="bottom", aspect=50, pad=0.02, fraction=0.04)
        bar.set_label("predicted cycles of a control step", color=INK, fontsize=9)
        bar.outline.set_visible(False)  # type: ignore[operator]
        bar.ax.tick_params(colors=INK, labelsize=9)
        bar.ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}"))
    return figure


def _colour(found: Configuration, scale: ScalarMappable) -> str:
    if found.predicted_cycles is None:
        return UNPRICED
    low, high = scale.get_clim()
    return to_hex(COSTS((found.predicted_cycles - low) / max(high - low, 1.0)))


def _draw_front(panel: Axes, found: Sequence[Configuration]) -> None:
    """Draw the Pareto front of error and change, as a step line."""
    points = np.array([(1e2 * c.change.mean, c.mae.mean) for c in found])
    front = points[pareto(points)]
    front = front[np.argsort(front[:, 0])]
    x = np.concatenate([front[:1, 0], front[:, 0], [10 * points[:, 0].max()]])
    y = np.concatenate([[10 * points[:, 1].max()], front[:, 1], front[-1:, 1]])
    panel.step(x, y, where="post", color=FRONT, lw=1.0, ls=(0, (4, 2)), zorder=1)


def _draw_configuration(panel: Axes, found: Configuration, name: str, colour: str, zorder: float) -> None:
    x, y = 1e2 * found.change.mean, found.mae.mean
    for run in found.runs:
        if run.outcome and len(found.runs) > 1:
            seed = 1e2 * run.outcome.change.mean, run.outcome.mae.mean
            panel.plot([x, seed[0]], [y, seed[1]], color=colour, lw=0.9, alpha=0.7, zorder=2)
            panel.scatter(*seed, s=14, color=colour, lw=0, zorder=3)
    edge, width = (FRONT, 2.0) if found.front else ("white", 0.8)
    panel.scatter([x], [y], s=230, color=colour, edgecolor=edge, lw=width, zorder=zorder)
    panel.annotate(
        name, (x, y), ha="center", va="center", color="white", fontsize=8, zorder=zorder, weight="bold"
    )


def _legend(panel: Axes, found: Sequence[Configuration]) -> None:
    def dot(size: float, edge: str) -> Line2D:
        return Line2D([], [], marker="o", ls="", ms=size, color=UNPRICED, mec=edge, mew=1.6)

    handles = [dot(11, "white"), dot(11, FRONT), Line2D([], [], color=FRONT, lw=1.0, ls=(0, (4, 2)))]
    priced = all(c.predicted_cycles is not None for c in found)
    labels = [
        "configuration",
        "nothing beats it in error, |Δu|" + (" and cycles" if priced else ""),
        "front of error and |Δu|",
    ]
    if any(len(c.runs) > 1 for c in found):
        handles.insert(1, dot(4, UNPRICED))
        labels = ["configuration, mean of its seeds", "a seed", *labels[1:]]
    panel.legend(handles, labels, loc="upper right", fontsize=9, facecolor="white", edgecolor=GRID)


def _list(
    panel: Axes, found: Sequence[Configuration], names: dict[int, str], colours: dict[int, str]
) -> None:
    """Write the list of configurations by number."""
    panel.set_axis_off()
    panel.set_xlim(0, 1)
    chosen = sorted(found, key=lambda c: not c.front)[:LISTED_MAX]
    chosen.sort(key=lambda c: c.number)
    y, step = 1.0, 1.0 / LISTED_MAX
    panel.set_ylim(0, 1.02)
    for configuration in chosen:
        colour = colours[configuration.number]
        edge, width = (FRONT, 1.6) if configuration.front else ("white", 0.8)
        panel.scatter([0.03], [y], s=150, color=colour, edgecolor=edge, lw=width, clip_on=False)
        name = names[configuration.number]
        panel.text(0.03, y, name, ha="center", va="center", color="white", fontsize=7, weight="bold")
        text = textwrap.shorten(described(configuration.varied) or "all runs", LINE_MAX, placeholder=" …")
        panel.text(0.08, y, text, va="center", fontsize=9, color=INK)
        y -= step
    if len(found) > len(chosen):
        panel.text(0.08, y, f"and {len(found) - len(chosen)} more, in sweep.json", fontsize=9, color=INK)


def _seen(found: Sequence[Configuration], name: str) -> list[float]:
    """Return all drawn values of a figure."""
    runs = [getattr(run.outcome, name).mean for c in found for run in c.runs]
    return [*runs, *(getattr(c, name).mean for c in found)]


def _scale(panel: Axes, name: str, values: Sequence[float]) -> None:
    """Set limits with room for the dots; logarithmic with plain numbers where the span is wide."""
    low, high = min(values), max(values)
    if low > 0 and high / low > WIDE:
        room = (high / low) ** 0.08
        panel.set(**{f"{name}scale": "log", f"{name}lim": (low / room, high * room)})
        log_numbers(panel.xaxis if name == "x" else panel.yaxis)
    else:
        room = 0.08 * (high - low) or 0.1 * abs(high) or 1.0
        panel.set(**{f"{name}lim": (low - room, high + room)})
