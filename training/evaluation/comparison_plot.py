"""Plot of a comparison: step responses, error over time, spectra and thrust of all controllers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from neuroflight.sim.analysis.response import BAND
from neuroflight.sim.analysis.spectrum_plot import Line, draw_spectra
from neuroflight.sim.plotting import INK, SHADE, dress, line_colour, log_numbers, titled_figure
from neuroflight.toolchain.contract import AXES
from neuroflight.training.evaluation.comparison import Entry
from neuroflight.training.evaluation.thrust import Transparency

ERROR_MIN_DEG_S = 0.1  # lower end of the error axis
EXAMPLES_MAX = 3  # entries whose first command is drawn
EXAMPLE_S = (0.4, 1.2)  # of the episode; pulses begin at 0.5 s


def draw_comparison(entries: Sequence[Entry], title: str, rests: Sequence[Transparency] = ()) -> Figure:
    """Draw median and 90 % of the commands of each entry; the first in front.

    rests: of the same controllers, drawn as thrust and motor fraction against the throttle.
    """
    held = all(len(entry.curves.step_t) for entry in entries)
    shown = [entry for entry in entries if entry.curves.example.motors is not None][:EXAMPLES_MAX]
    rows = 1 + held + bool(rests) + 2 * bool(shown)
    figure = titled_figure((12, 0.6 + 4.0 * rows), title)
    grid = figure.add_gridspec(rows, 3)
    if held:
        first = figure.add_subplot(grid[0, 0])
        others = [figure.add_subplot(grid[0, n], sharex=first, sharey=first) for n in (1, 2)]
        _draw_steps([first, *others], entries)
    _draw_errors(figure.add_subplot(grid[int(held), :2]), entries)
    lines = [
        Line(entry.controller.label, entry.evaluation.spectrum, entry.evaluation.smoothness)
        for entry in entries
    ]
    draw_spectra(figure.add_subplot(grid[int(held), 2]), lines)
    if shown:
        at = 1 + held
        _draw_examples([[figure.add_subplot(grid[at + row, n]) for n in range(3)] for row in (0, 1)], shown)
    if rests:
        _draw_rests(figure.add_subplot(grid[-1, :2]), figure.add_subplot(grid[-1, 2]), rests)
    return figure


def _draw_examples(panels: list[list[Axes]], entries: Sequence[Entry]) -> None:
    """Draw the first command as each entry flew it: rates above, motors below, on the same scales."""
    examples = [entry.curves.example for entry in entries]
    rates = np.concatenate([np.ravel((each.setpoint, each.rate)) for each in examples])
    for n, (rate, motors) in enumerate(zip(*panels, strict=True)):
        if n >= len(entries):
            rate.set_axis_off()
            motors.set_axis_off()
            continue
        entry, example = entries[n], examples[n]
        t = entry.curves.t
        for axis, name in enumerate(AXES):
            colour = line_colour(axis)
            rate.plot(t, example.setpoint[:, axis], color=colour, lw=1.0, ls=(0, (4, 2)))
            rate.plot(t, example.rate[:, axis], color=colour, lw=1.4, label=name)
        if example.motors is not None:
            for motor, fractions in enumerate(example.motors.T):
                motors.plot(t, fractions, color=line_colour(motor), lw=0.9, label=f"motor {motor + 1}")
        dress(rate, f"{entry.controller.label}: first command [deg/s]")
        dress(motors, f"{entry.controller.label}: motors, 0 to 1")
        rate.set_ylim(rates.min() - 10.0, rates.max() + 10.0)
        motors.set_ylim(0, 1)
        motors.set_xlabel("time, s")
        for panel in (rate, motors):
            panel.set_xlim(*EXAMPLE_S)
    for row in panels:
        row[0].legend(loc="center right", frameon=False)


def _draw_rests(thrusts: Axes, motors: Axes, rests: Sequence[Transparency]) -> None:
    for number, each in enumerate(rests):
        throttle = [rest.throttle for rest in each.rests]
        colour, front = line_colour(number), 2 + len(rests) - number
        thrust = [float(rest.thrust.value) for rest in each.rests]
        motor, ideal = [rest.motor for rest in each.rests], [each.ideal(value) for value in throttle]
        label = each.controller.label
        thrusts.plot(throttle, thrust, "o-", color=colour, ms=3, lw=1.7, label=label, zorder=front)
        motors.plot(throttle, motor, "o-", color=colour, ms=3, lw=1.7, zorder=front)
        motors.plot(throttle, ideal, color=colour, lw=1.0, ls=(0, (4, 2)), zorder=front)
    thrusts.axhline(1.0, color=INK, lw=1.0, ls=(0, (4, 2)), zorder=1)
    dress(thrusts, "thrust at rest, of the weight")
    dress(motors, "motors at rest; dashed: transparent")
    for panel in (thrusts, motors):
        panel.set_xlim(0, 1)
        panel.set_ylim(bottom=0)
        panel.set_xlabel("throttle", color=INK)
    thrusts.legend(loc="upper left", frameon=False, fontsize=9, handlelength=1.6)


def _draw_steps(panels: Sequence[Axes], entries: Sequence[Entry]) -> None:
    for axis, (panel, name) in enumerate(zip(panels, AXES, strict=True)):
        panel.axhspan(100 * (1 - BAND), 100 * (1 + BAND), color=SHADE, zorder=0)
        panel.axhline(100, color=INK, lw=1.0, ls=(0, (4, 2)), zorder=1)
        for number, entry in enumerate(entries):
            low, median, high = entry.curves.step[:, axis]
            t, front = 1e3 * entry.curves.step_t, len(entries) - number
            colour = line_colour(number)
            panel.fill_between(t, low, high, color=colour, alpha=0.14, lw=0, zorder=2)
            panel.plot(t, median, color=colour, lw=1.7, label=entry.controller.label, zorder=2 + front)
        dress(panel, name)
        panel.set_xlabel("time since the command, ms", color=INK)
    panels[0].set_ylabel("rate, % of the command", color=INK)
    panels[0].set_xlim(0, 1e3 * float(entries[0].curves.step_t[-1]))
    top = max(float(np.nanmax(entry.curves.step[2], initial=135.0)) for entry in entries)
    panels[0].set_ylim(-15, min(300.0, 1.05 * top))
    panels[-1].legend(loc="lower right", frameon=False, fontsize=9, handlelength=1.6)


def _draw_errors(panel: Axes, entries: Sequence[Entry]) -> None:
    """Draw |error| over an episode; over a flight of a minute, that of its rests, a mark each."""
    flights = entries[0].scores.holding is not None
    for number, entry in enumerate(entries):
        low, median, high = np.maximum(entry.curves.error, ERROR_MIN_DEG_S)
        front, colour = len(entries) - number, line_colour(number)
        t, label = entry.curves.error_t, entry.controller.label
        panel.fill_between(t, low, high, color=colour, alpha=0.14, lw=0, zorder=2)
        mark = "o-" if flights else "-"
        panel.plot(t, median, mark, ms=3, color=colour, lw=1.3, label=label, zorder=2 + front)
    panel.set_yscale("log")
    log_numbers(panel.yaxis)
    panel.set_ylim(bottom=ERROR_MIN_DEG_S)
    panel.set_xlim(0, float(entries[0].curves.t[-1]))
    panel.set_xlabel("age of the flight, s" if flights else "time of the episode, s", color=INK)
    panel.set_ylabel("deg/s", color=INK)
    what = "at rest, mean of the axes: median and 90 % of the flights"
    dress(panel, what if flights else "error, mean of the axes: median and 90 % of the commands")
    panel.legend(loc="upper left" if flights else "upper right", frameon=False, fontsize=9, handlelength=1.6)
