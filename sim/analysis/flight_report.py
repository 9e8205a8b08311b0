"""Report of a flight: a plot, a table of figures, and an HTML page with both."""

from __future__ import annotations

import base64
import html
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import ScalarFormatter

from neuroflight.sim.analysis.confidence import Mean
from neuroflight.sim.analysis.holding import DRIFT_S, Holding
from neuroflight.sim.analysis.metrics import FlightFigures
from neuroflight.sim.analysis.response import ResponseFigures
from neuroflight.sim.arrays import Array, Flags
from neuroflight.sim.flight.trace import Trace
from neuroflight.sim.plotting import (
    AXIS_COLOURS,
    FLIGHT_COLOURS,
    INK,
    MOTOR_COLOURS,
    dress,
    legend_above,
    png,
    save_png,
    titled_figure,
)
from neuroflight.toolchain.contract import AXES, MOTOR_PLACES
from neuroflight.toolchain.files import write_text

WINDOW_S = 13.5  # the most a plot shows: three pulses of 4.5 s
SMOOTH_S = 0.020  # of the motors' moving average
STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #22272e }
body { max-width: 62rem; margin: 2rem auto; padding: 0 1rem }
h1 { font-size: 1.5rem; margin-bottom: 0 } p { color: #57606a; margin-top: .25rem }
table { border-collapse: collapse; margin: 1.5rem 0 } img { width: 100% }
th, td { padding: .3rem 1rem .3rem 0; border-bottom: 1px solid #d8dde3; text-align: right }
th:first-child, td:first-child { text-align: left; font-weight: 600 }
td { font-variant-numeric: tabular-nums }
"""


@dataclass(frozen=True)
class Flight:
    """A flown scenario: trace and figures."""

    name: str  # of the controller that flew: "policy nf1", "PID flying"
    trace: Trace
    figures: FlightFigures  # of the time before its hover
    holding: Holding | None = None  # of a flight that ends in a hover
    hover_rows: int = 0  # the rows of that

    @property
    def armed(self) -> float:
        """Part of the flight with the motors armed, 0..1."""
        return float((self.trace.dshot > 0).all(axis=1).mean())


def table(flights: Sequence[Flight]) -> list[tuple[str, ...]]:
    """Return rows of text: a heading, then each figure with a column for each flight; errors by axis."""
    rows: list[tuple[str, ...]] = [("", *(flight.name for flight in flights))]

    def add(label: str, values: Sequence[str]) -> None:
        rows.append((label, *values))

    tracking = [flight.figures.tracking for flight in flights]
    add("MAE, deg/s", [_axes(item.mae, 2) for item in tracking])
    add("  mean of the axes", [f"{item.mae.mean():.2f}" for item in tracking])
    add("  against the gyro", [_axes(flight.figures.gyro_mae, 2) for flight in flights])
    add("MSE, (deg/s)²", [_axes(item.mse, 0) for item in tracking])
    if all(flight.holding for flight in flights):
        _add_holding(add, [flight.holding for flight in flights if flight.holding])
    add("IAE", [_axes(item.iae, 0) for item in tracking])
    add("ISE", [_axes(item.ise, 0) for item in tracking])
    add("ITAE", [_axes(item.itae, 0) for item in tracking])
    add("ITSE", [_axes(item.itse, 0) for item in tracking])
    add("mean output ū", [f"{flight.figures.effort.output:.3f}" for flight in flights])
    add("mean |Δu| in 1 ms", [f"{flight.figures.effort.change:.4f}" for flight in flights])
    if any(flight.figures.response for flight in flights):
        _add_response(add, [flight.figures.response for flight in flights])
    add("armed", [f"{100 * flight.armed:.1f} %" for flight in flights])
    return rows


def _add_holding(add: Callable[[str, Sequence[str]], None], held: Sequence[Holding]) -> None:
    """Add rows about centred sticks: early in the flight, and in the hover at its end."""
    add("rest early, deg/s", [_axes(each.early[0], 2) for each in held])
    add("rest late, deg/s", [_axes(each.hover[0], 2) for each in held])
    add(f"drift in {DRIFT_S:g} s, deg", [_axes(each.drift[0], 1) for each in held])


def _add_response(
    add: Callable[[str, Sequence[str]], None], responses: Sequence[ResponseFigures | None]
) -> None:
    """Add rows about held commands; a dash for a flight that holds none."""
    rows = (
        ("success, %", "success", 100, 1),
        ("in band after 500 ms, %", "in_band_500", 100, 1),
        ("rise, ms", "rise_ms", 1, 1),
        ("peak, %", "peak", 1, 0),
    )
    for label, name, factor, digits in rows:
        means: list[Mean | None] = [getattr(figures, name, None) for figures in responses]
        add(label, [_axes(factor * mean.value, digits) if mean else "-" for mean in means])


def draw_flights(flights: Sequence[Flight], title: str) -> Figure:
    """Draw the rates of each axis, then error and motors of the first flight; WINDOW_S of it at most."""
    figure = titled_figure((11, 11.5), title, (0.06, 0.08))
    panels: list[Axes] = list(
        figure.subplots(5, 1, sharex=True, gridspec_kw={"height_ratios": (3, 3, 3, 2.4, 2.6)})
    )
    shown = flights[0].trace.t < WINDOW_S
    for axis, panel in enumerate(panels[:3]):
        _draw_axis(panel, flights, axis, shown)
    _draw_error(panels[3], flights[0], shown)
    _draw_motors(panels[4], flights[0], shown)
    names = (*AXES, f"error, {flights[0].name}", f"motors, {flights[0].name}")
    for panel, name in zip(panels, names, strict=True):
        dress(panel, name)
    for panel in (panels[0], *panels[3:]):
        legend_above(panel)
    panels[-1].set_xlabel("time since arming, s", color=INK)
    t = flights[0].trace.t[shown]
    panels[-1].set_xlim(0.0, float(t[-1] + t[1]) if len(t) > 1 else 1.0)
    figure.align_ylabels(panels)
    return figure


def save_plot(path: Path, flights: Sequence[Flight], title: str) -> None:
    """Write the plot as PNG."""
    save_png(path, draw_flights(flights, title))


def save_report(path: Path, flights: Sequence[Flight], title: str, note: str) -> None:
    """Write one HTML page with the figures and the plot inside; nothing is loaded from elsewhere."""
    heading, *rows = table(flights)
    picture = base64.b64encode(png(draw_flights(flights, "")))
    write_text(
        path,
        f"<!doctype html>\n<html lang=en><meta charset=utf-8><title>{html.escape(title)}</title>"
        f"<style>{STYLE}</style>\n<h1>{html.escape(title)}</h1>\n<p>{html.escape(note)}</p>\n"
        f"<table>\n{_html_row(heading, 'th')}{''.join(_html_row(row, 'td') for row in rows)}</table>\n"
        f'<img alt="rates, errors and motors over time" src="data:image/png;base64,{picture.decode()}">\n'
        f"<p>Errors are setpoint minus true rate, roll / pitch / yaw, averaged over the episodes of the "
        f"flight. Output and its change are the controller's, before the throttle mix.</p>\n</html>\n",
    )


def _draw_axis(panel: Axes, flights: Sequence[Flight], axis: int, shown: Flags) -> None:
    t = flights[0].trace.t[shown]
    setpoint = np.rad2deg(flights[0].trace.setpoint[shown, axis])
    panel.plot(t, setpoint, color=INK, lw=1.0, ls=(0, (4, 2)), label="setpoint", zorder=4)
    rates = [np.rad2deg(flight.trace.rate[shown, axis]) for flight in flights]
    for number, (flight, rate) in enumerate(zip(flights, rates, strict=True)):
        # The first flight is the main one: thickest, and on top of the others.
        colour, width = FLIGHT_COLOURS[number % len(FLIGHT_COLOURS)], 1.1 if number else 1.7
        panel.plot(t, rate, color=colour, lw=width, label=flight.name, zorder=3 - number / len(flights))
    panel.set_ylabel("deg/s", color=INK)
    low, high = (float(edge([edge(values) for values in (setpoint, *rates)])) for edge in (np.min, np.max))
    margin = 0.08 * max(high - low, 10.0)
    panel.set_ylim(low - margin, high + margin)


def _draw_error(panel: Axes, flight: Flight, shown: Flags) -> None:
    error = np.rad2deg(flight.trace.setpoint[shown] - flight.trace.rate[shown])
    for axis, colour in enumerate(AXIS_COLOURS):
        panel.plot(flight.trace.t[shown], error[:, axis], color=colour, lw=1.0, label=AXES[axis])
    panel.set_ylabel("deg/s", color=INK)
    panel.set_yscale("symlog", linthresh=10, linscale=1.5)
    decades = [sign * 10**power for power in range(1, 5) for sign in (-1, 1)]
    largest = max(20.0, 1.3 * float(np.abs(error).max()))
    panel.set_yticks(sorted({0, -5, 5, *(tick for tick in decades if abs(tick) <= largest)}))
    panel.set_ylim(-largest, largest)
    panel.yaxis.set_major_formatter(ScalarFormatter())
    panel.minorticks_off()


def _draw_motors(panel: Axes, flight: Flight, shown: Flags) -> None:
    """Draw each motor, faint, and its moving average over SMOOTH_S."""
    trace = flight.trace
    width = max(1, round(SMOOTH_S * trace.control_rate_hz))
    for motor in range(trace.motors.shape[1]):
        values, colour = 100 * trace.motors[shown, motor], MOTOR_COLOURS[motor]
        padded = np.pad(values, (width // 2, width - 1 - width // 2), mode="edge")
        smooth = np.convolve(padded, np.full(width, 1 / width), mode="valid")
        panel.plot(trace.t[shown], values, color=colour, lw=0.4, alpha=0.25)
        name = _motor(motor, trace.motors.shape[1])
        panel.plot(trace.t[shown], smooth, color=colour, lw=1.2, label=name, zorder=3)
    panel.set_ylabel("%", color=INK)
    panel.set_ylim(0, 104)


def _motor(index: int, count: int) -> str:
    """Return a motor's number, of a quadcopter with its place."""
    return f"{index + 1} {MOTOR_PLACES[index]}" if count == len(MOTOR_PLACES) else f"motor {index + 1}"


def _axes(values: Array, digits: int) -> str:
    return " / ".join(f"{value:.2e}" if value >= 1e7 else f"{value:,.{digits}f}" for value in values)


def _html_row(cells: Sequence[str], tag: str) -> str:
    return f"<tr>{''.join(f'<{tag}>{html.escape(cell)}</{tag}>' for cell in cells)}</tr>\n"
