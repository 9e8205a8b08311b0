"""The drive of a typical rotor: propeller, motor and ESC by their printed sizes."""

from __future__ import annotations

import math
from dataclasses import dataclass

from neuroflight.sim.aircraft.typical.answers import Whole
from neuroflight.toolchain.contract import GRAVITY

AIR_DENSITY = 1.225  # [kg/m^3], standard atmosphere at sea level
CELL_LOADED = 3.7  # [V], a cell's nominal voltage
FIVE_INCH = 0.12954  # [m], 5.1 inch: the propeller that most of the numbers below are of
BELL_MASS, BELL_RADIUS = 0.45, 0.4775  # of a motor's mass; gyration radius, of its stator's diameter
BLADE = 0.05  # of a propeller's m D^2: a rod's twelfth, times 0.6 because blades taper
HALF_MORE = 0.03  # of full speed, by which half throttle turns faster than the equation says
SLOWER_DOWN = 1.35  # time constant of slowing down over that of speeding up; 1.3 to 2 in published twins
EFFICIENCY = 0.75  # of motor and ESC
IDLE = 0.003  # of full speed
RPM = 2 * math.pi / 60


@dataclass(frozen=True)
class Drive:
    """Numbers of one rotor."""

    thrust_coefficient: float  # K_T [N s^2/rad^2]
    torque_ratio: float  # K_Q [m]
    supply_voltage: float  # [V]
    speed_curve_rpm: tuple[float, float, float]
    propeller_mass: float  # [kg]
    propeller_inertia: float  # [kg m^2], about its axis
    rotor_inertia: float  # [kg m^2], with the motor's bell
    time_up: float  # [s]
    time_down: float  # [s]
    drag_coefficient: float  # [N s^2/(rad m)]
    rolling_coefficient: float  # [N s^2/rad]


def typical_drive(whole: Whole) -> Drive:
    """Compute the drive of an aircraft whose sizes are all told."""
    size = whole.diameter / FIVE_INCH
    c_t = static_thrust(whole.pitch / whole.diameter, whole.blades)
    k_t = c_t * AIR_DENSITY * whole.diameter**4 / (2 * math.pi) ** 2
    merit = figure_of_merit(whole.diameter, whole.blades)
    k_q = whole.diameter * math.sqrt(2 * c_t / math.pi) / (2 * math.pi * merit)
    strength = motor_strength(whole.motor_mass)
    volts = CELL_LOADED * whole.cells
    full, curve = speed_curve(whole.kv, volts, k_t * k_q, strength)
    propeller_mass = 0.0044 * size**2.1 * (whole.blades / 3) ** 0.8
    propeller_inertia = BLADE * propeller_mass * whole.diameter**2
    bell = BELL_MASS * whole.motor_mass * (BELL_RADIUS * whole.stator[0] / 1000) ** 2
    inertia = propeller_inertia + bell
    hover = min(math.sqrt(GRAVITY * whole.weight / 4 / k_t), full)
    # Near a hover: J dw/dt = -(strength + 2 K_T K_Q w) (w - w_wanted).
    time_up = inertia / (strength + 2 * k_t * k_q * hover)
    return Drive(
        thrust_coefficient=k_t,
        torque_ratio=k_q,
        supply_voltage=volts,
        speed_curve_rpm=curve,
        propeller_mass=propeller_mass,
        propeller_inertia=propeller_inertia,
        rotor_inertia=inertia,
        time_up=time_up,
        time_down=SLOWER_DOWN * time_up,
        drag_coefficient=8.0e-5 * size**3,
        rolling_coefficient=1.0e-6 * size**4,
    )


def static_thrust(pitch_ratio: float, blades: int) -> float:
    """Return C_T at rest of a propeller of that pitch over diameter.

    A line through static tests: UIUC's APC 10x4.7 SF (0.118), DA4002 5x3.75 (0.135), DA4052 5x3.75x3 (0.148),
    MicroInvent 5x4x3 (0.180); Mini Quad Test Bench, Emax Eco 2306 with HQ 5x4x3 (0.150, GF 0.172), 5x4.3x3
    (0.175), T-Motor 5143 (0.175), Gemfan 5149 (0.188); ctu-mrs, plastic 9450 and 1045 (0.110). Folding carbon
    propellers of 11 to 15 inch have 0.08 to 0.10.
    """
    return (0.05 + 0.11 * pitch_ratio) * math.sqrt(blades / 2)


def figure_of_merit(diameter: float, blades: int) -> float:
    """Return the ideal power of a propeller's thrust over its power, at rest; diameter [m].

    By the same tests: APC 10x4.7 SF 0.68; at low speeds MicroInvent 5x4x3 0.52, DA4052 5x3.75x3 0.44; the
    NF1's 0.62. Their electrical power says 0.45 to 0.56 with EFFICIENCY in it; the Eco 2306 0.50.
    """
    return 0.60 * math.pow(diameter / FIVE_INCH, 0.12) * math.pow(3 / blades, 0.1)


def motor_strength(mass: float) -> float:
    """Return K_t^2 / R [N m s/rad] of a motor of that mass [kg] with its ESC and leads.

    It grows as the mass to the power of 5/3, as for motors of one shape, less below 20 g. Through what motors
    lose of their no-load speed in the tests above: 4114 (148 g) 2.7e-3, 3110 (70 g) 8.6e-4, 2306 (28 g)
    1.4e-4, 2207 (29 g) 2.3e-4; a cheap 2312 (50 g) has 2.4e-4, the NF1's 2204 (20 g) 3.6e-5, half of it.
    """
    return 0.06 * math.pow(mass, 5 / 3) * math.pow(min(1.0, mass / 0.020), 0.4)


def speed_curve(
    kv: float, volts: float, drag: float, strength: float
) -> tuple[float, tuple[float, float, float]]:
    """Return full speed [rad/s], and a, b, c [rpm] of the speed over throttle.

    The balance of a motor under load, u V = w / K + R I with I = K `drag` w^2 and R = 1 / (K^2 strength), K
    being Kv in rad/s a volt. At half throttle the tests above turn at 0.57 to 0.63 of full speed, 0.03 more
    than by that equation.
    """
    free = kv * RPM * volts
    load = drag / (kv * RPM * strength)  # [V s^2/rad^2], lost in the winding
    full = (math.sqrt(1 / (kv * RPM) ** 2 + 4 * load * volts) - 1 / (kv * RPM)) / (2 * load)
    held = full / free
    half = (math.sqrt(held**2 + 2 * (1 - held)) - held) / (2 * (1 - held)) + HALF_MORE
    linear = 4 * half - 1  # b of a u^2 + b u with a + b = 1 and a / 4 + b / 2 = half
    rpm = full / RPM
    return full, ((1 - linear) * rpm, (linear - IDLE) * rpm, IDLE * rpm)
