"""Rotors: motor command to speed, speed to force and moment on the aircraft. Pure and vectorised.

Arrays are (N, M): N aircraft, M rotors in motor order. Forces and moments act at and about the centre of
mass, in body axes, stacked as a wrench (N, 6): force [N], then moment [N m].
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from sim.aircraft.model import Aircraft, Propulsion, TorqueResponse
from sim.physics.rotation import cross_matrix

Array = NDArray[np.float64]


def target_speed(command: Array, propulsion: Propulsion, voltage: Array | None = None) -> Array:
    """Speed that a motor command settles at [rad/s]; command is a fraction 0..1.

    voltage: of the battery under load [V], (N, 1); None: the supply the curve was measured with. Speed is
    taken as proportional to it. Source: Koch 2019, chapter 5: H(u), a quadratic fitted on the dynamometer.
    """
    a, b, c = propulsion.speed_curve
    speed: Array = (a * command + b) * command + c
    if voltage is not None and propulsion.supply_voltage is not None:
        speed *= voltage / propulsion.supply_voltage
    return speed


def next_speed(
    speed: Array, target: Array, dt: float, propulsion: Propulsion, lag: Array | float = 1.0
) -> Array:
    """Rotor speed [rad/s] after `dt` [s] towards a constant target; never below zero.

    lag: factor of the rotors' time constants, (N, 1) or one for all.
    TorqueResponse: I_r dw/dt = clamp(K (H(u) - w), -down, +up), exact while the clamp is away or holds
    throughout; source: facts of the published twin and Koch 2019, chapter 5. FirstOrderResponse: exact.
    """
    response = propulsion.response
    passed = dt / lag
    away = target - speed
    if isinstance(response, TorqueResponse):
        inertia = propulsion.rotor_inertia
        settle = _settled(-response.gain / inertia * passed)
        up = response.torque_up / inertia * passed
        down = response.torque_down / inertia * passed
        change = np.minimum(np.maximum(settle * away, -down), up)
    else:
        rise = -np.expm1(-passed / response.time_constant_up)
        fall = -np.expm1(-passed / response.time_constant_down)
        change = np.where(away > 0, rise, fall) * away
    after: Array = np.maximum(speed + change, 0.0)
    return after


def _settled(passed: Array | float) -> Array | float:
    """1 - exp(passed)."""
    return -np.expm1(passed) if isinstance(passed, np.ndarray) else _settled_alike(passed)


@lru_cache(maxsize=16)
def _settled_alike(passed: float) -> float:
    """As `_settled`, kept between steps: a scalar is the same at every step."""
    settled: np.float64 = -np.expm1(passed)
    return settled


def coefficient(polynomial: tuple[float, ...], speed: Array) -> Array | float:
    """A propulsion coefficient at rotor speeds [rad/s]; a constant stays a number."""
    *lower, value = polynomial
    at: Array | float = value
    for term in reversed(lower):
        at = at * speed + term
    return at


def thrust_and_torque(speed: Array, propulsion: Propulsion) -> tuple[Array, Array]:
    """Thrust [N] and drag torque [N m] of rotors at `speed` [rad/s], any shape: K_T w^2 and K_Q thrust."""
    thrust = coefficient(propulsion.thrust_coefficient, speed) * speed * speed
    return thrust, coefficient(propulsion.torque_ratio, speed) * thrust


@dataclass(frozen=True)
class RotorGeometry:
    """Constant maps from rotor speeds to wrenches, made once for an aircraft."""

    thrust_wrench: Array  # (M, 6): wrench a newton of each rotor's thrust
    torque_wrench: Array  # (M, 6): wrench a newton metre of each rotor's drag torque
    square_wrench: Array | None  # (M, 6): wrench a speed squared, if both coefficients are constants
    reaction_wrench: Array  # (M, 6): wrench a rad/s^2 of each rotor's acceleration
    motion_wrench: Array  # (6M, 6): wrench a speed * twist, twist = velocity, rate in body axes
    propulsion: Propulsion


def rotor_geometry(aircraft: Aircraft) -> RotorGeometry:
    """Maps of `aircraft`, about its centre of mass."""
    propulsion = aircraft.propulsion
    thrust, torque, reaction, motion = [], [], [], []
    up, nothing = np.array([0.0, 0.0, 1.0]), np.zeros(3)
    across = np.diag([1.0, 1.0, 0.0])
    for r, spin in zip(aircraft.rotor_positions, aircraft.spins, strict=True):
        thrust.append(np.concatenate([up, np.cross(r, up)]))
        # Air holds the propeller back: the body is turned against its spin.
        torque.append(np.concatenate([nothing, -spin * up]))
        momentum = spin * propulsion.rotor_inertia * up  # [N m s] a rad/s
        reaction.append(np.concatenate([nothing, -momentum]))
        # v_hub = v + w x r = v - [r] w; its part across the rotor axis makes drag and a rolling moment.
        hub = across @ np.hstack([np.eye(3), -cross_matrix(r)])
        force = -propulsion.drag_coefficient * hub
        moment = cross_matrix(r) @ force - propulsion.rolling_coefficient * hub
        # Gyroscopic moment: -w x h = h x w.
        moment[:, 3:] += cross_matrix(momentum)
        motion.append(np.vstack([force, moment]).T)
    thrust_wrench, torque_wrench = np.array(thrust), np.array(torque)
    square_wrench = None
    if len(propulsion.thrust_coefficient) == len(propulsion.torque_ratio) == 1:
        each = thrust_wrench + propulsion.torque_ratio[0] * torque_wrench
        square_wrench = propulsion.thrust_coefficient[0] * each
    return RotorGeometry(
        thrust_wrench=thrust_wrench,
        torque_wrench=torque_wrench,
        square_wrench=square_wrench,
        reaction_wrench=np.array(reaction),
        motion_wrench=np.concatenate(motion),
        propulsion=propulsion,
    )


def rotor_wrench(
    before: Array,
    after: Array,
    dt: float,
    velocity: Array,
    rate: Array,
    geometry: RotorGeometry,
    load_factor: Array | None = None,
) -> Array:
    """Wrench of all rotors on the aircraft over one step, (N, 6).

    before, after: rotor speeds (N, M) [rad/s] at the step's ends; velocity (N, 3) [m/s] of the centre of
    mass through the air and rate (N, 3) [rad/s], both in body axes. Thrust, drag torque, reaction to rotor
    acceleration, gyroscopic moment, rotor drag and rolling moment.
    load_factor: of the wrench of thrust and drag torque alone, (N, 6); see `load_factors`.
    """
    if geometry.square_wrench is not None:
        load = (after * after) @ geometry.square_wrench
    else:
        thrusts, torques = thrust_and_torque(after, geometry.propulsion)
        load = thrusts @ geometry.thrust_wrench + torques @ geometry.torque_wrench
    if load_factor is not None:
        load *= load_factor
    twist = np.concatenate([velocity, rate], axis=1)
    motion = (after[:, :, None] * twist[:, None, :]).reshape(len(after), -1)
    wrench: Array = (
        load + ((after - before) / dt) @ geometry.reaction_wrench + motion @ geometry.motion_wrench
    )
    return wrench


def load_factors(thrust: Array, torque: Array) -> Array:
    """Factors (N, 6) of the wrench of thrust and drag torque.

    thrust, torque: factors of thrust and of the torque ratio, (N,). Rotors are upright: thrust has no yaw
    moment, and drag torque has no other.
    """
    factors = np.repeat(thrust[:, None], 6, axis=1)
    factors[:, 5] *= torque
    return factors
