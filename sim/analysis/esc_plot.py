"""Plot of what the ESCs of a flight tell: a panel for each topic, a line for each motor."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from neuroflight.sim.arrays import Array
from neuroflight.sim.plotting import INK, MOTOR_COLOURS, MUTED, dress, legend_above, titled_figure

TITLES = {  # of each topic, its unit
    "speed_rpm": ("rotor speed", "rpm"),
    "force_n": ("force: thrust of a rotor", "N"),
    "torque_n_m": ("torque: drag of a rotor", "N m"),
    "current_a": ("current of a motor", "A"),
    "voltage_v": ("voltage of all", "V"),
    "temperature_c": ("temperature of a winding", "°C"),
}


def draw_topics(topics: Mapping[str, Array], rate_hz: int, title: str) -> Figure:
    """Draw six panels; a topic that is missing in the aircraft file is marked so."""
    figure = titled_figure((12.5, 9.0), title)
    panels = figure.subplots(3, 2, sharex=True)
    for panel, (name, (label, unit)) in zip(panels.flat, TITLES.items(), strict=True):
        values = topics[name]
        time = np.arange(len(values)) / rate_hz
        dress(panel, label, up=unit)
        if not np.isfinite(values).all():
            panel.text(
                *(0.5, 0.5, "not in the aircraft file"), transform=panel.transAxes, ha="center", color=MUTED
            )
            panel.set_yticks([])
            continue
        if np.ptp(values, axis=1).max() == 0.0:
            panel.plot(time, values[:, 0], color=INK, lw=1.0)
        else:
            for motor, line in enumerate(values.T):
                panel.plot(time, line, color=MOTOR_COLOURS[motor], lw=1.0, label=f"motor {motor + 1}")
    legend_above(panels[0, 0])
    for panel in panels[-1]:
        panel.set_xlabel("time, s", color=INK)
        panel.set_xlim(0.0, max(len(topics["speed_rpm"]) - 1, 1) / rate_hz)
    figure.align_ylabels(panels)
    return figure
