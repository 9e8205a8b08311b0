"""Plots of a dynamometer's recording and of the model fitted to it."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec, SubplotSpec

from neuroflight.sim.aircraft.model import RPM
from neuroflight.sim.arrays import Array, Flags, Indices
from neuroflight.sim.identification.dyno.fit import Fit
from neuroflight.sim.identification.dyno.points import PointsFit
from neuroflight.sim.identification.dyno.recording import Recording
from neuroflight.sim.identification.dyno.robust_fit import Estimate, polynomial
from neuroflight.sim.identification.dyno.signal import WINDOW_S, jumps, settled_rows
from neuroflight.sim.plotting import (
    AXIS_COLOURS,
    INK,
    MOTOR_COLOURS,
    dress,
    legend_above,
    save_png,
    titled_figure,
)

DATA, MODEL, OFF = "#8b949e", AXIS_COLOURS[0], AXIS_COLOURS[1]
THROTTLE = AXIS_COLOURS[2]
PAD = (0.06, 0.08)  # [inch], vertical and horizontal, between panels
ROWS_SHOWN = 20_000  # more dots do not show more
BEFORE_S = 0.05  # [s] shown before a step
NEAR = 0.02  # of the top speed: what is left of a step when the picture may end
TURNING = 0.15  # of the top speed: slower rows show K_T and K_Q too coarsely
CHANNELS = (("speed", "rotor speed", "rpm"), ("thrust", "thrust", "N"), ("torque", "torque", "N m"))


def save_recording_plot(path: Path, recording: Recording, title: str) -> None:
    """Write `draw_recording` as PNG."""
    save_png(path, draw_recording(recording, title))


def save_fit_plot(path: Path, fit: Fit | PointsFit, title: str) -> None:
    """Write `draw_fit` or `draw_points` as PNG."""
    save_png(path, draw_points(fit, title) if isinstance(fit, PointsFit) else draw_fit(fit, title))


def draw_recording(recording: Recording, title: str) -> Figure:
    """Draw throttle, rotor speed, thrust and torque over time."""
    figure = titled_figure((11, 9), title, PAD)
    panels: list[Axes] = list(figure.subplots(4, 1, sharex=True, height_ratios=(1, 2, 2, 2)))
    panels[0].plot(recording.time, 100 * recording.throttle, color=THROTTLE, lw=1.2, drawstyle="steps-post")
    panels[0].set_ylim(-4, 106)
    dress(panels[0], "throttle", up="%")
    shown = _thinned(len(recording.time))
    for panel, (name, label, unit) in zip(panels[1:], CHANNELS, strict=True):
        values = _shown(name, getattr(recording, name))
        _dots(panel, recording.time[shown], values[shown])
        panel.set_ylim(*_reach(values))
        dress(panel, label, up=unit)
    panels[-1].set_xlabel("time, s", color=INK)
    panels[-1].set_xlim(recording.time[0], recording.time[-1])
    figure.align_ylabels(panels)
    return figure


def draw_fit(fit: Fit, title: str) -> Figure:
    """Draw data and model over time with residuals, H, K_T and K_Q against data, and each step enlarged."""
    channels = len(CHANNELS) if fit.torque_ratio else len(CHANNELS) - 1
    rows = channels + int(fit.response is not None)
    figure = titled_figure((14, 3.9 * rows), title, PAD)
    grid = GridSpec(rows, 2, figure, width_ratios=(2.1, 1))
    over_time = [_draw_channel(figure, grid[row, 0], fit, row) for row in range(channels)]
    over_time[-1].set_xlabel("time, s", color=INK)
    over_time[0].figure.align_ylabels()
    _draw_curve(figure.add_subplot(grid[0, 1]), fit)
    _draw_coefficient(figure.add_subplot(grid[1, 1]), fit, "thrust")
    if fit.torque_ratio:
        _draw_coefficient(figure.add_subplot(grid[2, 1]), fit, "torque")
    if fit.response is not None:
        inner = grid[channels, :].subgridspec(1, 2)
        up = figure.add_subplot(inner[0, 0])
        down = figure.add_subplot(inner[0, 1], sharey=up)
        _draw_steps(up, fit, rising=True)
        _draw_steps(down, fit, rising=False)
    return figure


def draw_points(fit: PointsFit, title: str) -> Figure:
    """Draw thrust and torque of each point over the rotor's speed, beside the fits."""
    shown = CHANNELS[1:] if fit.torque_ratio else CHANNELS[1:2]
    figure = titled_figure((6.5 * len(shown), 5), title, PAD)
    panels = figure.subplots(1, len(shown), squeeze=False)[0]
    speeds = np.linspace(0.0, fit.speed_max, 201)
    thrust = polynomial(fit.thrust_coefficient, speeds) * speeds**2
    models = (thrust, polynomial(fit.torque_ratio, speeds) * thrust if fit.torque_ratio else thrust)
    for panel, (name, label, unit), model in zip(panels, shown, models, strict=False):
        panel.plot(fit.speed / RPM, getattr(fit, name), ".", color=DATA, ms=5, mew=0, label="points")
        panel.plot(speeds / RPM, model, color=MODEL, lw=1.6, label="fit", zorder=3)
        dress(panel, label, "rotor speed, rpm", unit)
        legend_above(panel)
    return figure


