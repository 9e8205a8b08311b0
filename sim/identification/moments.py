"""Identification of moment over inertia, relative to the aircraft file, from a log of motors and gyro.

The logged motor values turn the rotors of the aircraft file, whose moments make angular accelerations. Those
couple the axes, and so do the body's moments, which are looked for: the fit is repeated with those that it
found. Over short windows accelerations add up to changes of the rate; their ratio to the measured ones, an
axis by least squares, is the factor of moment over inertia. Rates alone cannot tell a weaker rotor from a
larger inertia, and the margin is of the gyro's noise, not of errors of the file (docs/guides/adaptation.md).
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from neuroflight.sim.aircraft.edit import with_key
from neuroflight.sim.aircraft.model import FILE_BYTES_MAX, Aircraft, aircraft_file, parse_aircraft
from neuroflight.sim.aircraft.props_out import SUFFIX
from neuroflight.sim.analysis.confidence import NORMAL
from neuroflight.sim.arrays import Array
from neuroflight.sim.blackbox.flight import check_motors
from neuroflight.sim.blackbox.log import read_log
from neuroflight.sim.blackbox.units import channels
from neuroflight.sim.flight.trace import load_trace
from neuroflight.sim.physics.rotor import rotor_geometry, rotor_wrench, speeds_along, target_speed
from neuroflight.sim.recorded.log import SUFFIXES, split_number
from neuroflight.toolchain.contract import AXES
from neuroflight.toolchain.errors import AircraftError, TraceError
from neuroflight.toolchain.files import read_limited

SETTLE_S = 0.5  # at the start, where the rotors' speeds are not known: the model has them settled
WINDOW_S = 0.02  # shorter holds gyro noise, longer holds drag
STEPS_MIN = 2000  # control steps
RATE_MIN_HZ = 250.0  # of a log: rotors move much between slower rows
MARGIN_MAX = 0.1  # half of a factor's 95 % interval: more is a flight without manoeuvres
FACTOR_MIN, FACTOR_MAX = 0.2, 5.0
EXPLAINED_MIN = 0.5
ROUNDS_MAX = 20  # of the fit, each with the coupling of the moments that the one before found
MOVED_MAX = 1e-4  # of a factor in a round that ends them


@dataclass(frozen=True, eq=False)
class Turning:
    """Motors and gyro of a flight, evenly spaced."""

    rate_hz: float
    motors: Array  # (N, M) fractions 0..1
    gyro: Array  # (N, 3) [rad/s]


@dataclass(frozen=True, eq=False)
class Factors:
    """Moment over inertia, relative to the file's; (3,) each, roll, pitch, yaw."""

    value: Array
    margin: Array  # half of the 95 % interval
    steady: Array  # [rad/s^2] that act besides: weight off centre, a weak motor
    explained: Array  # share of the variance of the rate's changes
    windows: int


def read_turning(path: Path, motors: int) -> Turning:
    """Read motors and gyro of a trace (.npz) or a blackbox log (FILE:N). Raises TraceError."""
    file, number = split_number(path)
    if file.suffix == ".npz":
        trace = load_trace(file)
        time, fractions, gyro = trace.t, trace.motors, trace.gyro.astype(np.float64)
    elif file.suffix in SUFFIXES:
        log = read_log(file, number)
        told = channels(log)
        rates = told.gyro_unfiltered if told.gyro_unfiltered is not None else told.gyro
        if told.motors is None or rates is None:
            raise TraceError(f"log {path}: has {told.motors_note or 'no motors or no gyro; log both'}")
        armed = np.flatnonzero(told.armed)
        if not len(armed):
            raise TraceError(f"log {path}: has no armed row: nothing was flown")
        part = slice(int(armed[0]), int(armed[-1]) + 1)
        check_motors(log, told, part)
        time = told.time(part.start)[: part.stop - part.start]
        fractions, gyro = told.motors[part], rates[part].astype(np.float64)
    else:
        raise TraceError(f"log {path}: expected a trace (.npz) or a blackbox log ({', '.join(SUFFIXES)})")
    if fractions.shape[1] != motors:
        raise TraceError(f"log {path}: {fractions.shape[1]} motors, the aircraft has {motors}")
    if len(time) < STEPS_MIN:
        raise TraceError(f"log {path}: {len(time)} rows, expected at least {STEPS_MIN}; fly longer")
    apart = np.diff(time)
    rate_hz = 1.0 / float(np.median(apart))
    if rate_hz < RATE_MIN_HZ or apart.max() > 1.5 / rate_hz or apart.min() <= 0.0:
        raise TraceError(
            f"log {path}: {rate_hz:.0f} rows a second, the longest gap {1e3 * apart.max():.1f} ms; expected "
            f"at least {RATE_MIN_HZ:g} a second without gaps"
        )
    return Turning(rate_hz, fractions, gyro)


