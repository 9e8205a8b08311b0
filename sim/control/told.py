"""Computes what a general policy is told of an aircraft, from its file."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from neuroflight.sim.aircraft.model import Aircraft, TorqueResponse
from neuroflight.sim.control.authority import authority
from neuroflight.sim.control.estimator import hover_speed, observed_model
from neuroflight.sim.physics.rotor import thrust_and_torque
from neuroflight.toolchain.contract import ObservationTerm
from neuroflight.toolchain.errors import AircraftError
from neuroflight.toolchain.policy.model_constants import ModelConstants
from neuroflight.toolchain.policy.specialize import MOTORS, Told

MIDDLE = (0.1, 0.6)  # motor values between which thrust is taken as a straight line
LOW = (0.15, 0.25)


def told(aircraft: Aircraft) -> Told:
    """Compute the told numbers of a quadcopter.

    Raises AircraftError on any other, and on one that cannot turn.
    """
    if aircraft.motor_count != MOTORS:
        raise AircraftError(
            f"aircraft {aircraft.name} has {aircraft.motor_count} motors, a general policy flies {MOTORS}; "
            f"train one of its own"
        )
    propulsion, response = aircraft.propulsion, aircraft.propulsion.response
    hover = hover_speed(aircraft)
    torque = float(thrust_and_torque(hover, propulsion)[1])
    middle, low = authority(aircraft, MIDDLE), authority(aircraft, LOW)
    roll, pitch, yaw = middle.tolist()
    # Torque K_Q K_T w^2: for a rad/s more it is greater by 2 torque / w.
    drag = 2.0 * torque / hover
    if isinstance(response, TorqueResponse):
        rise = fall = propulsion.rotor_inertia / response.gain
        limit = propulsion.speed_max * propulsion.rotor_inertia / response.torque_up
    else:
        rise, fall, limit = response.time_constant_up, response.time_constant_down, 0.0
    try:
        return Told(
            authority=(roll, pitch, yaw),
            rise_s=rise,
            fall_s=fall,
            limit_s=limit,
            delay_s=propulsion.delay,
            kick_s=propulsion.rotor_inertia / drag,
            curve=float(low[0] / middle[0]),
            speed=propulsion.speed_max,
        )
    except ValueError as error:
        raise AircraftError(f"aircraft {aircraft.name} has no policy: {error}") from None


def told_model(
    aircraft: Aircraft, terms: tuple[ObservationTerm, ...], control_rate_hz: int
) -> ModelConstants | None:
    """Return the model that a general policy observes an aircraft by; None: it needs none.

    Its rotors stand evenly about the centre of mass, whatever the file says: so the policy finds the moment
    of a centre that is off in the rate that the model does not predict, whether anybody knew of it or not.
    """
    places = aircraft.rotor_positions
    off = places.mean(axis=0) * (1.0, 1.0, 0.0)
    centred = tuple(
        replace(rotor, position=tuple((place - off).tolist()))
        for rotor, place in zip(aircraft.rotors, places, strict=True)
    )
    mass = replace(aircraft.mass_properties, centre=np.zeros(3))
    return observed_model(replace(aircraft, rotors=centred, mass_properties=mass), terms, control_rate_hz)
