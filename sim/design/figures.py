"""Figures that follow from an aircraft file: mass, hover, control authority, endurance."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np

from neuroflight.sim.aircraft.mass import principal
from neuroflight.sim.aircraft.model import Aircraft, Battery
from neuroflight.sim.arrays import Array
from neuroflight.sim.physics.battery import loaded_voltage, open_circuit_voltage
from neuroflight.sim.physics.rotor import coefficient, target_speed, thrust_and_torque
from neuroflight.toolchain.contract import GRAVITY

HOVER_PASSES = 5  # K_Q depends on the speed, if at all, weakly
SPEEDS = 2001  # points of the grid on which speed and throttle are looked up
CHARGE_USED = 0.8  # of a full pack: the usual limit for its health


@dataclass(frozen=True)
class Hover:
    """Hovering in still air, on the bench supply."""

    thrust: Array  # (M,) [N]
    speed: Array  # (M,) [rad/s]
    throttle: Array  # (M,), 0..1
    power: float  # [W], electrical, of motors and electronics


@dataclass(frozen=True)
class Endurance:
    """Current and flight time on the battery."""

    current: float  # [A], with a full pack
    seconds: float  # from full to 20 % left
    full_throttle_current: float  # [A], with a full pack
    full_throttle_voltage: float  # [V], with a full pack; 0: more than it can give


@dataclass(frozen=True)
class AircraftFigures:
    """Figures that follow from an aircraft file."""

    mass: float  # [kg]
    centre: Array  # (3,) [m], of mass, body frame
    inertia: Array  # (3, 3) [kg m^2], about it, body axes
    principal_moments: Array  # (3,) [kg m^2], each at the body axis its own axis is nearest to
    principal_axes: Array  # (3, 3), the columns
    wheelbase: float  # [m], longest distance between hubs
    reach: float  # [m], from the centre of mass to the farthest hub, seen from above
    thrust_max: float  # [N], all rotors
    thrust_to_weight: float
    hover: Hover | None  # None: it cannot
    acceleration: Array  # (3,) [rad/s^2], most about each axis alone, whatever the thrust; weaker direction
    hover_acceleration: Array  # (3,) [rad/s^2], the same with the thrust held at the weight
    endurance: Endurance | None  # None: no battery, or no hover


def aircraft_figures(aircraft: Aircraft) -> AircraftFigures:
    """Compute all figures of an aircraft."""
    properties, propulsion = aircraft.mass_properties, aircraft.propulsion
    weight = GRAVITY * properties.mass
    moments, axes = principal(properties.inertia)
    hubs = aircraft.rotor_positions
    thrust_max = float(thrust_and_torque(np.array(propulsion.speed_max), propulsion)[0])
    hover = hovering(aircraft)
    speed = np.full(aircraft.motor_count, propulsion.speed_max) if hover is None else hover.speed
    rows = thrust_map(aircraft, coefficient(propulsion.torque_ratio, speed) * np.ones(aircraft.motor_count))
    return AircraftFigures(
        mass=properties.mass,
        centre=properties.centre,
        inertia=properties.inertia,
        principal_moments=moments,
        principal_axes=axes,
        wheelbase=max(math.dist(a, b) for a, b in combinations(hubs.tolist(), 2)),
        reach=float(np.hypot(hubs[:, 0], hubs[:, 1]).max()),
        thrust_max=thrust_max * aircraft.motor_count,
        thrust_to_weight=thrust_max * aircraft.motor_count / weight,
        hover=hover,
        acceleration=_accelerations(rows, properties.inertia, thrust_max, None),
        hover_acceleration=_accelerations(rows, properties.inertia, thrust_max, weight),
        endurance=None if hover is None else _endurance(aircraft, hover),
    )


def hover_throttle(aircraft: Aircraft, idle: float) -> float | None:
    """Compute the pilot's throttle, above motors at `idle`, that holds the weight on the bench supply.

    The mixer adds throttle to all motors alike. None: the aircraft cannot hover.
    """
    hover = hovering(aircraft)
    return None if hover is None else float(np.clip((hover.throttle.mean() - idle) / (1.0 - idle), 0.0, 1.0))


def thrust_map(aircraft: Aircraft, ratio: Array) -> Array:
    """Return thrust, roll, pitch and yaw moment for a newton of each rotor, (4, M).

    ratio: K_Q [m] of each rotor, (M,).
    """
    x, y, _ = aircraft.rotor_positions.T
    return np.stack([np.ones_like(x), y, -x, -aircraft.spins * ratio])


def balanced_thrust(rows: Array, wanted: Array, high: float) -> Array | None:
    """Compute thrusts t (M,), 0 <= t <= high, with rows @ t = wanted, on as many rotors as can share it.

    rows: (K, M). None if there is no solution. Of several, the one with the least sum of squares.
    """
    count = rows.shape[1]
    scale = np.abs(rows).max(axis=1)
    for size in range(count, 0, -1):
        for rotors in combinations(range(count), size):
            part = rows[:, rotors]
            thrust = np.linalg.lstsq(part, wanted, rcond=None)[0]
            missed = np.abs(part @ thrust - wanted) / scale
            if missed.max() < 1e-6 * high and thrust.min() > -1e-9 * high and thrust.max() <= high:
                whole = np.zeros(count)
                whole[list(rotors)] = thrust.clip(0.0)
                return whole
    return None


def greatest_moment(moment: Array, rows: Array, wanted: Array, high: float) -> float:
    """Compute the largest moment @ t with 0 <= t <= high and rows @ t = wanted; 0 without a solution.

    moment: (M,), rows: (K, M) with K < M. A linear programme: the best is a corner, where all but K rotors
    stand at a limit; M is small enough to visit every corner.
    """
    count, bound = rows.shape[1], len(rows)
    corners = np.array(list(product((0.0, high), repeat=count - bound)))
    best = 0.0
    for free in combinations(range(count), bound):
        part = rows[:, free]
        if np.linalg.cond(part) > 1e9:
            continue
        fixed = [rotor for rotor in range(count) if rotor not in free]
        found = np.linalg.solve(part, wanted[:, None] - rows[:, fixed] @ corners.T)
        fits = ((found > -1e-9 * high) & (found < (1 + 1e-9) * high)).all(axis=0)
        values = moment[list(free)] @ found + corners @ moment[fixed]
        best = max(best, float(values[fits].max(initial=0.0)))
    return best


def hovering(aircraft: Aircraft) -> Hover | None:
    """Compute the hover on the bench supply; None: the aircraft cannot."""
    propulsion, weight = aircraft.propulsion, GRAVITY * aircraft.mass_properties.mass
    thrust_max = float(thrust_and_torque(np.array(propulsion.speed_max), propulsion)[0])
    speeds = np.linspace(0.0, propulsion.speed_max, SPEEDS)
    thrusts = np.maximum.accumulate(thrust_and_torque(speeds, propulsion)[0])
    throttles = np.linspace(0.0, 1.0, SPEEDS)
    speed = np.full(aircraft.motor_count, propulsion.speed_max)
    wanted = np.array([weight, 0.0, 0.0, 0.0])
    for _ in range(HOVER_PASSES):
        ratio = coefficient(propulsion.torque_ratio, speed) * np.ones(aircraft.motor_count)
        found = balanced_thrust(thrust_map(aircraft, ratio), wanted, thrust_max)
        if found is None:
            return None
        thrust, speed = found, np.interp(found, thrusts, speeds)
    throttle = np.interp(speed, target_speed(throttles, propulsion), throttles)
    return Hover(thrust, speed, throttle, _power(aircraft, speed))


def _power(aircraft: Aircraft, speed: Array) -> float:
    """Compute the electrical power [W] at steady rotor speeds (M,), electronics included."""
    torque = thrust_and_torque(speed, aircraft.propulsion)[1]
    electronics = 0.0 if aircraft.battery is None else aircraft.battery.electronics_power
    return float(speed @ torque) / aircraft.propulsion.efficiency + electronics


def _accelerations(rows: Array, inertia: Array, high: float, weight: float | None) -> Array:
    """Compute the largest acceleration about each axis, without moment about the others, (3,)."""
    inverse = np.linalg.inv(inertia)
    found = np.zeros(3)
    for axis in range(3):
        others = [row for row in range(1, 4) if row != axis + 1]
        wanted = np.zeros(2)
        if weight is not None:
            others, wanted = [0, *others], np.array([weight, 0.0, 0.0])
        if np.linalg.matrix_rank(rows[others]) < len(others):
            continue
        moment = rows[axis + 1]
        found[axis] = min(greatest_moment(sign * moment, rows[others], wanted, high) for sign in (1, -1))
    return found * np.diag(inverse)


def _endurance(aircraft: Aircraft, hover: Hover) -> Endurance | None:
    battery = aircraft.battery
    if battery is None:
        return None
    full = np.full(aircraft.motor_count, aircraft.propulsion.speed_max)
    most = _power(aircraft, full)
    voltage = _loaded(battery, 1.0, most)
    charge = np.linspace(1.0, 1.0 - CHARGE_USED, 101)
    currents = np.array([hover.power / max(_loaded(battery, left, hover.power), 1e-9) for left in charge])
    return Endurance(
        current=float(currents[0]),
        seconds=CHARGE_USED * battery.capacity * float(np.mean(1.0 / currents)),
        full_throttle_current=most / voltage if voltage > 0.0 else math.inf,
        full_throttle_voltage=voltage,
    )


def _loaded(battery: Battery, charge: float, power: float) -> float:
    """Compute the voltage [V] of a pack at `charge` that gives `power` [W]; 0 if it cannot."""
    open_circuit = open_circuit_voltage(battery, np.array(charge))
    if 4 * battery.resistance * power > open_circuit**2:
        return 0.0
    return float(loaded_voltage(open_circuit, np.array(power), battery.resistance))
