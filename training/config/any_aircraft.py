"""Quadcopters drawn from all that fly: what a general policy is trained on.

A size is drawn, and all else with wide scatter around what aircraft of it have, so that no aircraft is
trained that nobody could build. Ranges are wider than those of the classes from whoops to lifters of 3 kg.
Sources of the middles: the NF1 (Koch 2019), the Iris, and the files of 5-inch aircraft; the scatter is this
project's choice.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from neuroflight.sim.aircraft.airframe import Rotor
from neuroflight.sim.aircraft.mass import MassProperties
from neuroflight.sim.aircraft.model import Aircraft, FirstOrderResponse, Propulsion, Response, TorqueResponse
from neuroflight.sim.control.told import told
from neuroflight.toolchain.contract import GRAVITY
from neuroflight.toolchain.policy.specialize import REFERENCE, Told

ARM_M = (0.021, 0.26)  # half of the distance between left and right motors: 60 mm whoops to 10 inch and more
MIDDLE_ARM_M = 0.075  # of a 5-inch aircraft
THRUST_TO_WEIGHT = (2.0, 14.0)
RADIUS = (0.4, 0.8)  # of gyration in roll, over the arm
LENGTH = (0.75, 1.35)  # of the distance of front and rear motors over that of left and right
RESPONSE_S = (0.007, 0.1)
# Of the aircraft, whose authority in roll is to be that of REFERENCE times one of these.
AUTHORITY = (0.06, 7.0)
OFF_CENTRE = 0.03  # standard deviation of the centre of mass, of the arm; the policy's model does not know it
TORQUE_LIMITED = 0.25  # of the aircraft: their rotors accelerate with a torque that has a limit


def draw_aircraft(base: Aircraft, rng: np.random.Generator) -> Aircraft:
    """Draw a quadcopter. base: has all that is not drawn, such as the gyro."""
    while True:
        aircraft = _drawn(base, rng)
        turning = told(aircraft).authority
        if all(
            AUTHORITY[0] <= own / usual <= AUTHORITY[1]
            for own, usual in zip(turning[:2], REFERENCE.authority[:2], strict=True)
        ):
            return aircraft


def difficulty(aircraft: Told) -> float:
    """Return about the error that an aircraft's commands make, over that of REFERENCE.

    A command of 2 rad/s waits for delay and rotors, and then takes the time that the motors' authority
    leaves.
    """

    def lost_s(of: Told) -> float:
        turning = math.sqrt(of.authority[0] * of.authority[1])
        return of.delay_s + 0.5 * (of.rise_s + of.fall_s) / 2.0 + 0.5 * 2.0 / (0.25 * turning) + 0.004

    return lost_s(aircraft) / lost_s(REFERENCE)


def _log(rng: np.random.Generator, low: float, high: float) -> float:
    """Draw log-uniformly."""
    return math.exp(rng.uniform(math.log(low), math.log(high)))


def _drawn(base: Aircraft, rng: np.random.Generator) -> Aircraft:
    arm = _log(rng, *ARM_M)
    size = arm / MIDDLE_ARM_M
    length = arm * _log(rng, *LENGTH)
    mass = 0.5 * size**2 * _log(rng, 0.6, 1.7)
    roll = mass * (arm * _log(rng, *RADIUS)) ** 2
    pitch = roll * (length / arm) ** 2 * _log(rng, 0.7, 1.4)
    inertia = np.diag([roll, pitch, (roll + pitch) * rng.uniform(0.8, 1.0)])
    height = rng.uniform(-0.1, 0.3) * arm
    usual = base.rotors
    ahead, aside = rng.normal(0.0, OFF_CENTRE * arm, 2).tolist()
    rotors = tuple(
        Rotor((math.copysign(length, at[0]) + ahead, math.copysign(arm, at[1]) + aside, height), rotor.spin)
        for at, rotor in zip(base.rotor_positions, usual, strict=True)
    )
    return replace(
        base,
        parts=(),
        rotors=rotors,
        mass_properties=MassProperties(mass, np.zeros(3), inertia),
        propulsion=_propulsion(base.propulsion, arm, mass, rng),
        battery=None,
        body=None,
    )


def _propulsion(base: Propulsion, arm: float, mass: float, rng: np.random.Generator) -> Propulsion:
    size, diameter = arm / MIDDLE_ARM_M, arm * rng.uniform(1.1, 1.8)
    most = _log(rng, *THRUST_TO_WEIGHT) * mass * GRAVITY / 4.0  # [N], of a rotor
    fastest = 2.0 * _log(rng, 110.0, 250.0) / diameter  # [rad/s], by the speed of its tips
    ratio = diameter * _log(rng, 0.05, 0.15)
    hover = fastest * math.sqrt(mass * GRAVITY / 4.0 / most)
    rotor = _log(rng, 0.07, 0.45) * 2.0 * ratio * most / fastest**2 * hover
    bend, start = rng.uniform(-0.75, 0.1), rng.uniform(0.0, 0.05)
    scale = most / base.thrust_coefficient[0] / base.speed_max / fastest  # of forces a speed
    return replace(
        base,
        speed_curve=(bend * fastest, (1.0 - bend - start) * fastest, start * fastest),
        thrust_coefficient=(most / fastest**2,),
        torque_ratio=(ratio,),
        rotor_inertia=rotor,
        response=_response(size, rotor, fastest, rng),
        drag_coefficient=base.drag_coefficient * scale,
        rolling_coefficient=base.rolling_coefficient * scale * size,
        delay=_log(rng, 0.001, 0.006),
        propeller_diameter=None,
        advance=None,
    )


def _response(size: float, rotor: float, fastest: float, rng: np.random.Generator) -> Response:
    rise = float(np.clip(0.030 * size**0.45 * _log(rng, 0.45, 2.2), *RESPONSE_S))
    if rng.random() < TORQUE_LIMITED:
        most = rotor * fastest / (rise * _log(rng, 1.5, 8.0))
        return TorqueResponse(rotor / rise, most, most * _log(rng, 1.0, 2.0))
    return FirstOrderResponse(rise, float(np.clip(rise * _log(rng, 0.8, 2.0), *RESPONSE_S)))
