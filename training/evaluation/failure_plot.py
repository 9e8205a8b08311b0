"""Plot of suite `failures`: the mean error of each axis over time, a row for each case."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from neuroflight.sim.plotting import FLIGHT_COLOURS, INK, MOTOR_COLOURS, dress, titled_figure
from neuroflight.toolchain.contract import AXES
from neuroflight.training.evaluation.failure import BAND_DEG_S, Failure

FLOOR = 0.1  # [deg/s] of the logarithmic axis
STRIDE_S = 0.01  # between points: the traces are averaged over twice that
BEFORE_S = 0.3  # shown before the change


def draw_failures(results: Sequence[Failure], at_s: float, title: str) -> Figure:
    """Draw error of roll, pitch and yaw against time, all controllers in each panel."""
    cases = [each.case for each in results[0].cases]
    figure = titled_figure((10, 0.8 + 1.5 * len(cases)), title)
    rows = figure.subplots(len(cases), 3, squeeze=False, sharex=True, sharey=True)
    colours = (*FLIGHT_COLOURS, *MOTOR_COLOURS)
    for number, (panels, case) in enumerate(zip(rows, cases, strict=True)):
        for axis, panel in enumerate(panels):
            for result, colour in zip(results, colours, strict=False):
                flown = result.cases[number]
                time = np.arange(len(flown.traces)) * flown.step_s - at_s
                every = max(1, round(STRIDE_S / flown.step_s))
                shown = (time >= -BEFORE_S) & (np.arange(len(time)) % every == 0)
                error = np.maximum(flown.traces[shown, axis], FLOOR)
                panel.semilogy(time[shown], error, color=colour, lw=1.3, label=result.controller.label)
            panel.axvline(0.0, color=INK, lw=0.8)
            panel.axhline(BAND_DEG_S, color=INK, lw=0.7, ls=(0, (4, 3)))
            dress(panel, f"{case.name}: {AXES[axis]}" if axis == 0 else AXES[axis])
        panels[0].set_ylabel("error, deg/s", color=INK, fontsize=9)
    for panel in rows[-1]:
        panel.set_xlabel("time after the change, s", color=INK, fontsize=9)
    rows[0][2].legend(frameon=False, fontsize=8, labelcolor=INK)
    return figure
