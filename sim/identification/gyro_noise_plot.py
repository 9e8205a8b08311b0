"""Plot of `neuroflight aircraft noise`: Allan deviation and histogram of a record at rest."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from neuroflight.sim.arrays import Array
from neuroflight.sim.identification.gyro_noise import Noise, SensorNoise
from neuroflight.sim.identification.recording import Recording
from neuroflight.sim.plotting import AXIS_COLOURS, INK, dress, plain_numbers, titled_figure
from neuroflight.toolchain.contract import AXES

DASHES = (0, (4, 3))  # of the models


def draw_noise(noise: Noise, recording: Recording, title: str) -> Figure:
    """Draw Allan deviation and histogram of each sensor, three axes in each."""
    sensors = [("gyro", "deg/s", AXES, noise.gyro, recording.gyro, math.degrees(1.0))]
    if noise.accelerometer is not None and recording.acceleration is not None:
        axes = ("x forward", "y left", "z up")
        sensors.append(("accelerometer", "m/s²", axes, noise.accelerometer, recording.acceleration, 1.0))
    figure = titled_figure((11, 0.7 + 4.3 * len(sensors)), title, (0.08, 0.12))
    panels = figure.subplots(len(sensors), 2, squeeze=False)
    for row, (name, unit, axes, sensor, values, scale) in zip(panels, sensors, strict=True):
        _draw_deviation(row[0], sensor, scale, unit)
        dress(row[0], f"{name}, Allan deviation")
        _draw_histogram(row[1], values, sensor, scale, unit)
        dress(row[1], f"{name}, samples about their mean")
        corners = (("white noise", "lower left"), ("normal", "upper right"))
        for panel, (model, corner) in zip(row, corners, strict=True):
            for axis, colour in zip(axes, AXIS_COLOURS, strict=True):
                panel.plot([], [], color=colour, lw=1.6, label=axis)
            panel.plot([], [], color=INK, lw=0.9, ls=DASHES, label=model)
            panel.legend(frameon=False, fontsize=9, labelcolor=INK, loc=corner)
    return figure


def _draw_deviation(panel: Axes, sensor: SensorNoise, scale: float, unit: str) -> None:
    for axis, colour in enumerate(AXIS_COLOURS):
        panel.loglog(sensor.tau, scale * sensor.deviation[:, axis], color=colour, lw=1.6)
        white = scale * sensor.density[axis] / np.sqrt(sensor.tau)
        panel.loglog(sensor.tau, white, color=colour, lw=0.9, ls=DASHES)
    panel.set_ylim(scale * sensor.deviation.min() / 2, scale * sensor.deviation.max() * 2)
    for ticks in (panel.xaxis, panel.yaxis):
        plain_numbers(ticks)
    panel.set_xlabel("averaging time, s", color=INK)
    panel.set_ylabel(unit, color=INK)


def _draw_histogram(panel: Axes, values: Array, sensor: SensorNoise, scale: float, unit: str) -> None:
    reach = 4.5 * float(sensor.sigma.max())
    at = np.linspace(-reach, reach, 400)
    for axis, colour in enumerate(AXIS_COLOURS):
        sigma, mean, step = sensor.sigma[axis], sensor.mean[axis], sensor.step[axis]
        # A bin holds whole steps of a rounded log, or the histogram would show the steps instead.
        width = 2 * reach / 60 if step < 1e-3 * reach else step * math.ceil(2 * reach / 60 / step)
        low = values[:, axis].min() - step / 2
        low += width * max(0, math.floor((mean - reach - low) / width))
        bins = scale * (np.arange(low, mean + reach + width, width) - mean)
        away = scale * (values[:, axis] - mean)
        panel.hist(away, bins.tolist(), density=True, histtype="step", color=colour, lw=1.4)
        normal = np.exp(-0.5 * (at / sigma) ** 2) / (scale * sigma * math.sqrt(2 * math.pi))
        panel.plot(scale * at, normal, color=colour, lw=0.9, ls=DASHES)
    panel.set_xlim(-scale * reach, scale * reach)
    panel.set_xlabel(f"deviation from the mean, {unit}", color=INK)
    panel.set_ylabel(f"share of samples per {unit}", color=INK)