def _settling(fit: Fit, rows: Indices) -> float:
    """Return a time [s] that contains the slowest step and a margin."""
    recording = fit.recording
    longest = 0.0
    for row, end in zip(rows, np.append(rows[1:], len(fit.speed)), strict=True):
        shown = slice(int(row), int(row + np.sum(recording.time[row:end] < recording.time[row] + WINDOW_S)))
        left = np.abs(fit.speed[shown] - fit.speed[shown][-1]) > NEAR * fit.speed_max
        longest = max(longest, float((recording.time[shown] - recording.time[row])[left].max(initial=0.0)))
    return min(1.3 * longest + 0.1, WINDOW_S)


def _draw_channel(figure: Figure, place: SubplotSpec, fit: Fit, channel: int) -> Axes:
    """Draw one channel over time, with its residuals in a strip below, which is returned."""
    name, label, unit = CHANNELS[channel]
    inner = place.subgridspec(2, 1, height_ratios=(3, 1), hspace=0.02)
    panel = figure.add_subplot(inner[0])
    strip = figure.add_subplot(inner[1], sharex=panel)
    time = fit.recording.time
    data, model = _shown(name, getattr(fit.recording, name)), _shown(name, getattr(fit, name))
    off = fit.outliers[channel]
    kept = _thinned(len(time)) & ~off
    low, high = _reach(data[~off])
    _dots(panel, time[kept], data[kept], "data")
    panel.plot(time, model, color=MODEL, lw=1.2, label="model", zorder=3)
    inside = off & (data > low) & (data < high)
    if inside.any():
        panel.plot(time[inside], data[inside], "x", color=OFF, ms=3, mew=0.7, label="outlier", zorder=2)
    panel.set_ylim(low, high)
    panel.set_xlim(time[0], time[-1])
    panel.tick_params(labelbottom=False)
    dress(panel, label, up=unit)
    for handle in legend_above(panel).get_lines():
        handle.set(alpha=1.0, markersize=6)
    _dots(strip, time[kept], (data - model)[kept])
    largest = 1.3 * float(np.quantile(np.abs((data - model)[~off]), 0.999)) or 1.0
    strip.set_ylim(-largest, largest)
    strip.axhline(0.0, color=MODEL, lw=1.0)
    dress(strip, "", up=unit)
    strip.text(
        0.006, 0.94, "data minus model", transform=strip.transAxes, va="top", fontsize=9, color=INK,
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.0, "alpha": 0.8},
    )  # fmt: skip
    return strip


def _draw_curve(panel: Axes, fit: Fit) -> None:
    recording = fit.recording
    settled = settled_rows(recording, jumps(recording)) & ~fit.outliers[0]
    _dots(panel, 100 * recording.throttle[settled], recording.speed[settled] / RPM)
    throttle = np.linspace(0.0, 1.0, 201)
    a, b, c = (term.value / RPM for term in fit.speed_curve)
    panel.plot(100 * throttle, (a * throttle + b) * throttle + c, color=MODEL, lw=1.6, zorder=3)
    panel.set_ylim(*_reach(recording.speed[settled] / RPM))
    title = f"H(u) = {a:.0f} u² {'+' if b >= 0 else '-'} {abs(b):.0f} u + {c:.0f} rpm"
    dress(panel, title, "throttle, %", "rpm")


