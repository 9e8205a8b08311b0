"""Aircraft whose numbers nobody is told: what `neuroflight aircraft fit` is judged by.

Each of CLASSES, whoop to 10 inch, is drawn anew about what its class has: inertia about each axis, thrust,
the rotors' response, delay, curve, torque, rotor inertia, gyro noise and vibration, motors that differ,
wind and gusts, a battery that sags. hidden_flights.py flies them. Nothing here uses what it judges.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from neuroflight.sim.aircraft.model import Aircraft, FirstOrderResponse, parse_aircraft
from neuroflight.sim.arrays import Array
from neuroflight.sim.physics.rotor import target_speed, thrust_and_torque
from neuroflight.toolchain.contract import GRAVITY

INCH = 0.0254


@dataclass(frozen=True)
class Class:
    """A typical aircraft of its size; from memory of published builds."""

    name: str
    mass: float  # [kg]
    arm: float  # [m], centre to motor
    propeller: str  # inches: diameter x pitch x blades
    cells: int
    speed_max: float  # [rpm], loaded
    thrust_to_weight: float
    up_s: float  # rotors' time constant, gaining speed
    capacity: float  # [Ah]


CLASSES = (
    Class("whoop65", 0.031, 0.0325, "1.22x1.2x4", 1, 47000, 3.0, 0.018, 0.30),
    Class("whoop75", 0.045, 0.0375, "1.57x1.5x3", 1, 39000, 3.2, 0.022, 0.45),
    Class("inch2", 0.105, 0.052, "2.5x2.0x3", 3, 42000, 6.0, 0.018, 0.45),
    Class("inch3", 0.190, 0.070, "3x2.5x3", 4, 39000, 7.5, 0.020, 0.65),
    Class("cinewhoop3", 0.420, 0.074, "3x3x5", 4, 33000, 3.8, 0.026, 0.85),
    Class("inch4", 0.340, 0.088, "4x3x2", 4, 33000, 7.5, 0.024, 0.85),
    Class("inch5light", 0.420, 0.106, "5.1x4.3x3", 4, 28000, 9.0, 0.026, 1.3),
    Class("inch5", 0.640, 0.110, "5.1x4.3x3", 6, 29000, 8.0, 0.024, 1.3),
    Class("inch5heavy", 0.820, 0.114, "5x5.1x3", 6, 28000, 5.8, 0.028, 1.5),
    Class("inch6", 0.860, 0.132, "6x4.5x3", 6, 23000, 6.0, 0.034, 1.8),
    Class("inch7", 1.050, 0.160, "7x4x3", 6, 19000, 5.0, 0.044, 2.6),
    Class("inch10", 2.300, 0.230, "10x5x3", 6, 12500, 3.6, 0.065, 5.0),
)


@dataclass(frozen=True)
class Hidden:
    """An aircraft that was drawn, and the air it flies in."""

    name: str
    text: str  # the true file
    shares: tuple[float, ...]  # of each motor's thrust at a command
    charge: float
    wind: tuple[float, float, float]
    gust: float
    told_weight: float  # [kg] what the pilot knows
    told_arm: float  # [m]
    told_propeller: str

    @property
    def aircraft(self) -> Aircraft:
        """The true aircraft, its motors alike."""
        return parse_aircraft(self.text.encode(), f"hidden twin {self.name}")


def draw(kind: Class, seed: int) -> Hidden:
    """Draw an aircraft of `kind`."""
    rng = np.random.default_rng((seed, CLASSES.index(kind)))

    def about(value: float, spread: float) -> float:
        return float(value * math.exp(rng.uniform(-1, 1) * math.log(spread)))

    diameter = float(kind.propeller.split("x")[0]) * INCH
    mass = about(kind.mass, 1.1)
    top = about(kind.speed_max, 1.1)
    thrust_to_weight = about(kind.thrust_to_weight, 1.25)
    bend = float(rng.uniform(0.1, 0.42))
    start = float(rng.uniform(0, 0.004)) * top
    b = (top - start) / (1 - bend)
    w_max = top * 2 * math.pi / 60
    k_t = thrust_to_weight * mass * GRAVITY / 4 / w_max**2
    inertia_x = mass * (about(0.46, 1.2) * kind.arm) ** 2
    inertia_y = inertia_x * about(1.1, 1.3)
    inertia_z = (inertia_x + inertia_y) * float(rng.uniform(0.8, 0.97))
    across = kind.arm / math.sqrt(2)
    wide = about(1.0, 1.08)
    x, y = across * wide, across / wide
    hub = float(rng.uniform(-0.1, 0.15)) * kind.arm
    off = rng.uniform(-0.03, 0.03, 2) * kind.arm
    up = about(kind.up_s, 1.4)
    cells_v = kind.cells * 4.2
    supply = kind.cells * 3.85
    resistance = about(0.006 * kind.cells / max(kind.capacity, 0.3), 1.4)
    delay = float(rng.uniform(0.001, 0.0045))
    rotor_inertia = about(7.6e-6 * (diameter / 0.1295) ** 4.3, 1.5)
    # Small parts at the motors; the body's moments are then what makes the whole's as drawn.
    motor = 0.02 * mass
    points = 4 * motor * np.array([y * y, x * x, x * x + y * y])
    left = np.array([inertia_x, inertia_y, inertia_z]) - points
    body = mass - 4 * motor
    lines = [
        "format = 1",
        f'name = "{kind.name}"',
        f"centre_of_thrust_m = [0, 0, {hub:.6g}]",
        "[[part]]",
        'name = "body"',
        f"mass_kg = {body:.6g}",
        f"position_m = [{off[0]:.6g}, {off[1]:.6g}, 0]",
        "centre_of_mass_m = [0, 0, 0]",
        f"inertia_kg_m2 = [{left[0]:.6g}, {left[1]:.6g}, {left[2]:.6g}]",
        "[motor_part]",
        f"mass_kg = {motor:.6g}",
        "centre_of_mass_m = [0, 0, 0]",
        "inertia_kg_m2 = [1e-10, 1e-10, 1e-10]",
        "[propeller_part]",
        "mass_kg = 1e-6",
        "centre_of_mass_m = [0, 0, 0]",
        "inertia_kg_m2 = [1e-11, 1e-11, 1e-11]",
    ]
    for sx, sy, spin in ((-1, -1, "cw"), (1, -1, "ccw"), (-1, 1, "ccw"), (1, 1, "cw")):
        place = f"[{sx * x:.6g}, {sy * y:.6g}"
        lines += [
            "[[rotor]]",
            f"motor_m = {place}, 0]",
            f"propeller_m = {place}, {hub:.6g}]",
            f'spin = "{spin}"',
        ]
    lines += [
        "[propulsion]",
        f"propeller_diameter_m = {diameter:.6g}",
        f"speed_curve_rpm = [{-bend * b:.6g}, {b:.6g}, {start:.6g}]",
        f"thrust_coefficient = {k_t:.6g}",
        f"torque_ratio_m = {about(0.085, 1.4) * diameter:.6g}",
        f"supply_voltage_v = {supply:.6g}",
        f"rotor_inertia_kg_m2 = {rotor_inertia:.6g}",
        f"drag_coefficient = {8e-5 * (diameter / 0.1295) ** 2:.6g}",
        f"rolling_coefficient = {1e-6 * (diameter / 0.1295) ** 3:.6g}",
        f"delay_s = {round(delay * 2000) / 2000:.6g}",
    ]
    if rng.random() < 0.5:
        lines += ["[propulsion.advance_ratio]", f"thrust = [{rng.uniform(-1.1, -0.5):.4g}, 0.0]"]
        lines.append(f"torque = [{rng.uniform(-0.6, -0.2):.4g}, 0.0]")
    lines += [
        "[propulsion.response]",
        'kind = "first_order"',
        f"time_constant_up_s = {up:.6g}",
        f"time_constant_down_s = {up * rng.uniform(0.9, 1.6):.6g}",
        "[gyro]",
        f"noise_deg_s = [{', '.join(f'{value:.4g}' for value in rng.uniform(0.4, 2.0, 3))}]",
        "bias_deg_s = 0.4",
        f"bandwidth_hz = {rng.choice([250, 500, 1000])}",
        f"vibration_deg_s = [{', '.join(f'{value:.4g}' for value in rng.uniform(3, 25, 3))}]",
        f"misalignment_deg = [{', '.join(f'{value:.3g}' for value in rng.uniform(-1.5, 1.5, 3))}]",
        "[battery]",
        f"cells = {kind.cells}",
        f"capacity_ah = {kind.capacity}",
        f"rest_voltage_v = {cells_v:.6g}",
        f"resistance_ohm = {resistance:.4g}",
        "[body]",
        f"size_m = [{1.6 * kind.arm:.4g}, {1.6 * kind.arm:.4g}, {0.6 * kind.arm:.4g}]",
        "centre_m = [0, 0, 0]",
        f"drag_area_m2 = [{0.9 * kind.arm**2:.4g}, {0.9 * kind.arm**2:.4g}, {1.6 * kind.arm**2:.4g}]",
    ]
    shares = rng.uniform(0.9, 1.0, 4)
    blows, way = rng.uniform(0, 5), rng.uniform(-math.pi, math.pi)
    return Hidden(
        kind.name,
        "\n".join(lines) + "\n",
        tuple(float(value) for value in shares),
        charge=float(rng.uniform(0.55, 1.0)),
        wind=(float(blows * math.cos(way)), float(blows * math.sin(way)), 0.0),
        gust=float(rng.uniform(0, 8)),
        told_weight=float(round(about(mass, 1.02), 4)),
        told_arm=float(round(about(kind.arm, 1.03), 4)),
        told_propeller=kind.propeller,
    )


def hover(aircraft: Aircraft, volts: float | None = None) -> float:
    """Find the motor value at which the aircraft hovers."""
    low, high = 0.0, 1.0
    for _ in range(40):
        at = 0.5 * (low + high)
        thrust, _ = thrust_and_torque(target_speed(at, aircraft.propulsion, volts), aircraft.propulsion)
        lifts = aircraft.motor_count * float(thrust) > aircraft.mass_properties.mass * GRAVITY
        low, high = (low, at) if lifts else (at, high)
    return at


def authority(
    aircraft: Aircraft, at: float, volts: float | None = None, shares: Sequence[float] = (1.0, 1.0, 1.0, 1.0)
) -> Array:
    """Compute the angular acceleration (3,) [rad/s^2] a motor value of each motor, about roll, pitch, yaw.

    Each motor moves by 1 the way that turns the aircraft that way, from the value `at`, at rest. volts: of
    the battery; None: the supply of the speed curve. shares: of each motor's thrust at a command.
    """
    step, propulsion = 1e-4, aircraft.propulsion
    either = [
        thrust_and_torque(target_speed(at + sign * step, propulsion, volts), propulsion) for sign in (-1, 1)
    ]
    thrust, torque = (
        float(more - less) / (2 * step) * np.array(shares) for less, more in zip(*either, strict=True)
    )
    places = np.abs(aircraft.rotor_positions)
    moments = np.array([thrust @ places[:, 1], thrust @ places[:, 0], torque.sum()])
    turned: Array = moments / np.diag(aircraft.mass_properties.inertia)
    return turned


def kick(
    aircraft: Aircraft, at: float, volts: float | None = None, shares: Sequence[float] = (1.0, 1.0, 1.0, 1.0)
) -> float:
    """Compute the change of yaw rate [rad/s] a motor value of each motor by the rotors' own speeding up.

    See authority. Rotor inertia alone cannot be told without the rotors' speeds: what is felt is this.
    """
    step, propulsion = 1e-4, aircraft.propulsion
    less, more = (float(target_speed(at + sign * step, propulsion, volts)) for sign in (-1, 1))
    faster = (more - less) / (2 * step) * float(np.sqrt(shares).sum())
    return faster * propulsion.rotor_inertia / float(aircraft.mass_properties.inertia[2, 2])


def response(aircraft: Aircraft, at: float) -> tuple[float, float]:
    """Return the rotors' time constants [s] for small steps up and down at the motor value `at`."""
    told = aircraft.propulsion.response
    if isinstance(told, FirstOrderResponse):
        return told.time_constant_up, told.time_constant_down
    lag = aircraft.propulsion.rotor_inertia / told.gain
    return lag, lag


def loop_parameters(
    aircraft: Aircraft, at: float, volts: float | None = None, shares: Sequence[float] = (1.0, 1.0, 1.0, 1.0)
) -> dict[str, float]:
    """Return what a rate controller needs to know of an aircraft, about the motor value `at`."""
    turns = authority(aircraft, at, volts, shares)
    up, down = response(aircraft, at)
    high = authority(aircraft, min(0.9, at + 0.3), volts, shares)
    return {
        "authority_roll": float(turns[0]),
        "authority_pitch": float(turns[1]),
        "authority_yaw": float(turns[2]),
        "up_s": up,
        "down_s": down,
        "delay_s": aircraft.propulsion.delay,
        "authority_rise": float(high[0] / turns[0]),  # by a motor value that is 0.3 higher
        "kick_yaw": kick(aircraft, at, volts, shares),
    }
