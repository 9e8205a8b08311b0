"""The ESCs' reports in a flight: the topics /aircraft/sensor/esc of Koch 2019, table 5.1, as a table."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from neuroflight.sim.aircraft.model import RPM
from neuroflight.sim.arrays import Array
from neuroflight.sim.physics.twin import Twin
from neuroflight.toolchain.files import write_text

DIGITS = {  # of each topic in a file: those that an ESC or a thermometer could tell, and of forces enough
    "speed_rpm": 2,
    "temperature_c": 3,
    "voltage_v": 3,
    "current_a": 4,
    "force_n": 5,
    "torque_n_m": 7,
}


@dataclass(frozen=True)
class Range:
    """A topic over a flight and all motors."""

    least: float
    mean: float
    largest: float


class EscRecord:
    """One row each time that it is called: the `watch` of a flight of one aircraft."""

    def __init__(self, twin: Twin) -> None:
        self._twin = twin
        self._motors = twin.aircraft.motor_count
        self._rows: list[Array] = []

    def __call__(self) -> None:
        """Keep what the ESCs tell now."""
        told = self._twin.telemetry
        rows = (
            told.speed[0] / RPM,
            told.temperature[0],
            np.full(self._motors, told.voltage[0]),
            self._twin.motor_current[0],
            told.force[0],
            told.torque[0],
        )
        self._rows.append(np.stack(rows))

    @property
    def topics(self) -> dict[str, Array]:
        """Each topic, (N, M) of N rows and M motors; NaN where the aircraft file does not say.

        Temperature is the winding's [degC], voltage what all share, current the motor's share of the draw.
        """
        values = np.array(self._rows, np.float64).reshape(-1, len(DIGITS), self._motors)
        return {name: values[:, place] for place, name in enumerate(DIGITS)}


def topic_ranges(topics: Mapping[str, Array]) -> dict[str, Range | None]:
    """Return each topic's range; None for an unknown one."""
    return {
        name: Range(float(values.min()), float(values.mean()), float(values.max()))
        if values.size and np.isfinite(values).all()
        else None
        for name, values in topics.items()
    }


def save_topics(path: Path, topics: Mapping[str, Array], rate_hz: int) -> None:
    """Write the topics as CSV: time_s, then each topic of each motor; a cell that is not known is empty."""
    motors = next(iter(topics.values())).shape[1]
    columns = [(f"{name}_{motor + 1}", name, motor) for name in topics for motor in range(motors)]
    cells = [
        [_cell(value, DIGITS[name]) for value in topics[name][:, motor].tolist()]
        for _, name, motor in columns
    ]
    lines = [",".join(["time_s", *(heading for heading, _, _ in columns)])]
    lines += [
        ",".join([f"{row / rate_hz:.6f}", *values]) for row, values in enumerate(zip(*cells, strict=True))
    ]
    write_text(path, "\n".join(lines) + "\n")


def _cell(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if math.isfinite(value) else ""
