"""Plot of `neuroflight stability`: drift of the links against the rate of the airframe."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from sim.identification.link_drift import Drift, worst_by_rate
from sim.plotting import AXIS_COLOURS, INK, dress, titled_figure

DRIFT_MIN_M = 1e-17  # what a drift of nothing is drawn as
POINTS = 2500  # samples drawn of each run: enough for a cloud
WIDTH_DEG_S = 50.0  # interval of rates whose largest drift makes the line
MARKERS = {"reduced": "s", "maximal": "o"}


def draw(runs: Sequence[Drift], title: str) -> Figure:
    """Each sample as a dot, the largest drift at each rate as a line; one colour a step."""
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
    panel.set_xlabel("rate of the airframe, deg/s", color=INK)
    panel.set_ylabel("drift of a propeller, mm", color=INK)
    dress(panel, "distance of the propellers from the airframe, change since rest")
    panel.legend(
        loc="center right", frameon=False, fontsize=9.5, ncols=len({run.formulation for run in runs})
    )
    return figure
