"""Readings of a load cell under known masses, one after the other, each followed by one without."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from neuroflight.sim.identification.bench.drive import Clock, Sensor
from neuroflight.sim.identification.bench.load_cell import (
    FORCE,
    TORQUE,
    LoadCell,
    fit_load_cell,
    loads_of_masses,
)
from neuroflight.toolchain.errors import DynoError

READ_S = 2.0  # [s] over which a reading is averaged
ROWS_MIN = 10  # in that time


def read_still(sensor: Sensor, column: str, clock: Clock, seconds: float = READ_S) -> float:
    """Compute the median of a column over `seconds`. Raises DynoError if too little comes."""
    sensor.settle()
    layout = sensor.reader.layout
    if layout is None or not layout.has(column):
        names = "none" if layout is None else ", ".join(layout.names)
        raise DynoError(f"the sensor has no column {column}, expected one of its own: {names}")
    place = layout.names.index(column)
    values: list[float] = []
    end = clock() + seconds
    while (left := end - clock()) > 0:
        values += [row.values[place] for row in sensor.rows(left)]
    if len(values) < ROWS_MIN:
        raise DynoError(
            f"the sensor sent {len(values)} readings in {seconds:g} s, expected at least {ROWS_MIN}; check "
            f"its cable"
        )
    return float(np.median(values))


def calibrate(
    masses_kg: Sequence[float], lever_m: float | None, read: Callable[[float], float]
) -> tuple[LoadCell, list[tuple[float, float]]]:
    """Load the cell with each mass in turn and unload it; return the cell, and each load with its reading.

    read: has a mass put on [kg], 0 for none, and returns the cell's reading. lever_m: see loads_of_masses.
    """
    order = [0.0]
    for mass in masses_kg:
        order += [mass, 0.0]
    readings = [read(mass) for mass in order]
    loads = loads_of_masses(order, lever_m)
    cell = fit_load_cell(loads, np.array(readings), FORCE if lever_m is None else TORQUE)
    return cell, list(zip(loads.tolist(), readings, strict=True))