def turning_factors(flown: Turning, aircraft: Aircraft, name: str) -> Factors:
    """Compute the factors of a flight. Raises TraceError if it does not determine them."""
    inertia = aircraft.mass_properties.inertia
    body, value = inertia.copy(), np.ones(3)
    for _ in range(ROUNDS_MAX):
        factors = _fit(flown, _accelerations(flown, aircraft, body), name)
        moved, value = np.abs(factors.value - value).max(), factors.value
        if moved < MOVED_MAX:
            break
        np.fill_diagonal(body, np.diag(inertia) / np.clip(value, FACTOR_MIN, FACTOR_MAX))
    _check(factors, name)
    return factors


def _fit(flown: Turning, expected: Array, name: str) -> Factors:
    """Fit the factors of the accelerations `expected` (N, 3) [rad/s^2]."""
    length = max(1, round(WINDOW_S * flown.rate_hz))
    first = round(SETTLE_S * flown.rate_hz)
    count = (len(flown.gyro) - 1 - first) // length
    at = first + np.arange(count + 1) * length
    changed = np.diff(flown.gyro[at], axis=0)
    sums = np.vstack([np.zeros(3), np.cumsum(expected, axis=0)])[at]
    made = np.diff(sums, axis=0) / flown.rate_hz
    angles = np.diff(np.vstack([np.zeros(3), np.cumsum(flown.gyro, axis=0)])[at], axis=0) / flown.rate_hz
    value, margin, steady, explained = (np.empty(3) for _ in range(4))
    for axis in range(3):
        # The third column: air that brakes the turning.
        columns = np.column_stack([made[:, axis], np.ones(count), angles[:, axis]])
        products = columns.T @ columns
        if np.linalg.det(products) <= 0.0 or not changed[:, axis].any():
            raise TraceError(f"{name}: {AXES[axis]} is never turned; fly steps of roll, pitch and yaw")
        inverse = np.linalg.inv(products)
        found = inverse @ columns.T @ changed[:, axis]
        left = changed[:, axis] - columns @ found
        value[axis], steady[axis] = found[0], found[1] / WINDOW_S
        margin[axis] = NORMAL * np.sqrt(inverse[0, 0] * left.var())
        explained[axis] = 1.0 - left.var() / changed[:, axis].var()
    return Factors(value, margin, steady, explained, count)


def _check(factors: Factors, name: str) -> None:
    for axis, words in enumerate(AXES):
        value, margin, told = (
            float(each[axis]) for each in (factors.value, factors.margin, factors.explained)
        )
        if margin > MARGIN_MAX or told < EXPLAINED_MIN:
            raise TraceError(
                f"{name}: {words} turns {value:.2f} ± {margin:.2f} of what the file says, {100 * told:.0f} "
                f"% explained; expected ± {MARGIN_MAX:g} and {100 * EXPLAINED_MIN:g} %: fly steps of every "
                "axis, or correct the aircraft file first"
            )
        if not FACTOR_MIN <= value <= FACTOR_MAX:
            raise TraceError(
                f"{name}: {words} turns {value:.2f} times as much as the file says, expected "
                f"{FACTOR_MIN:g} to {FACTOR_MAX:g}; this log is of another aircraft, or its motors "
                "stand in another order"
            )


