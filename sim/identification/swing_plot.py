"""Plot of `neuroflight aircraft inertia`: rate and fitted sinusoid of each log, and what is left."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from neuroflight.sim.identification.swing import Swing
from neuroflight.sim.plotting import AXIS_COLOURS, INK, dress, titled_figure
from neuroflight.toolchain.contract import AXES


def draw_swings(swings: Sequence[Swing], title: str) -> Figure:
    """Draw a row for each log: its swing, and the residuals of the fit."""
    figure = titled_figure((11, 0.7 + 2.3 * len(swings)), title)
    for row, swing in zip(figure.subplots(len(swings), 2, squeeze=False), swings, strict=True):
        colour = AXIS_COLOURS[swing.axis]
        row[0].plot(swing.time, np.rad2deg(swing.rate), ".", ms=2, color=colour, label="gyro")
        row[0].plot(swing.time, np.rad2deg(swing.fitted), color=INK, lw=0.8, label="fit")
        dress(row[0], f"{AXES[swing.axis]}: {swing.periods:.0f} periods of {swing.period_s:.4f} s")
        row[0].legend(frameon=False, fontsize=8, labelcolor=INK, loc="upper right")
        row[1].plot(swing.time, np.rad2deg(swing.rate - swing.fitted), ".", ms=2, color=colour)
        dress(row[1], f"what the fit leaves; it explains {100 * swing.explained:.2f} %")
        for panel in row:
            panel.set_xlabel("time, s", color=INK, fontsize=9)
            panel.set_ylabel("deg/s", color=INK, fontsize=9)
    return figure
