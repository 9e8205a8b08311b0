"""The NF1's PID on any aircraft: its gains scaled by authority, axis by axis.

A gain turns deg/s into a motor fraction, and authority turns that into rad/s^2. With gains in the reverse
proportion of authority the loop of another aircraft is the NF1's again, but for lag, delay and noise.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np

from neuroflight.sim.aircraft.model import Aircraft, PidSettings, load_aircraft
from neuroflight.sim.arrays import Array
from neuroflight.sim.control.pid import Pid
from neuroflight.sim.control.pid_table import mixer, pid_settings
from neuroflight.toolchain.contract import GRAVITY
from neuroflight.training.evaluation.controllers import PID_RATE_HZ, ControllerSpec

SCALED = "pid:scaled"
REFERENCE, ITS_PID = "nf1", "flying"


def scaled_pid(aircraft: Aircraft) -> ControllerSpec:
    """Return the NF1's `flying` PID with gains for the aircraft."""
    reference = load_aircraft(REFERENCE)
    own = pid_settings(reference, ITS_PID)
    factor = authority(reference) / authority(aircraft)
    (roll, pitch, yaw) = (
        (scale * p, scale * i, scale * d) for scale, (p, i, d) in zip(factor.tolist(), own.gains, strict=True)
    )
    settings: PidSettings = replace(
        own, gains=(roll, pitch, yaw), mixer=None, nominal_voltage=aircraft.propulsion.supply_voltage
    )
    mix = mixer(aircraft)
    return ControllerSpec(
        name=SCALED,
        build=lambda count: Pid(mix, settings, count, PID_RATE_HZ),
        standing=lambda count: Pid(mix, settings, count, PID_RATE_HZ, standing=True),
        control_rate_hz=PID_RATE_HZ,
        idle=settings.idle,
        facts={"pid": "scaled"},
        mix=settings.mix,
        gyro_filters=settings.gyro_filters,
    )


def authority(aircraft: Aircraft) -> Array:
    """Compute what a unit of each axis' mixer turns the hovering aircraft by, (3,) [rad/s^2], rotors settled.

    In the mixer's senses, all positive. Where all commands together do not lift it, at full command.
    """
    drive, shares, motors = aircraft.propulsion, mixer(aircraft), aircraft.motor_count
    wanted = aircraft.mass_properties.mass * GRAVITY / motors
    u = hover_command(aircraft)
    a, b, _ = drive.speed_curve
    speed = max(speed_at(aircraft, u), 1e-3)
    steep = wanted / speed * 2.0 if u < 1.0 else 2.0 * _thrust(aircraft, speed) / speed  # [N s/rad]
    newtons = steep * (2.0 * a * u + b)  # a motor's thrust a unit of its command
    x, y = aircraft.rotor_positions[:, :2].T
    moments = np.stack([y, -x, -aircraft.spins * _value(drive.torque_ratio, speed)])  # a newton of each rotor
    turned = np.linalg.solve(aircraft.mass_properties.inertia, newtons * moments @ shares)
    found: Array = np.abs(np.diag(turned))
    return found


def hover_command(aircraft: Aircraft) -> float:
    """Return the motor fraction that carries the weight at the supply's voltage; 1 if none does."""
    wanted = aircraft.mass_properties.mass * GRAVITY / aircraft.motor_count
    low, high = 0.0, 1.0
    for _ in range(50):
        middle = (low + high) / 2
        low, high = (
            (middle, high) if _thrust(aircraft, speed_at(aircraft, middle)) < wanted else (low, middle)
        )
    return high


def thrust_to_weight(aircraft: Aircraft) -> float:
    """Return the thrust of all rotors at full command over the weight, at the supply's voltage."""
    full = aircraft.motor_count * _thrust(aircraft, speed_at(aircraft, 1.0))
    return full / (aircraft.mass_properties.mass * GRAVITY)


def speed_at(aircraft: Aircraft, command: float) -> float:
    """Return the speed [rad/s] that a motor command settles at."""
    a, b, c = aircraft.propulsion.speed_curve
    return min(a * command**2 + b * command + c, aircraft.propulsion.speed_max)


def _thrust(aircraft: Aircraft, speed: float) -> float:
    return _value(aircraft.propulsion.thrust_coefficient, speed) * speed**2


def _value(polynomial: tuple[float, ...], speed: float) -> float:
    return math.fsum(term * speed**power for power, term in enumerate(polynomial))


@cache
def reference_authority() -> tuple[float, float, float]:
    """Return the authority of the NF1."""
    roll, pitch, yaw = authority(load_aircraft(REFERENCE)).tolist()
    return roll, pitch, yaw
