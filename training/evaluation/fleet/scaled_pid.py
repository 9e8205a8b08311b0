"""The NF1's PID on any aircraft: its gains scaled by authority, axis by axis.

A gain turns deg/s into a motor fraction, and authority turns that into rad/s^2. With gains in the reverse
proportion of authority the loop of another aircraft is the NF1's again, but for lag, delay and noise.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from neuroflight.sim.aircraft.model import Aircraft, PidSettings, load_aircraft
from neuroflight.sim.arrays import Array
from neuroflight.sim.control.pid import Pid
from neuroflight.sim.control.pid_table import mixer, pid_settings
from neuroflight.sim.design.figures import aircraft_figures, thrust_map
from neuroflight.sim.physics.rotor import target_speed, thrust_and_torque
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
    drive, hover = aircraft.propulsion, aircraft_figures(aircraft).hover
    command = 1.0 if hover is None else float(hover.throttle.mean())
    speed = float(target_speed(command, drive))
    a, b, _ = drive.speed_curve
    thrust, torque = (float(load) for load in thrust_and_torque(speed, drive))
    newtons = 2.0 * thrust / max(speed, 1e-3) * (2.0 * a * command + b)  # of a motor a unit of its command
    moments = thrust_map(aircraft, np.full(aircraft.motor_count, torque / thrust))[1:]
    turned = np.linalg.solve(aircraft.mass_properties.inertia, newtons * moments @ mixer(aircraft))
    found: Array = np.abs(np.diag(turned))
    return found


@cache
def reference_authority() -> tuple[float, float, float]:
    """Return the authority of the NF1."""
    roll, pitch, yaw = authority(load_aircraft(REFERENCE)).tolist()
    return roll, pitch, yaw
