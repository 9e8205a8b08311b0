"""What a flight looks like: a plot, a table of figures, a page that carries both."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from sim.metrics import Figures
from sim.trace import Trace
from toolchain.contract import AXES
from toolchain.files import write_bytes, write_text

WINDOW_S = 13.5  # the most a plot shows: three pulses of 4.5 s
DPI = 130
# Okabe and Ito's palette: told apart in every kind of colour vision.
INK, GRID = "#22272e", "#d8dde3"
FLIGHT_COLOURS = ("#0072b2", "#e69f00", "#cc79a7", "#009e73")
AXIS_COLOURS = ("#0072b2", "#d55e00", "#009e73")
MOTOR_COLOURS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#f0e442", "#000000")
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
    """A flown scenario and what came of it."""

    name: str  # of what flew: "firmware", "PID"
    trace: Trace
    figures: Figures

    @property
    def armed(self) -> float:
        """Part of the flight with the motors armed, 0..1."""
        return float((self.trace.dshot > 0).all(axis=1).mean())


def table(flights: Sequence[Flight]) -> list[tuple[str, ...]]:
    """Rows of text: a heading, then each figure with one column a flight; errors as roll / pitch / yaw."""
    rows: list[tuple[str, ...]] = [("", *(flight.name for flight in flights))]

    def add(label: str, values: Sequence[str]) -> None:
        rows.append((label, *values))

    tracking = [flight.figures.tracking for flight in flights]
    add("MAE, deg/s", [_axes(item.mae, 2) for item in tracking])
    add("  mean of the axes", [f"{item.mae.mean():.2f}" for item in tracking])
    add("  against the gyro", [_axes(flight.figures.gyro_mae, 2) for flight in flights])
    add("MSE, (deg/s)²", [_axes(item.mse, 0) for item in tracking])
    add("IAE", [_axes(item.iae, 0) for item in tracking])
    add("ISE", [_axes(item.ise, 0) for item in tracking])
    add("ITAE", [_axes(item.itae, 0) for item in tracking])
    add("ITSE", [_axes(item.itse, 0) for item in tracking])
    add("mean output ū", [f"{flight.figures.effort.output:.3f}" for flight in flights])
    add("mean |Δu| in 1 ms", [f"{flight.figures.effort.change:.4f}" for flight in flights])
    add("armed", [f"{100 * flight.armed:.1f} %" for flight in flights])
    return rows


def draw(flights: Sequence[Flight], title: str) -> Figure:
    """Rates of each axis, their error, and the motors of the first flight; at most WINDOW_S of it."""
    figure = Figure(figsize=(11, 11), layout="constrained")
    figure.suptitle(title, x=0.012, ha="left", fontsize=15, fontweight="bold", color=INK)
    panels: list[Axes] = list(
        figure.subplots(5, 1, sharex=True, gridspec_kw={"height_ratios": (3, 3, 3, 2.2, 2.6)})
    )
    shown = flights[0].trace.t < WINDOW_S
    for axis, panel in enumerate(panels[:3]):
        _draw_axis(panel, flights, axis, shown)
    _draw_error(panels[3], flights[0], shown)
    _draw_motors(panels[4], flights[0], shown)
    for panel in panels:
        _dress(panel)
    panels[0].legend(loc="upper right", ncols=len(flights) + 1, frameon=False, fontsize=9)
    panels[-1].set_xlabel("time since arming, s", color=INK)
    t = flights[0].trace.t[shown]
    panels[-1].set_xlim(float(t[0]), float(t[-1]) if len(t) > 1 else 1.0)
    figure.align_ylabels(panels)
    return figure


def save_plot(path: Path, flights: Sequence[Flight], title: str) -> None:
    """Write the plot as PNG."""
    write_bytes(path, _png(draw(flights, title)))


def save_report(path: Path, flights: Sequence[Flight], title: str, note: str) -> None:
    """Write one HTML page with the figures and the plot inside; nothing is loaded from elsewhere."""
    heading, *rows = table(flights)
    picture = base64.b64encode(_png(draw(flights, "")))
    write_text(
        path,
        f"<!doctype html>\n<html lang=en><meta charset=utf-8><title>{html.escape(title)}</title>"
        f"<style>{STYLE}</style>\n<h1>{html.escape(title)}</h1>\n<p>{html.escape(note)}</p>\n"
        f"<table>\n{_html_row(heading, 'th')}{''.join(_html_row(row, 'td') for row in rows)}</table>\n"
        f'<img alt="rates, errors and motors over time" src="data:image/png;base64,{picture.decode()}">\n'
        f"<p>Errors are setpoint minus true rate, roll / pitch / yaw, averaged over the episodes of the "
        f"flight. Output and its change are the controller's, before the throttle mix.</p>\n</html>\n",
    )


def _draw_axis(panel: Axes, flights: Sequence[Flight], axis: int, shown: NDArray[np.bool_]) -> None:
    # The first flight is the one the reader came for: drawn last, on top, and thickest.
    for number, flight in reversed(list(enumerate(flights))):
        rate = np.rad2deg(flight.trace.rate[shown, axis])
        colour, width = FLIGHT_COLOURS[number % len(FLIGHT_COLOURS)], 1.0 if number else 1.6
        panel.plot(flight.trace.t[shown], rate, color=colour, lw=width, label=flight.name)
    setpoint = np.rad2deg(flights[0].trace.setpoint[shown, axis])
    panel.plot(flights[0].trace.t[shown], setpoint, color=INK, lw=1.0, ls=(0, (4, 2)), label="setpoint")
    panel.set_ylabel(f"{AXES[axis]}, deg/s", color=INK)
    # Overshoot stays in view, an excursion of a lost aircraft need not.
    span = max(20.0, float(np.abs(setpoint).max()) * 1.45)
    flown = max(float(np.abs(np.rad2deg(f.trace.rate[shown, axis])).max()) * 1.15 for f in flights)
    panel.set_ylim(-max(span, min(flown, 2 * span)), max(span, min(flown, 2 * span)))


def _draw_error(panel: Axes, flight: Flight, shown: NDArray[np.bool_]) -> None:
    error = np.rad2deg(flight.trace.setpoint[shown] - flight.trace.rate[shown])
    for axis, colour in enumerate(AXIS_COLOURS):
        panel.plot(flight.trace.t[shown], error[:, axis], color=colour, lw=0.9, label=AXES[axis])
    panel.set_ylabel("error, deg/s", color=INK)
    panel.set_yscale("symlog", linthresh=10)
    panel.legend(loc="upper right", ncols=3, frameon=False, fontsize=9, title=flight.name, title_fontsize=9)


def _draw_motors(panel: Axes, flight: Flight, shown: NDArray[np.bool_]) -> None:
    for motor in range(flight.trace.motors.shape[1]):
        values = 100 * flight.trace.motors[shown, motor]
        panel.plot(flight.trace.t[shown], values, color=MOTOR_COLOURS[motor], lw=0.7, label=str(motor + 1))
    panel.set_ylabel("motors, %", color=INK)
    panel.set_ylim(0, 105)
    panel.legend(loc="upper right", ncols=8, frameon=False, fontsize=9, title=flight.name, title_fontsize=9)


def _dress(panel: Axes) -> None:
    panel.grid(color=GRID, lw=0.6)
    panel.set_axisbelow(True)
    panel.tick_params(colors=INK, labelsize=9)
    for side, spine in panel.spines.items():
        spine.set_visible(side in ("left", "bottom"))
        spine.set_color(GRID)


def _png(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=DPI)
    return buffer.getvalue()


def _axes(values: NDArray[np.float64], digits: int) -> str:
    return " / ".join(f"{value:,.{digits}f}" for value in values)


def _html_row(cells: Sequence[str], tag: str) -> str:
    return f"<tr>{''.join(f'<{tag}>{html.escape(cell)}</{tag}>' for cell in cells)}</tr>\n"
