"""The bench's sensor, simulated: load cells that are calibrated with masses first, blades that are counted.

Cells, lever and masses are those of Koch 2019, chapter 5. A reading bends and a cell unloads as a data sheet
of such cells allows; its zero differs from run to run. What comes out is what `dyno bench` records, and goes
the same way into a recording: clocks, counts and calibration.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from neuroflight.sim.aircraft.model import Propulsion
from neuroflight.sim.arrays import Array
from neuroflight.sim.identification.bench.calibration import READ_S, calibrate
from neuroflight.sim.identification.bench.drive import Log
from neuroflight.sim.identification.bench.load_cell import FORCE, TORQUE, LoadCell, loads_of_masses
from neuroflight.sim.identification.bench.quantities import STAMPED_WINDOW_S, Rig
from neuroflight.sim.identification.bench.reduction import reduce_log
from neuroflight.sim.identification.bench.sensor import WRAP, parse_layout
from neuroflight.sim.identification.dyno.bench import (
    REST_S,
    SIMULATION_HZ,
    Phase,
    disturbed,
    duration,
    run,
    throttle_at,
)
from neuroflight.sim.identification.dyno.recording import Recording
from neuroflight.sim.identification.dyno.signal import jumps, settled_rows
from neuroflight.sim.physics.rotor import target_speed, thrust_and_torque
from neuroflight.toolchain.contract import GRAVITY

BLADES = 3
LEVER_M = 0.13  # of the torque's calibration
THRUST_MASSES_KG = tuple(0.2 * step for step in range(1, 11))  # up to the cell's 2 kg
TORQUE_MASSES_KG = tuple(side * mass for side in (1.0, -1.0) for mass in (0.2, 0.4, 0.6))
APART_M = 0.08  # two cells of 1 kg hold the torque as a pair
READ_HZ = 80.0  # an HX711's readings a second while a cell is calibrated
BEND = 5e-4  # of its range, by which a cell is off its line in the middle; of cheap cells' data sheets
HYSTERESIS = 5e-4  # of the load that was taken off, by which a cell does not come back
DRIFT = 2e-3  # of its range: standard deviation of a zero from run to run
CLOCK_RATE, CLOCK_ZERO_US = 1.003, 2.0**32 - 3e6  # sensor seconds a second; it begins anew after 3 s
STAMP_US = 4.0  # resolution of an Arduino's clock
LATE_S = 0.002  # mean time by which a line arrives late
TURNING = 0.1  # of the top speed: slower rotors are not judged


@dataclass(frozen=True)
class Cell:
    """The true properties of a load cell."""

    unit: str
    counts: float  # a unit of load
    zero: float  # counts without a load
    reach: float  # largest load [unit]


CELLS = {
    "thrust_raw": Cell(FORCE, 21_000.0, 84_000.0, 2.0 * GRAVITY),
    "torque_left_raw": Cell(TORQUE, 900_000.0, -3_000.0, GRAVITY * APART_M),
    "torque_right_raw": Cell(TORQUE, -900_000.0, -3_000.0, GRAVITY * APART_M),
}
LAYOUT = parse_layout(("time_us", *CELLS, "pulses", "pulse_us"))


@dataclass(frozen=True)
class Noise:
    """The errors added to thrust and torque, see `disturbed`."""

    noise: float = 0.0
    of_reading: bool = False
    outliers: float = 0.0


@dataclass(frozen=True, eq=False)
class Measured:
    """A run as the sensor showed it, and as it was, row by row."""

    found: Recording
    true: Recording


@dataclass(frozen=True)
class SpeedFound:
    """Speed from counted pulses less the true one, of settled rotors, in parts of the top speed."""

    mean: float
    rms: float
    largest: float


def calibrated(propulsion: Propulsion, noise: Noise, rng: np.random.Generator) -> Rig:
    """Calibrate the rig's cells by the dissertation's masses, at the noise of the measurement."""
    full = thrust_and_torque(target_speed(1.0, propulsion), propulsion)
    sizes = {FORCE: float(full[0]), TORQUE: float(full[1])}
    cells: dict[str, LoadCell] = {}
    for name, cell in CELLS.items():
        torque = cell.unit == TORQUE
        masses = TORQUE_MASSES_KG if torque else THRUST_MASSES_KG
        lever = LEVER_M if torque else None
        before = 0.0

        def read(mass_kg: float, cell: Cell = cell, lever: float | None = lever) -> float:
            nonlocal before
            load = float(loads_of_masses(mass_kg, lever))
            left = HYSTERESIS * (before - load) if load == 0.0 else 0.0
            size = abs(load) if noise.of_reading else sizes[cell.unit]
            error = noise.noise * size * rng.standard_normal(round(READ_S * READ_HZ))
            before = load
            return float(np.median(_counts(cell, load + left + error)))

        cells[name], _ = calibrate(masses, lever, read)
    return Rig(LAYOUT, cells, BLADES, STAMPED_WINDOW_S)


def measured(
    propulsion: Propulsion,
    experiment: Sequence[Phase],
    time: Array,
    rig: Rig,
    noise: Noise,
    rng: np.random.Generator,
) -> Measured:
    """Drive a rotor through `experiment`; the sensor sends a row at each `time` [s], (N,), rising."""
    phases = tuple(experiment)
    true = run(propulsion, phases, time)
    wild = noise.noise, noise.of_reading, noise.outliers
    one, other = (disturbed(true, rng, noise=wild[0], of_reading=wild[1], outliers=wild[2]) for _ in range(2))
    loads = {"thrust_raw": one.thrust, "torque_left_raw": one.torque, "torque_right_raw": other.torque}
    columns: dict[str, Array] = {"time_us": _stamp(time)}
    for name, load in loads.items():
        cell = CELLS[name]
        columns[name] = _counts(cell, load + DRIFT * cell.reach * rng.standard_normal())
    counts, last = _pulses(propulsion, phases, time)
    columns["pulses"], columns["pulse_us"] = counts % 2.0**16, _stamp(last)
    values = np.stack([columns[name] for name in LAYOUT.names], axis=1)
    commands = np.arange(0.0, duration(phases), 1.0 / SIMULATION_HZ)
    rest = time < REST_S
    log = Log(
        command_time=commands,
        throttle=throttle_at(commands, phases),
        arrival=np.maximum.accumulate(time + rng.exponential(LATE_S, len(time))),
        values=values,
        zeros={name: float(np.median(columns[name][rest])) for name in CELLS},
    )
    found, _ = reduce_log(log, rig)
    return Measured(found, true)


def speed_found(runs: Sequence[Measured]) -> SpeedFound:
    """Compute the error of the measured speed of rotors that have settled on a command, or follow a ramp."""
    top = max(float(run.true.speed.max()) for run in runs)
    errors = []
    for run_ in runs:
        judged = settled_rows(run_.true, jumps(run_.true)) & (run_.true.speed > TURNING * top)
        errors.append((run_.found.speed - run_.true.speed)[judged] / top)
    error = np.concatenate(errors)
    return SpeedFound(float(error.mean()), float(np.sqrt(np.mean(error**2))), float(np.abs(error).max()))


def scale_errors(cells: Mapping[str, LoadCell]) -> dict[str, float]:
    """Compute the relative error of each cell's calibrated scale."""
    return {name: cells[name].scale * cell.counts - 1.0 for name, cell in CELLS.items()}


