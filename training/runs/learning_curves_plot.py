"""Plot of learning curves: a small panel for each configuration, all on the same axes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from neuroflight.sim.plotting import FLIGHT_COLOURS, INK, MOTOR_COLOURS, dress, titled_figure
from neuroflight.training.runs.learning_curves import Curve

COLUMNS = 3
MEAN = FLIGHT_COLOURS[2]
SEED_COLOURS = (*FLIGHT_COLOURS, *MOTOR_COLOURS[4:])
STEPS = ((1_000_000, "million control steps"), (1_000, "thousand control steps"), (1, "control steps"))
ALIKE = 3.0  # runs whose lengths differ by no more than this factor share the axis of steps
ROOM = 0.06  # above and below the curves, of their span
BEGIN = 20  # the first of so many parts of a run
FAR = 3.0  # spans of the rest: a beginning that far below it leaves the picture


def draw_curves(found: Sequence[Curve], title: str, *, episodes: bool = False, seeds: bool = False) -> Figure:
    """Draw mean over seeds, 95 % confidence and trend; the seeds as thin lines, or, with `seeds`, alone.

    episodes: the reward of a whole episode instead of that of a control step.
    """
    columns = min(COLUMNS, len(found))
    rows = -(-len(found) // columns)
    size = (4.0 * columns, 0.9 + 2.6 * rows) if len(found) > 1 else (8.0, 4.6)
    figure = titled_figure(size, title)
    lengths = [float(run.steps[-1]) for curve in found for run in curve.runs]
    alike = max(lengths) <= ALIKE * min(lengths)
    panels = figure.subplots(rows, columns, squeeze=False, sharey=True, sharex=alike)
    low, high = np.inf, -np.inf
    for number, panel in enumerate(panels.flat):
        if number >= len(found):
            panel.set_axis_off()
            continue
        curve = found[number]
        factor = float(curve.episode_steps) if episodes else 1.0
        last = max(lengths) if alike else max(float(run.steps[-1]) for run in curve.runs)
        unit, word = next(each for each in STEPS if last >= each[0])
        for index, run in enumerate(curve.runs):
            colour = SEED_COLOURS[index % len(SEED_COLOURS)] if seeds else INK
            style = {"lw": 1.3, "label": f"seed {run.seed}"} if seeds else {"lw": 0.5, "alpha": 0.35}
            panel.plot(run.steps / unit, factor * run.reward, color=colour, zorder=2, **style)
            low, high = min(low, factor * _lowest(run.reward)), max(high, factor * run.reward.max())
        if not seeds:
            mean, t = curve.reward, curve.steps / unit
            panel.fill_between(
                t, factor * mean.low, factor * mean.high, color=FLIGHT_COLOURS[1], alpha=0.3, lw=0
            )
            panel.plot(t, factor * mean.value, color=MEAN, lw=1.6, zorder=4)
            panel.plot(t, factor * curve.trend, color="black", lw=1.2, zorder=5)
        dress(panel, curve.label)
        panel.set_xlim(0, last / unit)
        if not alike or number + columns >= len(found):
            panel.set_xlabel(word, color=INK)
            panel.tick_params(labelbottom=True)
        if number % columns == 0:
            panel.set_ylabel("reward of an episode" if episodes else "reward of a control step", color=INK)
    # The confidence of few seeds may be far wider than all curves: it is cut rather than the curves shrunk.
    room = ROOM * (high - low) or 1.0
    panels[0, 0].set_ylim(low - room, high + room)
    if seeds:
        panels[0, 0].legend(loc="lower right", frameon=False, fontsize=9, handlelength=1.6)
        return figure
    handles = [
        Line2D([], [], color=MEAN, lw=1.6, label="mean of the seeds"),
        Patch(color=FLIGHT_COLOURS[1], alpha=0.3, label="95 % confidence"),
        Line2D([], [], color="black", lw=1.2, label="parabola through the mean"),
        Line2D([], [], color=INK, lw=0.5, alpha=0.5, label="a seed"),
    ]
    figure.legend(handles=handles, loc="outside lower left", ncols=4, frameon=False, fontsize=9)
    return figure


def _lowest(rewards: NDArray[np.float64]) -> float:
    """Return the lowest reward to be drawn, without a begin that lies far below the rest."""
    rest = rewards[-(-len(rewards) // BEGIN) :]
    if len(rest) and rewards.min() < rest.min() - FAR * (rest.max() - rest.min()):
        return float(rest.min())
    return float(rewards.min())
