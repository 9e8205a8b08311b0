"""Rotors: motor command to speed, speed to force and moment on the aircraft. Pure and vectorised.

Arrays are (N, M): N aircraft, M rotors in motor order. Forces and moments act at and about the centre of
mass, in body axes, stacked as a wrench (N, 6): force [N], then moment [N m].
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.aircraft import Aircraft, Propulsion

Array = NDArray[np.float64]


def target_speed(command: Array, propulsion: Propulsion) -> Array:
    """Speed that a motor command settles at [rad/s]; command is a fraction 0..1.

    Source: Koch 2019, chapter 5: H(u), a quadratic fitted on the dynamometer.
    """
    a, b, c = propulsion.speed_curve
    speed: Array = (a * command + b) * command + c
    return speed


def next_speed(speed: Array, target: Array, dt: float, propulsion: Propulsion) -> Array:
    """Rotor speed [rad/s] after `dt` [s] towards a constant target.

    I_r dw/dt = clamp(K (H(u) - w), -down, +up): exact while the clamp is away or holds throughout.
    Source: facts of the published twin; Koch 2019, chapter 5.
    """
    inertia = propulsion.rotor_inertia
    settle = -np.expm1(-propulsion.response_gain / inertia * dt)
    up = propulsion.response_torque_up / inertia * dt
    down = propulsion.response_torque_down / inertia * dt
    change = np.minimum(np.maximum(settle * (target - speed), -down), up)
    after: Array = np.maximum(speed + change, 0.0)
    return after


@dataclass(frozen=True)
class RotorGeometry:
    """Constant maps from rotor speeds to wrenches, made once for an aircraft."""

    thrust_wrench: Array  # (M, 6): wrench a newton of thrust
    spin_inertia: Array  # (M,): signed rotor inertia [kg m^2], + counter-clockwise
    drag_wrench: Array  # (M, 36): -d wrench / d(speed * twist), twist = velocity, rate in body axes
    thrust_coefficient: float


def rotor_geometry(aircraft: Aircraft) -> RotorGeometry:
    """Maps of `aircraft`, about its centre of mass."""
    propulsion = aircraft.propulsion
    thrust, drag = [], []
    for r, spin in zip(aircraft.rotor_positions, aircraft.spins, strict=True):
        up = np.array([0.0, 0.0, 1.0])
        # Air holds the propeller back: the body is turned against its spin.
        thrust.append(np.concatenate([up, np.cross(r, up) - spin * propulsion.torque_ratio * up]))
        # v_hub = v + w x r = v - [r] w; its part across the rotor axis makes drag and a rolling moment.
        across = np.diag([1.0, 1.0, 0.0])
        hub = across @ np.hstack([np.eye(3), -_cross_matrix(r)])
        force = propulsion.drag_coefficient * hub
        moment = _cross_matrix(r) @ force + propulsion.rolling_coefficient * hub
        drag.append(np.vstack([force, moment]).ravel())
    return RotorGeometry(
        thrust_wrench=np.array(thrust),
        spin_inertia=aircraft.spins * propulsion.rotor_inertia,
        drag_wrench=np.array(drag),
        thrust_coefficient=propulsion.thrust_coefficient,
    )


def rotor_wrench(
    before: Array, after: Array, dt: float, velocity: Array, rate: Array, geometry: RotorGeometry
) -> Array:
    """Wrench of all rotors on the aircraft over one step, (N, 6).

    before, after: rotor speeds (N, M) [rad/s] at the step's ends; velocity (N, 3) [m/s] of the centre of
    mass through the air and rate (N, 3) [rad/s], both in body axes. Thrust K_T w^2, drag torque
    K_Q thrust, reaction to rotor acceleration, gyroscopic moment, rotor drag and rolling moment.
    """
    wrench = (geometry.thrust_coefficient * after * after) @ geometry.thrust_wrench
    momentum = after @ geometry.spin_inertia
    wrench[:, 3] -= rate[:, 1] * momentum
    wrench[:, 4] += rate[:, 0] * momentum
    wrench[:, 5] -= (after - before) @ geometry.spin_inertia / dt
    twist = np.concatenate([velocity, rate], axis=1)
    drag = (after @ geometry.drag_wrench).reshape(-1, 6, 6)
    wrench -= np.matmul(drag, twist[:, :, None])[:, :, 0]
    return wrench


def _cross_matrix(r: Array) -> Array:
    x, y, z = r
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
