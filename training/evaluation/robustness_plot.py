"""Plot of robustness: the ratio of each case as a dot, and the distribution of the draws."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from neuroflight.sim.plotting import INK, MUTED, SHADE, dress, line_colour, plain_numbers
from neuroflight.training.evaluation.robustness import (
    CASE_RATIO_MAX,
    HIGH,
    HIGH_RATIO_MAX,
    MEDIAN_RATIO_MAX,
    Robustness,
)

RATIO_MIN, RATIO_MAX = 0.5, 20.0  # range of the axis; values outside are drawn at its ends
TICKS = (0.5, 0.7, 1, 1.5, 2, 2.5, 3, 5, 10, 20)
CHANGE_MIN = 1e-5  # lower end of the |delta u| axis
WIDTH, MARGIN, HEAD, ROW, GAP, JOINT = 12.0, 1.6, 0.85, 0.3, 1.05, 2.6  # [in], of figure and panels
LEGEND_COLUMNS = 4
SPREAD = 0.5  # part of a row's height with the dots of all controllers


def draw_robustness(results: Sequence[Robustness], title: str) -> Figure:
    """Draw ratios of the cases, their |delta u| beside them, and below the distribution of the draws."""
    drawn = any(result.joint for result in results)
    rows = len(results[0].cases)
    lines = 1 + (len(results) + 1) // LEGEND_COLUMNS
    below = (GAP + JOINT if drawn else 0.0) + GAP + 0.2 * lines
    height = HEAD + ROW * rows + below
    figure = Figure(figsize=(WIDTH, height))
    figure.suptitle(
        title, x=0.01, y=1 - 0.12 / height, ha="left", va="top", fontsize=15, fontweight="bold", color=INK
    )

    def place(left: float, right: float, top: float, tall: float) -> tuple[float, float, float, float]:
        """Return left, bottom, width, height in parts of the figure, of a panel in inches from its top."""
        return left / WIDTH, 1 - (top + tall) / height, (right - left) / WIDTH, tall / height

    cases = figure.add_axes(place(MARGIN, 8.3, HEAD, ROW * rows))
    _draw_ratios(cases, results)
    # Below the panels: dots may be anywhere in them.
    handles, labels = cases.get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower left", ncols=LEGEND_COLUMNS, frameon=False, fontsize=9)
    _draw_changes(figure.add_axes(place(8.6, WIDTH - 0.2, HEAD, ROW * rows), sharey=cases), results)
    if drawn:
        _draw_joint(figure.add_axes(place(MARGIN, WIDTH - 0.2, HEAD + ROW * rows + GAP, JOINT)), results)
    return figure


def _places(results: Sequence[Robustness], number: int) -> np.ndarray:
    """Return the height of each row's dot of one controller."""
    rows = np.arange(len(results[0].cases), dtype=np.float64)
    middle = (len(results) - 1) / 2
    return rows + SPREAD * (number - middle) / max(len(results), 2)


def _draw_ratios(panel: Axes, results: Sequence[Robustness]) -> None:
    top = max(float(each.ratio.high) for result in results for each in result.cases)
    panel.axvline(1.0, color=MUTED, lw=0.9)
    bar = f"at most {CASE_RATIO_MAX:g}"
    panel.axvline(CASE_RATIO_MAX, color=INK, lw=1.1, ls=(0, (4, 2)), label=bar)
    lost_some = False
    for number, result in enumerate(results):
        y = _places(results, number)
        colour = line_colour(number)
        low, value, high = (
            np.clip([float(getattr(each.ratio, part)) for each in result.cases], RATIO_MIN, RATIO_MAX)
            for part in ("low", "value", "high")
        )
        label = f"{result.controller.label}, nominal {float(result.cases[0].mae.value):.2f} deg/s"
        panel.hlines(y, low, high, color=colour, lw=1.4, alpha=0.6)
        panel.plot(value, y, ls="none", marker="o", ms=6, color=colour, label=label, zorder=3, clip_on=False)
        lost = [n for n, each in enumerate(result.cases) if each.diverged]
        panel.plot(
            value[lost], y[lost], ls="none", marker="x", ms=9, mew=1.6, color=INK, zorder=4, clip_on=False
        )
        lost_some = lost_some or bool(lost)
    if lost_some:
        panel.plot([], [], ls="none", marker="x", ms=8, mew=1.6, color=INK, label="some episodes diverged")
    names = [each.case.name for each in results[0].cases]
    panel.set_yticks(range(len(names)), names)
    panel.set_ylim(len(names) - 0.4, -0.6)
    for row in range(0, len(names), 2):
        panel.axhspan(row - 0.5, row + 0.5, color=SHADE, alpha=0.6, lw=0, zorder=0)
    _scale(panel, max(2.4, min(RATIO_MAX, 1.1 * top)))
    panel.set_xlabel("MAE, as a multiple of the nominal aircraft's", color=INK)
    dress(panel, "one parameter away from the file")


