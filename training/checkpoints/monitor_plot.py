"""Plot of the monitor's metrics over a training run: tracking error, outputs, their change, reward."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from neuroflight.sim.plotting import FLIGHT_COLOURS, INK, MOTOR_COLOURS, dress, log_numbers, titled_figure
from neuroflight.toolchain.errors import TrainingError
from neuroflight.toolchain.files import read_limited
from neuroflight.training.checkpoints.metrics import CheckpointMetrics

FILE_BYTES_MAX = 4 << 20
STEPS = ((1_000_000, "million control steps"), (1_000, "thousand control steps"), (1, "control steps"))


@dataclass(frozen=True)
class Monitored:
    """The monitor's metrics of one run."""

    name: str  # "seed 1"
    history: tuple[CheckpointMetrics, ...]
    chosen_steps: int | None  # of the checkpoint that became policy.onnx
    output: float  # limits of the selection
    change: float


def read_monitor(path: Path) -> Monitored:
    """Read a run's monitor.json. Raises TrainingError if it is none."""
    data = read_limited(path, str(path), FILE_BYTES_MAX, TrainingError)
    try:
        document = json.loads(data)
        return Monitored(
            name=f"seed {int(document['seed'])}",
            history=tuple(CheckpointMetrics.of(metrics) for metrics in document["readings"]),
            chosen_steps=document["chosen_steps"],
            output=float(document["limits"]["output"]),
            change=float(document["limits"]["change"]),
        )
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise TrainingError(f"{path} is no record of a monitor; --resume writes it anew") from error


def draw_monitored(runs: Sequence[Monitored], best: str, title: str) -> Figure:
    """Draw the mean over the monitor's episodes with a band from least to greatest, one line a run.

    best: the name of the run whose chosen checkpoint is policy.onnx. Runs without any metrics are left out;
    ValueError if there is no other.
    """
    runs = [run for run in runs if run.history]
    if not runs:
        raise ValueError("no readings to draw")
    figure = titled_figure((11, 7.5), title, (0.1, 0.1))
    (mae, output), (change, reward) = figure.subplots(2, 2, sharex=True)
    last = max(run.history[-1].steps for run in runs)
    unit, word = next((unit, word) for unit, word in STEPS if last >= unit)
    panels = (
        (mae, "mae", 1.0, "|e|, mean of the axes", "deg/s", None),
        (output, "output", 100.0, "mean output ū; dashed: its limit", "% of full", runs[0].output),
        (change, "change", 100.0, "|Δu| in 1 ms; dashed: its limit", "% of full", runs[0].change),
        (reward, "reward", 1.0, "reward of a control step", "", None),
    )
    for panel, figure_name, factor, name, axis, limit in panels:
        for number, run in enumerate(runs):
            _draw_run(panel, run, figure_name, factor, unit, number, kept=run.name == best)
        if limit is not None:
            panel.axhline(factor * limit, color=INK, lw=1.0, ls=(0, (4, 2)), zorder=1)
        dress(panel, name)
        panel.set_ylabel(axis, color=INK)
        if figure_name != "reward":
            panel.set_yscale("log")
            log_numbers(panel.yaxis)
    for panel in (change, reward):
        panel.set_xlabel(word, color=INK)
        panel.set_xlim(0, 1.03 * last / unit)
    _legend(figure, runs)
    return figure


def _draw_run(
    panel: Axes, run: Monitored, figure_name: str, factor: float, unit: int, number: int, *, kept: bool
) -> None:
    colour = _colour(number)
    steps = np.array([metrics.steps for metrics in run.history]) / unit
    spreads = [getattr(metrics, figure_name) for metrics in run.history]
    mean, least, greatest = (
        factor * np.array([getattr(spread, name) for spread in spreads])
        for name in ("mean", "least", "greatest")
    )
    panel.fill_between(steps, least, greatest, color=colour, alpha=0.15, lw=0)
    panel.plot(steps, mean, color=colour, lw=1.5, marker="o", ms=2.5, zorder=3)
    for index, metrics in enumerate(run.history):
        if metrics.steps == run.chosen_steps:
            face = INK if kept else "white"
            panel.scatter(steps[index], mean[index], s=46, facecolor=face, edgecolor=INK, lw=1.2, zorder=5)


def _legend(figure: Figure, runs: Sequence[Monitored]) -> None:
    handles = [
        Line2D([], [], color=_colour(number), lw=1.5, label=run.name) for number, run in enumerate(runs)
    ]
    marks = [(INK, "policy.onnx"), ("white", "chosen of its seed")]
    for face, label in marks if len(runs) > 1 else marks[:1]:
        mark = Line2D([], [], marker="o", ls="", ms=6, markerfacecolor=face, markeredgecolor=INK, label=label)
        handles.append(mark)
    figure.legend(handles=handles, loc="outside lower left", ncols=8, frameon=False, fontsize=9)


def _colour(number: int) -> str:
    return (*FLIGHT_COLOURS, *MOTOR_COLOURS)[number % (len(FLIGHT_COLOURS) + len(MOTOR_COLOURS))]
