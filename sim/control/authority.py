"""The authority of an aircraft: how much its motors turn it."""

from __future__ import annotations

import numpy as np

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.arrays import Array
from neuroflight.sim.physics.rotor import rotor_geometry, target_speed, thrust_and_torque

STEP = 1e-3  # of a motor value, at which a slope is taken


def authority(aircraft: Aircraft, between: tuple[float, float]) -> Array:
    """Compute the angular acceleration about each axis for a motor fraction, (3,) [rad/s^2].

    Every motor adds the fraction or takes it away, as the axis needs, and the rotors have settled. It is the
    mean over the motor values of a range.
    """
    speeds, geometry = target_speed(np.array(between), aircraft.propulsion), rotor_geometry(aircraft)
    thrust, torque = (
        np.diff(load).item() / (between[1] - between[0])
        for load in thrust_and_torque(speeds, aircraft.propulsion)
    )
    moments = geometry.thrust_wrench[:, 3:] * thrust + geometry.torque_wrench[:, 3:] * torque
    inverse = np.diag(np.linalg.inv(aircraft.mass_properties.inertia))
    found: Array = np.abs(moments).sum(axis=0) * inverse
    return found


def authority_at(aircraft: Aircraft, motors: float) -> Array:
    """Compute the authority of motors at a value 0..1; see `authority`."""
    low = min(max(motors - STEP / 2.0, 0.0), 1.0 - STEP)
    return authority(aircraft, (low, low + STEP))
