"""Plots of `neuroflight aircraft stability`: drift of the links against the rate of the airframe."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import Axes3D

from neuroflight.sim.identification.link_drift import FORMULATIONS, Drift, onset, worst_by_rate
from neuroflight.sim.plotting import AXIS_COLOURS, INK, dress, dress_cube, titled_figure

DRIFT_MIN_M = 1e-17  # what a drift of nothing is drawn as
POINTS = 2500  # samples drawn of each run: enough for a cloud
WIDTH_DEG_S = 50.0  # interval of rates whose largest drift makes the line
MAP_MIN_MM = 1e-3  # the darkest colour of the map: nothing less is told apart
MARKERS = {"reduced": "s", "maximal": "o"}


def draw_drift(runs: Sequence[Drift], title: str) -> Figure:
    """Draw each sample as a dot, the largest drift at each rate as a line; one colour a step."""
    figure = titled_figure((11, 6.2), title)
    panel = figure.subplots()
    steps = sorted({run.step_s for run in runs}, reverse=True)
    for run in runs:
        colour = AXIS_COLOURS[steps.index(run.step_s) % len(AXIS_COLOURS)]
        kept = slice(None, None, max(1, len(run.rate) // POINTS))
        drift_mm = 1e3 * np.maximum(run.drift, DRIFT_MIN_M)
        panel.plot(
            np.rad2deg(run.rate[kept]), drift_mm[kept], ls="", marker=".", ms=2.5, color=colour, alpha=0.15
        )
        rate, worst = worst_by_rate(run, float(np.deg2rad(WIDTH_DEG_S)))
        panel.plot(
            np.rad2deg(rate),
            1e3 * np.maximum(worst, DRIFT_MIN_M),
            color=colour,
            marker=MARKERS[run.formulation],
            ms=4,
            lw=1.4,
            label=f"{run.formulation}, {1e3 * run.step_s:g} ms",
        )
    panel.set_yscale("log")
    panel.set_xlim(0.0, 1.01 * float(np.rad2deg(max(run.rate.max() for run in runs))))
    title = "distance of the propellers from the airframe, change since rest"
    dress(panel, title, "rate of the airframe, deg/s", "drift of a propeller, mm")
    panel.legend(
        loc="center right", frameon=False, fontsize=9.5, ncols=len({run.formulation for run in runs})
    )
    return figure


def draw_map(runs: Sequence[Drift], threshold: float, title: str) -> Figure:
    """Draw rates about the three axes, coloured by separation: a panel for each run, one scale.

    threshold [m]: where the onset is marked.
    """
    rows = [name for name in FORMULATIONS if any(run.formulation == name for run in runs)]
    steps = sorted({run.step_s for run in runs}, reverse=True)
    figure = titled_figure((4.4 * max(len(steps), 2), 0.9 + 4.2 * len(rows)), title)
    reach = float(np.rad2deg(max(np.abs(run.rates).max() for run in runs)))
    most = max(10 * MAP_MIN_MM, *(1e3 * float(run.separation.max()) for run in runs))
    colours = LogNorm(MAP_MIN_MM, most)
    panels = []
    for run in runs:
        place = rows.index(run.formulation) * len(steps) + steps.index(run.step_s) + 1
        panel = figure.add_subplot(len(rows), len(steps), place, projection="3d")
        assert isinstance(panel, Axes3D)
        panels.append(panel)
        kept = slice(None, None, max(1, len(run.rates) // POINTS))
        separation = 1e3 * run.separation[kept]
        upper = np.argsort(separation)  # the largest last, on top
        rates = np.rad2deg(run.rates[kept])[upper]
        shown = panel.scatter(
            *rates.T, c=np.maximum(separation[upper], MAP_MIN_MM), norm=colours, cmap="viridis", s=5, lw=0
        )
        name = f"{run.formulation}, {1e3 * run.step_s:g} ms"
        found = onset(run, threshold)
        if found is None:
            name += f"\nnever above {1e3 * threshold:g} mm"
        else:
            at = np.rad2deg(found.rates)
            panel.scatter(*at, color=AXIS_COLOURS[1], marker="x", s=60, lw=2, depthshade=False)
            name += (
                f"\nabove {1e3 * threshold:g} mm from {' / '.join(f'{rate:z.0f}' for rate in at)} deg/s (x)"
            )
        panel.set_title(name, loc="left", fontsize=10, fontweight="bold", color=INK, pad=0)
        dress_cube(panel, reach)
    bar = figure.colorbar(shown, ax=panels, shrink=0.6, pad=0.06)
    bar.set_label("separation of the links, sum over all pairs, mm", color=INK)
    return figure