def _accelerations(flown: Turning, aircraft: Aircraft, body: Array) -> Array:
    """Compute the angular acceleration [rad/s^2] (N, 3) of the file's aircraft in each row.

    body: moments (3, 3) [kg m^2] of what was flown, whose own turning couples the axes.
    """
    propulsion, dt = aircraft.propulsion, 1.0 / flown.rate_hz
    late = max(1, round(propulsion.delay * flown.rate_hz))  # rows until a command acts
    acting = np.vstack([np.repeat(flown.motors[:1], late, axis=0), flown.motors])[: len(flown.motors)]
    targets = target_speed(acting, propulsion)
    speeds = speeds_along(targets[0], targets, dt, propulsion)
    middle, gained = 0.5 * (speeds[1:] + speeds[:-1]), np.diff(speeds, axis=0)
    # At rest in the air, as far as a log without the velocity tells.
    still = np.zeros_like(flown.gyro)
    wrench = rotor_wrench(middle - gained, middle, dt, still, flown.gyro, rotor_geometry(aircraft))
    turning = np.cross(flown.gyro, flown.gyro @ body)
    found = np.linalg.solve(aircraft.mass_properties.inertia, (wrench[:, 3:] - turning).T).T
    return np.asarray(found, np.float64)


def adapted_text(source: str, aircraft: Aircraft, factors: Factors) -> bytes:
    """Return the aircraft file `source` (name or path) with the factors, as bytes that have been read back.

    Inertia is added as a part of 1 mg at the centre of mass. If an axis turns more than the file says, K_T
    is raised so far that no inertia has to be taken away. Raises AircraftError.
    """
    path = aircraft_file(source)
    if source.endswith(SUFFIX):
        raise AircraftError(
            f"{source}: got an aircraft with its propellers out, expected a file to be changed; reverse the "
            f"spins in a copy of {path.name} and name that"
        )
    text = read_limited(path, f"aircraft file {path}", FILE_BYTES_MAX, AircraftError).decode()
    moments = np.diag(aircraft.mass_properties.inertia)
    thrust = max(1.0, float(factors.value.max()))
    target = moments / factors.value
    if target.max() >= target.sum() - target.max():
        raise AircraftError(
            f"{source}: the flight tells moments in the ratio {', '.join(f'{v:.3g}' for v in target)}, which "
            "no rigid body has; fly longer, or correct the file first"
        )
    for _ in range(400):
        added = moments * (thrust / factors.value - 1.0)
        if added.max() <= 0.999 * (added.sum() - added.max()) or added.max() < 1e-9:
            break
        thrust *= 1.01  # until the added moments are those of a body
    added = np.maximum(added, 1e-12)
    centre = ", ".join(f"{value:.6g}" for value in aircraft.mass_properties.centre)
    terms = aircraft.propulsion.thrust_coefficient
    raised = tuple(float(f"{thrust * term:.6g}") for term in terms)
    why = f" K_T was raised to {thrust:.4g} times." if thrust > 1.0 else ""
    part = (
        "\n# By `neuroflight policy adapt`, from a flight: what the whole aircraft turns less than its parts"
        f" say.{why}\n"
        '[[part]]\nname = "adapted"\nmass_kg = 1e-6\nposition_m = [0.0, 0.0, 0.0]\nyaw_rad = 0.0\n'
        f"centre_of_mass_m = [{centre}]\n"
        f"inertia_kg_m2 = [{', '.join(f'{value:.6g}' for value in added)}]\n"
    )
    if thrust > 1.0:
        if "thrust_coefficient" not in tomllib.loads(text)["propulsion"]:
            raise TraceError(
                "the aircraft turns more than its file says, and the file gives no thrust_coefficient to "
                "raise: give it in place of c_t"
            )
        text = with_key(text, "propulsion", "thrust_coefficient", raised[0] if len(raised) == 1 else raised)
    data = (text.rstrip("\n") + "\n" + part).encode()
    parse_aircraft(data, f"adapted {path.name}", path.parent)
    return data
