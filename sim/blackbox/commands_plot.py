"""Plot of `neuroflight log commands`: each axis' signed histogram with the fitted normal distribution."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.figure import Figure

from neuroflight.sim.blackbox.commands import Commands
from neuroflight.sim.plotting import AXIS_COLOURS, INK, dress, titled_figure
from neuroflight.toolchain.contract import AXES

NORMAL_COLOUR = "#cc0000"
LEAST = 0.5  # samples, where the logarithmic axis begins: a bin of one sample shows


def draw_commands(told: Commands, title: str) -> Figure:
    """Draw a panel for each axis, counts logarithmic, so that the rare large commands are visible."""
    figure = titled_figure((12, 4.2), title, (0.08, 0.1))
    panels = figure.subplots(1, 3, sharey=True)
    signed = told.signed
    for axis, panel in enumerate(panels):
        edges, counts = signed.edges_deg_s[axis], signed.counts[axis]
        panel.stairs(np.maximum(counts, LEAST), edges, baseline=LEAST, fill=True, color=AXIS_COLOURS[axis])
        mean, sigma = float(told.mean[axis]), float(told.axis_sigma[axis])
        if sigma > 0.0:
            at = np.linspace(edges[0], edges[-1], 600)
            peak = told.samples * (edges[1] - edges[0]) / (sigma * math.sqrt(2 * math.pi))
            label = f"normal, mean {mean:.1f}, sigma {sigma:.1f}"
            normal = peak * np.exp(-0.5 * ((at - mean) / sigma) ** 2)
            panel.plot(at, normal, color=NORMAL_COLOUR, lw=1.4, ls=(0, (4, 3)), label=label)
            panel.legend(frameon=False, fontsize=9, labelcolor=INK, loc="upper right")
        panel.set_yscale("log")
        panel.set_xlim(edges[0], edges[-1])
        panel.set_xlabel("command, deg/s", color=INK)
        dress(panel, AXES[axis])
    most = max(1.0, float(signed.counts.max()))
    panels[0].set_ylim(LEAST, 10 * most)  # room for the legends
    panels[0].set_ylabel("samples", color=INK)
    return figure
