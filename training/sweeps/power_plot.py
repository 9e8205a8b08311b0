"""Plot of a sweep that was flown at equal thrust: tracking error against the current that it takes."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure as Picture

from neuroflight.sim.plotting import FLIGHT_COLOURS, INK, dress, legend_above, titled_figure
from neuroflight.training.sweeps.axes import VARIANT, Varied
from neuroflight.training.sweeps.config import Validation, described, shown
from neuroflight.training.sweeps.summary import Run
from neuroflight.training.sweeps.trial import AtThrust, Figure

MARKERS = "os^Dv<>P"  # one for each thrust
LISTED_MAX = 26  # runs with a line of text


def draw_power(runs: Sequence[Run], title: str, validation: Validation) -> Picture | None:
    """Draw MAE over mean current, a point for each run and thrust; None if no current is known."""
    levels: list[list[tuple[int, AtThrust, Figure]]] = []
    for run in runs:
        for place, each in enumerate(run.outcome.thrusts if run.outcome else ()):
            if each.current is not None:
                levels += [[] for _ in range(place + 1 - len(levels))]
                levels[place].append((run.trial.number, each, each.current))
    if not any(levels):
        return None
    figure = titled_figure((11, 5.6), title, (0.1, 0.1))
    panel, listing = figure.subplots(1, 2, width_ratios=(2.2, 1.0))
    for place, level in enumerate(levels):
        _draw_level(panel, place, level)
    dress(panel, f"{validation.episodes} commands of {validation.task}, seed {validation.seed}")
    panel.set_xlabel("mean current, motors and electronics, A", color=INK)
    panel.set_ylabel("MAE, deg/s", color=INK)
    panel.margins(0.06, 0.08)
    legend_above(panel)
    listing.set_axis_off()
    done = [run for run in runs if run.outcome]
    lines = [f"{run.trial.number}   {_name(run.trial.varied)}" for run in done[:LISTED_MAX]]
    lines += [f"and {len(done) - LISTED_MAX} more, in sweep.json"] if len(done) > LISTED_MAX else []
    listing.text(0.0, 1.0, "\n".join(lines), va="top", fontsize=9, color=INK, linespacing=1.6)
    return figure


def _name(varied: Varied) -> str:
    return shown(varied[VARIANT]) if [*varied] == [VARIANT] else described(varied)


def _draw_level(panel: Axes, place: int, level: Sequence[tuple[int, AtThrust, Figure]]) -> None:
    colour = FLIGHT_COLOURS[place % len(FLIGHT_COLOURS)]
    asked = next((each.asked for _, each, _ in level), None)
    label = "throttle closed" if asked is None else f"thrust {asked:g} times the weight"
    x, y = [current.mean for _, _, current in level], [each.mae.mean for _, each, _ in level]
    panel.scatter(x, y, s=36, marker=MARKERS[place % len(MARKERS)], color=colour, lw=0, label=label)
    for order, (number, each, current) in enumerate(level):
        right = order % 2 == 0  # neighbours would cover each other's numbers
        panel.annotate(
            f"{number}",
            (current.mean, each.mae.mean),
            xytext=(6 if right else -6, 0),
            textcoords="offset points",
            ha="left" if right else "right",
            va="center",
            fontsize=9,
            color=colour,
        )
