"""Plot of suite `power`: current disarmed and idling, and error against current in flight."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from neuroflight.sim.analysis.confidence import Mean
from neuroflight.sim.plotting import INK, MUTED, dress, line_colour, titled_figure
from neuroflight.training.evaluation.power import Draw, Drawn


def draw_power(still: Draw, drawn: Sequence[Drawn], title: str) -> Figure:
    """Draw bars of current on the ground; of flights, the errors against the current beside them."""
    flew = any(each.flown for each in drawn)
    figure = titled_figure((12.0 if flew else 6.5, 4.8), title)
    panels = figure.subplots(1, 2 if flew else 1, squeeze=False)[0]
    _bars(panels[0], still, drawn)
    if flew:
        _errors(panels[1], drawn)
    return figure


def _bars(panel: Axes, still: Draw, drawn: Sequence[Drawn]) -> None:
    names = ["disarmed", *(each.controller.label for each in drawn)]
    draws = [still, *(each.idling for each in drawn)]
    amps = [float(each.amps.value) for each in draws]
    colours = [MUTED, *(line_colour(n) for n in range(len(drawn)))]
    margins = [_half(each.amps) for each in draws]
    style = {"ecolor": INK, "elinewidth": 1.2, "capsize": 4}
    bars = panel.bar(names, amps, yerr=margins, color=colours, width=0.6, error_kw=style)
    words = [f"{a:.2f} A\n{float(each.watts.value):.2f} W" for a, each in zip(amps, draws, strict=True)]
    panel.bar_label(bars, labels=words, padding=3, fontsize=9, color=INK)
    panel.set_ylim(0.0, 1.2 * max(a + margin for a, margin in zip(amps, margins, strict=True)))
    panel.set_ylabel("current of the battery, A", color=INK)
    dress(panel, "on the ground: disarmed, and armed with the throttle closed")


def _errors(panel: Axes, drawn: Sequence[Drawn]) -> None:
    for number, each in enumerate(drawn):
        amps = np.array([float(flown.commands.amps.value) for flown in each.flown])
        mae = np.array([float(flown.mae.value) for flown in each.flown])
        panel.errorbar(
            amps,
            mae,
            xerr=[_half(flown.commands.amps) for flown in each.flown],
            yerr=[_half(flown.mae) for flown in each.flown],
            color=line_colour(number),
            marker="o",
            ms=5,
            lw=1.4,
            capsize=3,
            label=each.controller.label,
        )
        for a, error, flown in zip(amps, mae, each.flown, strict=True):
            panel.annotate(
                f"{flown.trim.wanted:g} g",
                (a, error),
                xytext=(5, 5),
                textcoords="offset points",
                fontsize=8,
                color=MUTED,
            )
    panel.set_xlabel("current of the battery, A", color=INK)
    panel.set_ylabel("mean absolute error, deg/s", color=INK)
    panel.legend(frameon=False, fontsize=9)
    dress(panel, "following commands, at equal thrust at rest")


def _half(mean: Mean) -> float:
    return float(mean.high - mean.low) / 2
