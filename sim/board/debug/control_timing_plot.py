"""Plot of `neuroflight image time IMAGE.bin`: how long each run of the controller and of its task took."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from neuroflight.sim.board.debug.control_timing import TaskCost, Work
from neuroflight.sim.plotting import INK, MOTOR_COLOURS, MUTED, dress, titled_figure
from neuroflight.toolchain.cortex_m7.cycles import CORE_HZ

BINS = 40
RUNS_MIN = 0.8  # where the axis begins: below a single run
COLOURS = {"policy": MOTOR_COLOURS[0], "pid": MOTOR_COLOURS[1], "": MUTED}
LABELS = {"policy": "policy", "pid": "PID", "": "any controller"}
PANELS = (  # in the order of the dissertation's tables 4.4 and 4.5
    (Work.ALGORITHM, False, "control algorithm, disarmed"),
    (Work.ALGORITHM, True, "control algorithm, armed"),
    (Work.TASK, False, "control task, disarmed"),
    (Work.TASK, True, "control task, armed"),
)


def draw_task_costs(costs: Sequence[TaskCost], title: str) -> Figure:
    """Draw a panel for each kind of work, disarmed and armed; one colour a controller."""
    figure = titled_figure((12, 7), title)
    for panel, (work, armed, name) in zip(figure.subplots(2, 2).flat, PANELS, strict=True):
        found = [cost for cost in costs if cost.kind.work is work and cost.kind.armed is armed]
        dress(panel, name)
        if found:
            _histogram(panel, found)
        else:
            words = "never runs: a controller is asked only where motors may turn"
            panel.text(0.5, 0.5, words, ha="center", va="center", color=MUTED, transform=panel.transAxes)
            panel.set_axis_off()
            panel.set_title(name, loc="left", fontsize=11, fontweight="bold", color=INK, pad=4)
    return figure


def _histogram(panel: Axes, costs: Sequence[TaskCost]) -> None:
    priced = all(cost.cycles is not None for cost in costs)
    unit = 1e6 / CORE_HZ if priced else 1.0
    values = [unit * np.array([value for value, _ in cost.spread]) for cost in costs]
    low, high = min(each.min() for each in values), max(each.max() for each in values)
    room = max(0.02 * (high - low), 0.005 * high)
    edges: list[float] = np.linspace(low - room, high + room, BINS + 1).tolist()
    for cost, taken in zip(costs, values, strict=True):
        times = [times for _, times in cost.spread]
        label = (
            f"{LABELS[cost.kind.controller]}: {taken.min():,.1f} to {taken.max():,.1f}, {cost.times:,} runs"
        )
        panel.hist(taken, edges, weights=times, color=COLOURS[cost.kind.controller], alpha=0.75, label=label)
    panel.set_yscale("log")
    panel.set_ylim(bottom=RUNS_MIN)
    panel.set_ylabel("runs", color=INK)
    panel.set_xlabel("predicted µs" if priced else "instructions", color=INK)
    panel.legend(frameon=False, fontsize=9, loc="upper center")
