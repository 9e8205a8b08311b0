"""Plot of a flight's motors beside what another policy would have answered."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from neuroflight.sim.control.motors import motor_fractions
from neuroflight.sim.plotting import INK, MOTOR_COLOURS, MUTED, dress, legend_above, titled_figure
from neuroflight.sim.replay.inputs import Answers, Flight
from neuroflight.sim.replay.other_policy import Opinion

POINTS_MAX = 4000  # of a line: more than the figure has pixels
COLUMNS = 2


def draw_opinion(flight: Flight, answers: Answers, opinion: Opinion, title: str) -> Figure:
    """Draw a panel for each motor with both answers; below, the motors' largest difference."""
    motors = flight.motor_count
    rows = -(-motors // COLUMNS)
    figure = titled_figure((12, 2.2 * rows + 2.6), title)
    grid = figure.add_gridspec(rows + 1, COLUMNS)
    every = max(1, len(flight) // POINTS_MAX)
    t = flight.t[::every]
    logged, answered = (motor_fractions(dshot) for dshot in (flight.answers.dshot, answers.dshot))
    first = None
    for motor in range(motors):
        panel = figure.add_subplot(grid[motor // COLUMNS, motor % COLUMNS], sharex=first, sharey=first)
        first = first or panel
        panel.plot(
            t, 100 * answered[::every, motor], color=MOTOR_COLOURS[motor], lw=0.9, label="other policy"
        )
        panel.plot(t, 100 * logged[::every, motor], color=INK, lw=0.7, alpha=0.75, label="flown")
        dress(panel, f"motor {motor + 1}: {100 * opinion.mean[motor]:.2f} % apart on average")
        if motor % COLUMNS == 0:
            panel.set_ylabel("motor, %", color=INK)
        if motor < COLUMNS:
            legend_above(panel)
    below = figure.add_subplot(grid[rows, :], sharex=first)
    both = (flight.answers.dshot > 0).any(axis=1) & (answers.dshot > 0).any(axis=1)
    apart = 100 * np.abs(logged - answered).max(axis=1)
    starts = np.arange(0, len(flight), every)
    below.plot(t, np.maximum.reduceat(np.where(both, apart, 0.0), starts), color=MUTED, lw=0.9)
    dress(below, f"largest difference of a motor; {100 * opinion.share:.1f} % of the steps differ")
    below.set_ylabel("motor, %", color=INK)
    below.set_xlabel("time, s", color=INK)
    below.set_ylim(bottom=0)
    return figure
