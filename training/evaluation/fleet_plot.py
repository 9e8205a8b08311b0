"""Plot of suite `fleet`: each aircraft's ratio of errors to a rival's over the aircraft's authority."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from neuroflight.sim.plotting import INK, MUTED, dress, line_colour, log_numbers, titled_figure
from neuroflight.training.evaluation.fleet.builds import kinds
from neuroflight.training.evaluation.fleet.scaled_pid import authority, reference_authority
from neuroflight.training.evaluation.fleet.standings import MEAN_RATIO_MAX, WORST_RATIO_MAX, Flown
from neuroflight.training.evaluation.fleet.unseen import Unseen

LOW, HIGH = 0.05, 3.0  # of the axis; what lies beyond is drawn at its end
TICKS = (0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 0.9, 1.3, 2.0, 3.0)
LOST_AT = 2.8  # of aircraft that the first controller loses
ACROSS = "authority about roll and pitch, of the NF1's"


def draw_fleet(
    first: Flown, rivals: Mapping[str, Flown], aircraft: Sequence[Unseen], kind: str, title: str
) -> Figure:
    """Draw a panel a rival, a dot an aircraft, a colour a class; below 1 the first controller is better."""
    figure = titled_figure((max(8.0, 5.6 * len(rivals)), 6.4), title)
    panels = figure.subplots(1, max(1, len(rivals)), squeeze=False)[0]
    for panel, (name, rival) in zip(panels, rivals.items(), strict=False):
        _dots(panel, first, rival, aircraft, kind)
        dress(panel, f"MAE over that of {name}", ACROSS, "")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False, fontsize=9)
    return figure


def _dots(panel: Axes, first: Flown, rival: Flown, aircraft: Sequence[Unseen], kind: str) -> None:
    reference = np.array(reference_authority())
    panel.set_xscale("log")
    panel.set_yscale("log")
    for number, of_kind in enumerate(kinds()):
        places, heights, lost = [], [], []
        for one in aircraft:
            own, other = first.get(one.name, {}).get(kind), rival.get(one.name, {}).get(kind)
            if one.build.kind != of_kind or own is None or other is None:
                continue
            where = float((authority(one.truth) / reference)[:2].mean())
            if own.lost:
                lost.append(where)
            elif not other.lost:
                places.append(where)
                heights.append(float(np.clip(own.mae / other.mae, LOW * 1.03, HIGH / 1.03)))
        colour = line_colour(number)
        panel.plot(places, heights, "o", color=colour, markersize=5, alpha=0.8, label=of_kind)
        panel.plot(lost, [LOST_AT] * len(lost), "x", color=colour, markersize=8, markeredgewidth=2)
    panel.axhline(1.0, color=INK, linewidth=1.0)
    for bar, words in ((MEAN_RATIO_MAX, "mean at most"), (WORST_RATIO_MAX, "none above")):
        panel.axhline(bar, color=MUTED, linewidth=1.0, linestyle="--")
        panel.text(
            0.01,
            bar,
            f"{words} {bar:g}",
            transform=panel.get_yaxis_transform(),
            ha="left",
            va="bottom",
            fontsize=8,
            color=MUTED,
        )
    panel.set_ylim(LOW, HIGH)
    panel.set_yticks(TICKS, [f"{tick:g}" for tick in TICKS])
    panel.minorticks_off()
    log_numbers(panel.xaxis)