def _draw_changes(panel: Axes, results: Sequence[Robustness]) -> None:
    for number, result in enumerate(results):
        changes = [each.change for each in result.cases]
        colour = line_colour(number)
        panel.plot(changes, _places(results, number), ls="none", marker="o", ms=6, color=colour, zorder=3)
    for row in range(0, len(results[0].cases), 2):
        panel.axhspan(row - 0.5, row + 0.5, color=SHADE, alpha=0.6, lw=0, zorder=0)
    every = [each.change for result in results for each in result.cases]
    low, high = max(CHANGE_MIN, 0.8 * min(every)), max(2 * CHANGE_MIN, 1.25 * max(every))
    panel.set_xscale("log")
    panel.set_xlim(low, high)
    ticks = [digit * 10.0**power for power in range(-5, 1) for digit in (1, 2, 5)]
    _ticks(panel, [tick for tick in ticks if low <= tick <= high])
    panel.set_xlabel("mean |Δu| in 1 ms", color=INK)
    dress(panel, "work of the motors")
    panel.tick_params(labelleft=False)


def _draw_joint(panel: Axes, results: Sequence[Robustness]) -> None:
    """Draw the cumulative distribution of the ratios of the draws."""
    top = 2.6
    for number, result in enumerate(results):
        joint = result.joint
        if joint is None:
            continue
        ratios = np.clip(np.sort(joint.ratios), RATIO_MIN, RATIO_MAX)
        share = 100 * np.arange(1, len(ratios) + 1) / len(ratios)
        colour = line_colour(number)
        lost = f", {joint.diverged} diverged" if joint.diverged else ""
        label = (
            f"{result.controller.label}: median {float(joint.median.value):.2f}, "
            f"95 % within {float(joint.high.value):.2f}{lost}"
        )
        panel.step(ratios, share, where="post", color=colour, lw=1.8, label=label)
        top = max(top, 1.1 * float(ratios[-1]))
    for bar, share_at in ((MEDIAN_RATIO_MAX, 50.0), (HIGH_RATIO_MAX, 100 * HIGH)):
        panel.plot([bar], [share_at], marker="<", ms=9, color=INK, zorder=4)
        panel.annotate(
            f"{share_at:g} % within {bar:g}",
            (bar, share_at),
            xytext=(9, -4),
            textcoords="offset points",
            fontsize=9,
            color=INK,
            bbox={"facecolor": "white", "alpha": 0.8, "edgecolor": "none", "pad": 1},
            zorder=4,
        )
    panel.axvline(1.0, color=MUTED, lw=0.9)
    panel.set_ylim(0, 104)
    _scale(panel, min(RATIO_MAX, top))
    panel.set_xlabel("MAE of a draw, as a multiple of the nominal aircraft's on the same commands", color=INK)
    panel.set_ylabel("% of draws", color=INK)
    count = max(len(result.joint.ratios) for result in results if result.joint)
    dress(panel, f"all parameters drawn at once, {count} aircraft")
    panel.legend(loc="lower right", frameon=False, fontsize=9)


def _scale(panel: Axes, top: float) -> None:
    panel.set_xscale("log")
    panel.set_xlim(RATIO_MIN, top)
    _ticks(panel, [tick for tick in TICKS if tick <= top])


def _ticks(panel: Axes, ticks: Sequence[float]) -> None:
    panel.set_xticks(ticks)
    plain_numbers(panel.xaxis)
    panel.xaxis.set_minor_locator(NullLocator())