def _draw_coefficient(panel: Axes, fit: Fit, name: str) -> None:
    """Draw K_T or K_Q of each steady row, and as fitted."""
    speed = fit.clean_speed
    load = polynomial(fit.thrust_coefficient, speed) * speed**2
    if name == "thrust":
        terms, off, symbol, unit = fit.thrust_coefficient, fit.outliers[1], "K_T", "N s²/rad²"
        values, below = fit.recording.thrust, speed**2
    else:
        terms, off, symbol, unit = fit.torque_ratio, fit.outliers[2], "K_Q", "m"
        values, below = fit.recording.torque, load
    shown = fit.steady & ~off & (speed > TURNING * fit.speed_max)
    speeds = np.linspace(TURNING * fit.speed_max, fit.speed_max, 201)
    fitted = polynomial(terms, speeds)
    exponent = math.floor(math.log10(float(np.median(fitted))))
    _dots(panel, speed[shown] / RPM, values[shown] / below[shown] / 10.0**exponent)
    panel.plot(speeds / RPM, fitted / 10.0**exponent, color=MODEL, lw=1.6, zorder=3)
    panel.set_ylim(0.0, 2.0 * float(fitted.max()) / 10.0**exponent)
    dress(panel, f"{symbol} = {_polynomial(terms)} {unit}", "rotor speed, rpm", f"$10^{{{exponent}}}$ {unit}")


def _draw_steps(panel: Axes, fit: Fit, *, rising: bool) -> None:
    """Draw the speed around every jump of one direction, from the instant of the jump on."""
    recording = fit.recording
    rows = jumps(recording)
    after = _settling(fit, rows)
    number = 0
    for row in rows:
        throttle = recording.throttle
        change = float(throttle[row] - throttle[row - 1])
        if (change > 0) is not rising:
            continue
        since = recording.time - recording.time[row]
        near = (since > -BEFORE_S) & (since < after) & ~fit.outliers[0]
        colour = MOTOR_COLOURS[number % len(MOTOR_COLOURS)]
        number += 1
        ms = 1000 * since[near]
        panel.plot(ms, recording.speed[near] / RPM, ".", color=colour, ms=3, alpha=0.35, mew=0)
        label = f"{100 * throttle[row - 1]:.0f} to {100 * throttle[row]:.0f} %"
        panel.plot(ms, fit.speed[near] / RPM, color=colour, lw=1.5, label=label if number <= 8 else None)
    panel.set_xlim(-1000 * BEFORE_S, 1000 * after)
    dress(panel, f"steps {'up' if rising else 'down'}: data and model", "time since the step, ms", "rpm")
    panel.legend(loc="upper left" if rising else "upper right", frameon=False, fontsize=9, handlelength=1.6)


def _polynomial(terms: tuple[Estimate, ...]) -> str:
    first, *rest = (term.value for term in terms)
    powers = ("", "²", "³")
    text = f"{first:.3g}"
    for value, power in zip(rest, powers, strict=False):
        text += f" {'+' if value >= 0 else '-'} {abs(value):.2g} ω{power}"
    return text


def _dots(panel: Axes, x: Array, y: Array, label: str | None = None) -> None:
    panel.plot(x, y, ".", color=DATA, ms=2, mew=0, alpha=0.45, label=label, rasterized=True)


def _shown(name: str, values: Array) -> Array:
    return values / RPM if name == "speed" else values


def _thinned(count: int) -> Flags:
    """Select every n-th row, such that at most ROWS_SHOWN are left."""
    shown = np.zeros(count, bool)
    shown[:: -(-count // ROWS_SHOWN)] = True
    return shown


def _reach(values: Array) -> tuple[float, float]:
    """Return limits that contain nearly all values, with a margin; a few outliers are cut off."""
    low, high = (float(edge) for edge in np.quantile(values, [0.002, 0.995]))
    margin = 0.08 * ((high - low) or 1.0)
    return min(low, 0.0) - margin, high + margin