def _counts(cell: Cell, load: Array) -> Array:
    """Compute readings under loads, any shape, [unit]: bent, whole counts."""
    part = np.minimum(np.abs(load) / cell.reach, 1.0)
    bent = load + BEND * cell.reach * 4.0 * part * (1.0 - part) * np.sign(load)
    return np.asarray(np.rint(cell.zero + cell.counts * bent))


def _stamp(time: Array) -> Array:
    """Convert times to the sensor's clock, (N,) [us]."""
    own = CLOCK_ZERO_US + 1e6 * CLOCK_RATE * time
    return np.asarray(np.floor(own / STAMP_US) * STAMP_US % WRAP)


def _pulses(propulsion: Propulsion, experiment: tuple[Phase, ...], time: Array) -> tuple[Array, Array]:
    """Count the blades that passed up to each time [s], (N,), and return when the last of them did [s]."""
    grid = np.arange(0.0, time[-1] + 2.0 / SIMULATION_HZ, 1.0 / SIMULATION_HZ)
    speed = run(propulsion, experiment, grid).speed
    passed = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1])) / SIMULATION_HZ])
    passed *= BLADES / (2.0 * np.pi)
    edges = np.interp(np.arange(1.0, np.floor(passed[-1]) + 1.0), passed, grid)
    counts = np.searchsorted(edges, time, side="right")
    last = np.concatenate([[0.0], edges])[counts]
    return counts.astype(np.float64), last
