"""Thrust, torque and speed of a sensor's rows: of one row while the rotor turns, and of a whole log."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from neuroflight.sim.aircraft.model import RPM
from neuroflight.sim.arrays import Array
from neuroflight.sim.identification.bench.load_cell import FORCE, TORQUE, LoadCell, load
from neuroflight.sim.identification.bench.pulses import speed_of_pulses, unwrapped
from neuroflight.sim.identification.bench.sensor import CELLS, TIMES, WRAP, Layout
from neuroflight.toolchain.errors import DynoError

# [s] over which the speed of pulses is averaged: a tenth of a rise if the sensor stamps them, twice that if
# it only counts them, so that one pulse more or less matters less.
STAMPED_WINDOW_S, COUNTED_WINDOW_S = 0.02, 0.04
WRAP_SHORT = 2.0**16  # of a counter of 16 bits
PULSE_S = TIMES["time_us"]


@dataclass(frozen=True)
class Rig:
    """A sensor and the meaning of its numbers."""

    layout: Layout
    cells: Mapping[str, LoadCell]  # by column
    blades: int  # pulses a revolution
    window_s: float  # [s] over which the speed of pulses is averaged

    def raw(self) -> tuple[str, ...]:
        """Return the columns that are counts of load cells."""
        return tuple(name for name in self.layout.names if name in CELLS)

    def column(self, values: Array, name: str) -> Array:
        """Return a column of rows, (N, C): (N,)."""
        column: Array = values[:, self.layout.names.index(name)]
        return column


def usual_window(layout: Layout) -> float:
    """Return the default window [s] over which the speed of this sensor's pulses is averaged."""
    return STAMPED_WINDOW_S if layout.has("pulse_us") else COUNTED_WINDOW_S


def check_rig(rig: Rig) -> None:
    """Raise DynoError if counts have no calibration, or one of the wrong kind."""
    for name in rig.raw():
        unit = FORCE if name.startswith("thrust") else TORQUE
        if name not in rig.cells:
            raise DynoError(
                f"the sensor sends {name}, for which there is no load cell; calibrate it with `neuroflight "
                f"dyno calibrate --cell {name}` and give the file with --cells"
            )
        if rig.cells[name].unit != unit:
            raise DynoError(
                f"the load cell {name} was calibrated in {rig.cells[name].unit}, expected {unit}; "
                f"{'leave --lever-mm out' if unit == FORCE else 'give the length of the lever'}"
            )


def thrust_of(rig: Rig, values: Array, zeros: Mapping[str, float]) -> Array:
    """Compute the thrust [N], (N,), as the sensor is turned. zeros: counts without a load, by column."""
    return _load(rig, values, zeros, "thrust_raw" if rig.layout.has("thrust_raw") else "thrust_n")


def torque_of(rig: Rig, values: Array, zeros: Mapping[str, float]) -> Array:
    """Compute the torque [N m], (N,), as the sensor is turned; of two opposed cells the mean."""
    if rig.layout.has("torque_left_raw"):
        both = [_load(rig, values, zeros, f"torque_{side}_raw") for side in ("left", "right")]
        return 0.5 * (both[0] + both[1])
    return _load(rig, values, zeros, "torque_raw" if rig.layout.has("torque_raw") else "torque_n_m")


def _load(rig: Rig, values: Array, zeros: Mapping[str, float], name: str) -> Array:
    column = rig.column(values, name)
    return load(rig.cells[name], column, zeros.get(name)) if name in CELLS else column


def own_time(rig: Rig, values: Array) -> Array | None:
    """Return times [s] of the sensor's clock, (N,), None without one. Raises DynoError if they go back."""
    name = rig.layout.time
    if name is None:
        return None
    time = rig.column(values, name)
    return TIMES[name] * (time if name == "time_s" else unwrapped(time, WRAP))


def pulse_wrap(counts: Array) -> float:
    """Return the number at which the counter of these pulses restarts."""
    return WRAP_SHORT if float(counts.max()) < WRAP_SHORT else WRAP


def speed_of(rig: Rig, values: Array, time: Array) -> Array:
    """Compute the rotor speed [rad/s], (N,), at `time` [s], (N,), on the clock of the stamps."""
    if rig.layout.has("rpm"):
        return rig.column(values, "rpm") * RPM
    pulses = rig.column(values, "pulses")
    counts = unwrapped(pulses, pulse_wrap(pulses))
    edges = time
    if rig.layout.has("pulse_us"):
        # A stamp is at most as old as the row; both begin anew at the same number.
        age = (rig.column(values, "time_us") - rig.column(values, "pulse_us")) % WRAP
        edges = time - age * PULSE_S
    return speed_of_pulses(time, edges, counts, rig.blades, rig.window_s)
