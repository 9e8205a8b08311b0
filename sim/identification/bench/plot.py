"""Repeats of an experiment over each other, their mean and its 95 % interval."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from neuroflight.sim.aircraft.model import RPM
from neuroflight.sim.analysis.confidence import Mean, mean_of
from neuroflight.sim.arrays import Array
from neuroflight.sim.identification.dyno.recording import Recording
from neuroflight.sim.plotting import AXIS_COLOURS, INK, dress, legend_above, save_png, titled_figure

GRID_S = 0.02
SHOWN_MAX = 20  # repeats drawn singly
SINGLE, MEAN, THROTTLE = "#8b949e", AXIS_COLOURS[0], AXIS_COLOURS[2]
CHANNELS = (
    ("speed", "rotor speed", "rpm", 1 / RPM),
    ("thrust", "thrust", "N", 1.0),
    ("torque", "torque", "N m", 1.0),
)
TITLES = {"steps": "steps", "ramp": "ramp"}


def save_bench_plot(path: Path, recordings: Mapping[str, Sequence[Recording]], title: str) -> None:
    """Write `draw_bench` as PNG."""
    save_png(path, draw_bench(recordings, title))


def draw_bench(recordings: Mapping[str, Sequence[Recording]], title: str) -> Figure:
    """Draw a column for each experiment, a row for each channel. recordings: repeats of each, one or more."""
    figure = titled_figure((7.0 * len(recordings), 9.5), title, (0.06, 0.08))
    panels = figure.subplots(len(CHANNELS), len(recordings), sharex="col", squeeze=False)
    for column, (kind, group) in enumerate(recordings.items()):
        for row, (name, label, unit, scale) in enumerate(CHANNELS):
            panel = panels[row, column]
            _draw(panel, group, name, scale)
            dress(panel, f"{TITLES[kind]}: {label}", up=unit)
            if row == 0:
                legend_above(panel)
        panels[-1, column].set_xlabel("time, s", color=INK)
    figure.align_ylabels(panels[:, 0])
    return figure


def repeats_at(grid: Array, recordings: Sequence[Recording], name: str) -> Array:
    """Return a channel of each repeat at times since its begin [s], (R, G)."""
    return np.stack([np.interp(grid, item.time - item.time[0], getattr(item, name)) for item in recordings])


def _draw(panel: Axes, recordings: Sequence[Recording], name: str, scale: float) -> None:
    length = min(float(item.time[-1] - item.time[0]) for item in recordings)
    grid: Array = np.arange(int(length / GRID_S) + 1, dtype=np.float64) * GRID_S
    values = scale * repeats_at(grid, recordings, name)
    for index, single in enumerate(values[:SHOWN_MAX]):
        label = f"{len(values)} repeats" if index == 0 else None
        panel.plot(grid, single, color=SINGLE, lw=0.6, alpha=0.5, label=label)
    mean: Mean = mean_of(values, np.ones(values.shape, bool))
    panel.fill_between(grid, mean.low, mean.high, color=MEAN, alpha=0.3, lw=0, label="95 % interval")
    panel.plot(grid, mean.value, color=MEAN, lw=1.2, label="mean")
    throttle = repeats_at(grid, recordings[:1], "throttle")[0]
    beside = panel.twinx()
    beside.plot(grid, 100 * throttle, color=THROTTLE, lw=1.0, ls="--")
    beside.set_ylim(-4, 106)
    beside.set_ylabel("throttle, %", color=THROTTLE)
    panel.set_xlim(0.0, length)
