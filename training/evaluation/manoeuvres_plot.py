"""Plot of manoeuvres: commanded and flown rates of all controllers, a column each, a row for each axis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from neuroflight.sim.flight.manoeuvres import SETTLE_S
from neuroflight.sim.plotting import INK, dress, line_colour, titled_figure
from neuroflight.toolchain.contract import AXES

BEFORE_S = 0.1  # drawn of the hover before the first command


@dataclass(frozen=True, eq=False)
class Shown:
    """One flight of a manoeuvre."""

    manoeuvre: str
    label: str  # of the controller
    t: NDArray[np.float64]  # (T,) [s]
    setpoint: NDArray[np.float64]  # (T, 3) [deg/s]
    rate: NDArray[np.float64]  # (T, 3) [deg/s], true

    @property
    def mae(self) -> float:
        """Mean |error| of the axes behind the first hover [deg/s]."""
        counted = self.t >= SETTLE_S
        return float(np.abs(self.setpoint - self.rate)[counted].mean())


def draw(flights: Sequence[Shown], title: str) -> Figure:
    """Draw the flights from shortly before their first command on; dashed: commanded."""
    names = list(dict.fromkeys(one.manoeuvre for one in flights))
    labels = list(dict.fromkeys(one.label for one in flights))
    figure = titled_figure((6.0 * len(names), 9.0), title)
    panels = figure.subplots(len(AXES), len(names), squeeze=False, sharex="col", sharey=True)
    for column, name in enumerate(names):
        flown = [one for one in flights if one.manoeuvre == name]
        begin = float(flown[0].t[(flown[0].setpoint != 0.0).any(axis=1).argmax()])
        for axis, word in enumerate(AXES):
            panel = panels[axis, column]
            for one in flown:
                colour = line_colour(labels.index(one.label))
                panel.plot(one.t, one.rate[:, axis], color=colour, lw=1.4, zorder=2)
            panel.plot(flown[0].t, flown[0].setpoint[:, axis], color=INK, lw=1.0, ls=(0, (4, 2)), zorder=3)
            panel.set_xlim(begin - BEFORE_S, float(flown[0].t[-1]))
            dress(panel, f"{name}: {word}")
        errors = "; ".join(f"{one.label} {one.mae:.1f}" for one in flown)
        panels[-1, column].set_xlabel(f"time, s; mean error, deg/s: {errors}", color=INK)
    for panel in panels[:, 0]:
        panel.set_ylabel("deg/s", color=INK)
    handles = [
        *(
            Line2D([], [], color=line_colour(number), lw=1.4, label=label)
            for number, label in enumerate(labels)
        ),
        Line2D([], [], color=INK, lw=1.0, ls=(0, (4, 2)), label="commanded"),
    ]
    figure.legend(handles=handles, loc="outside lower left", ncols=6, frameon=False, fontsize=9)
    return figure
