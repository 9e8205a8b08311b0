"""How much of a log's turning an aircraft file does not explain: the judge of twins of real aircraft.

    python -m tests.sim.identification.held_back LOG FILE.toml... [--from S] [--to S]

The logged motors turn the rotors of the file, by its delay, its curve at the logged volts and its response;
the rates that these make are held against the gyro's, both less their mean over SLOW_S. Unexplained is the
variance of the difference over the gyro's, in two ways:

- all: of the rates as they are. A controller answers gusts and wash by the motors, so a true file explains
  less of a windy flight than of a calm one;
- sticks: of that part of both that the pilot's commands make (their spectra over the setpoint's, which no
  gust moves): what a command does is what the file has to say.

Moments that stand or change slowly (a weak motor, weight off centre, the wind of a cruise) count for
nobody; and the gyro's own lag, which the filters before a log make, is the best of LAGS_S for every file.
It shares no code with sim/identification.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.signal import csd, welch

from neuroflight.sim.aircraft.model import Aircraft, load_aircraft
from neuroflight.sim.arrays import Array
from neuroflight.sim.blackbox.log import read_log
from neuroflight.sim.blackbox.scales import header_number
from neuroflight.sim.blackbox.units import channels
from neuroflight.sim.flight.trace import load_trace
from neuroflight.sim.physics.rotor import rotor_geometry, rotor_wrench, speeds_along, target_speed
from neuroflight.sim.recorded.log import split_number

SLOW_S = 0.12
SPECTRUM_S = 1.0  # of the windows that spectra are taken of
BAND_HZ = (1.5, 20.0)  # that pilots steer in
STEP_S = 0.001
LAGS_S = np.arange(0, 0.0085, 0.0005)
GYRO_SCALED = 6
EDGE_S = 1.0  # of the flight at its ends: on the ground, and rotors whose speeds are not known


@dataclass(frozen=True, eq=False)
class Flown:
    """A flight in steps of STEP_S."""

    motors: Array  # (N, M)
    gyro: Array  # (N, 3) [rad/s]
    volts: Array | None  # (N,)
    setpoint: Array  # (N, 3) [rad/s]


def read(path: str, start_s: float = 0.0, end_s: float = np.inf) -> Flown:
    """Read the armed part of a log or a trace, between these times of it."""
    file, number = split_number(Path(path))
    volts: Array | None = None
    if file.suffix == ".npz":
        trace = load_trace(file)
        time, motors, gyro = trace.t, trace.motors, trace.gyro.astype(float)
        asked = trace.setpoint.astype(float)
    else:
        log = read_log(file, number)
        told = channels(log)
        rows = np.flatnonzero(told.armed)
        rows = np.arange(rows[0], rows[-1] + 1)
        time = told.time(0)[rows]
        time = time - time[0]
        raw = told.gyro_unfiltered
        debug = log.matrix("debug", 3)
        if raw is None and header_number(log.header, "debug_mode") == GYRO_SCALED and debug is not None:
            raw = np.deg2rad(debug).astype(np.float32)
        taken = told.gyro if raw is None else raw
        assert taken is not None and told.motors is not None
        motors, gyro = told.motors[rows], taken[rows].astype(float)
        assert told.setpoint is not None
        asked = np.nan_to_num(told.setpoint[rows].astype(float))
        volts = None if told.voltage is None else told.voltage[rows]
    end = min(end_s, float(time[-1]) - EDGE_S)
    at = np.arange(max(start_s, EDGE_S), end, STEP_S)

    def even(values: Array) -> Array:
        return np.column_stack([np.interp(at, time, column) for column in values.reshape(len(time), -1).T])

    return Flown(even(motors), even(gyro), None if volts is None else even(volts)[:, 0], even(asked))


def said(flown: Flown, aircraft: Aircraft) -> Array:
    """Compute the rates (N, 3) that the logged motors make of the aircraft, without what moments stand."""
    propulsion, inertia = aircraft.propulsion, aircraft.mass_properties.inertia
    rows = np.arange(len(flown.motors))
    motors = late(flown.motors, propulsion.delay)
    volts = None if propulsion.supply_voltage is None or flown.volts is None else flown.volts[:, None]
    targets = target_speed(np.clip(motors, 0, 1), propulsion, volts)
    speeds = speeds_along(targets[0], targets, STEP_S, propulsion)
    still = np.zeros_like(flown.gyro)
    moments = rotor_wrench(speeds[:-1], speeds[1:], STEP_S, still, flown.gyro, rotor_geometry(aircraft))[
        :, 3:
    ]
    moments -= np.cross(flown.gyro, flown.gyro @ inertia)
    return np.asarray(np.cumsum(moments @ np.linalg.inv(inertia), axis=0) * STEP_S)[rows]


def late(values: Array, by_s: float) -> Array:
    """Return rows that come `by_s` later."""
    at = np.arange(len(values))
    return np.column_stack([np.interp(at - by_s / STEP_S, at, column) for column in values.T])


def unexplained(flown: Flown, aircraft: Aircraft) -> tuple[Array, Array]:
    """Compute the shares (3,) that the file does not explain: of all turning, and of that by the sticks."""
    turned, measured = said(flown, aircraft), quick(flown.gyro)
    best, by_sticks = np.full(3, np.inf), np.full(3, np.inf)
    for lag in LAGS_S:
        model = late(turned, lag)
        share = (measured - quick(model)).var(axis=0) / measured.var(axis=0)
        best = min(best, share, key=np.sum)
        by_sticks = min(by_sticks, _by_sticks(flown, model), key=np.sum)
    return best, by_sticks


def _by_sticks(flown: Flown, model: Array) -> Array:
    length = round(SPECTRUM_S / STEP_S)
    shares = np.empty(3)
    for axis in range(3):
        frequency, one = csd(flown.setpoint[:, axis], flown.gyro[:, axis], 1 / STEP_S, nperseg=length)
        _, other = csd(flown.setpoint[:, axis], model[:, axis], 1 / STEP_S, nperseg=length)
        _, asked = welch(flown.setpoint[:, axis], 1 / STEP_S, nperseg=length)
        band = (frequency >= BAND_HZ[0]) & (frequency <= BAND_HZ[1])
        shares[axis] = (np.abs(one - other) ** 2 / asked)[band].sum() / (np.abs(one) ** 2 / asked)[band].sum()
    return shares


def quick(rates: Array) -> Array:
    """Return rates (N, 3) less their mean over SLOW_S around: what a standing moment makes of them is 0."""
    width = round(SLOW_S / STEP_S) | 1
    sums = np.cumsum(np.vstack([np.zeros(3), rates]), axis=0)
    mean = (sums[width:] - sums[:-width]) / width
    return np.asarray(rates[width // 2 : width // 2 + len(mean)] - mean)


def main() -> None:
    """Print the shares of each file."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("log")
    parser.add_argument("files", nargs="+")
    parser.add_argument("--from", type=float, default=0.0, dest="start")
    parser.add_argument("--to", type=float, default=np.inf)
    args = parser.parse_args()
    flown = read(args.log, args.start, args.to)
    for file in args.files:
        rest, sticks = unexplained(flown, load_aircraft(file))
        print(
            f"{Path(file).name:32} unexplained: all {rest.round(3)} mean {rest.mean():.3f}, "
            f"sticks {sticks.round(3)} mean {sticks.mean():.3f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
