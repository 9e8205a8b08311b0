"""Rotors: motor command to speed, speed to force and moment on the aircraft. Computed by rotor.c.

Arrays are (N, M): N aircraft, M rotors in motor order. Forces and moments act at and about the centre of
mass, in body axes, stacked as a wrench (N, 6): force [N], then moment [N m].
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from neuroflight.sim.aircraft.model import Aircraft, Propulsion, TorqueResponse
from neuroflight.sim.arrays import Array
from neuroflight.sim.physics.library import assign, elements, library, pointer, struct
from neuroflight.sim.physics.rotation import cross_matrix


@lru_cache(maxsize=64)
def propulsion_struct(propulsion: Propulsion) -> Any:  # noqa: ANN401 - a struct of cffi
    """Return the propulsion as C has it."""
    made = struct(
        "propulsion",
        speed_curve=propulsion.speed_curve,
        thrust=_polynomial(propulsion.thrust_coefficient),
        torque=_polynomial(propulsion.torque_ratio),
        rotor_inertia=propulsion.rotor_inertia,
        efficiency=propulsion.efficiency,
        limited=isinstance(propulsion.response, TorqueResponse),
    )
    if isinstance(propulsion.response, TorqueResponse):
        assign(made, speed_max=propulsion.response.speed_max)
    if propulsion.advance is not None:
        assert propulsion.propeller_diameter is not None  # the reader of the file
        assign(
            made,
            diameter=propulsion.propeller_diameter,
            thrust_advance=propulsion.advance.thrust,
            torque_advance=propulsion.advance.torque,
            advance_least=propulsion.advance.ratio_least,
            advance_max=propulsion.advance.ratio_max,
        )
    return made


def _polynomial(terms: tuple[float, ...]) -> dict[str, object]:
    return {"terms": len(terms), "term": terms}


def target_speed(command: ArrayLike, propulsion: Propulsion, voltage: ArrayLike | None = None) -> Array:
    """Compute the speed that a motor command settles at [rad/s]; command is a fraction 0..1.

    voltage: of the battery under load [V], of a shape that broadcasts with `command`'s; None: the supply the
    curve was measured with.
    """
    known = propulsion.supply_voltage
    ratio = 1.0 if voltage is None or known is None else np.asarray(voltage) / known
    at, scale = elements(command, ratio)
    speed = np.empty_like(at)
    library().lib.rotor_target_speeds(
        propulsion_struct(propulsion), at.size, pointer(at), pointer(scale), pointer(speed)
    )
    return speed[()]


def response_rows(propulsion: Propulsion, dt: float, lag: Array) -> Array:
    """Return the coefficients of a rotor's step of `dt` [s], (..., 3), as rotor_next_speed takes them.

    lag: factor of the rotors' time constants, (...).
    """
    response, passed = propulsion.response, dt / lag
    if isinstance(response, TorqueResponse):
        inertia = propulsion.rotor_inertia
        settle = -np.expm1(-response.gain / inertia * passed)
        if response.friction:  # of a torque that stands, in the step's course
            passed = -np.expm1(-response.friction / inertia * passed) / response.friction * inertia
        return np.stack(
            [settle, response.torque_up / inertia * passed, response.torque_down / inertia * passed], axis=-1
        )
    rise = -np.expm1(-passed / response.time_constant_up)
    fall = -np.expm1(-passed / response.time_constant_down)
    return np.stack([rise, fall, np.zeros_like(rise)], axis=-1)


def next_speed(
    speed: ArrayLike, target: ArrayLike, dt: float, propulsion: Propulsion, lag: ArrayLike = 1.0
) -> Array:
    """Compute the rotor speed [rad/s] after `dt` [s] towards a constant target; never below zero.

    lag: factor of the rotors' time constants, of a shape that broadcasts with the speed's.
    """
    before, settles, lags = elements(speed, target, lag)
    response = np.ascontiguousarray(response_rows(propulsion, dt, lags))
    after = np.empty_like(before)
    library().lib.rotor_next_speeds(
        propulsion_struct(propulsion),
        before.size,
        pointer(response),
        pointer(before),
        pointer(settles),
        pointer(after),
    )
    return after[()]


def speeds_along(start: Array, targets: Array, dt: float, propulsion: Propulsion) -> Array:
    """Compute speeds (K + 1, M) [rad/s] of rotors from `start` on, for targets (K, M), `dt` [s] each."""
    steps, count = targets.shape
    given = np.ascontiguousarray(targets, np.float64)
    response = np.ascontiguousarray(response_rows(propulsion, dt, np.ones(1)))
    speeds = np.empty((steps + 1, count))
    speeds[0] = start
    library().lib.rotor_speeds_along(
        propulsion_struct(propulsion), steps, count, pointer(response), pointer(given), pointer(speeds)
    )
    return speeds


def coefficient(polynomial: tuple[float, ...], speed: ArrayLike) -> Array:
    """Evaluate a propulsion coefficient at rotor speeds [rad/s], any shape."""
    (at,) = elements(speed)
    value = np.empty_like(at)
    made = struct("polynomial", **_polynomial(polynomial))
    library().lib.polynomial_values(made, at.size, pointer(at), pointer(value))
    return value[()]


def thrust_and_torque(speed: ArrayLike, propulsion: Propulsion) -> tuple[Array, Array]:
    """Compute thrust K_T w^2 [N] and drag torque [N m] of rotors at `speed` [rad/s], in still air."""
    (at,) = elements(speed)
    thrust, torque = np.empty_like(at), np.empty_like(at)
    library().lib.rotor_loads(
        propulsion_struct(propulsion), at.size, pointer(at), pointer(thrust), pointer(torque)
    )
    return thrust[()], torque[()]


@dataclass(frozen=True)
class RotorGeometry:
    """Constant maps from rotor speeds to wrenches, made once for an aircraft."""

    thrust_wrench: Array  # (M, 6): wrench a newton of each rotor's thrust
    torque_wrench: Array  # (M, 6): wrench a newton metre of each rotor's drag torque
    square_wrench: Array | None  # (M, 6): wrench a speed squared, if both coefficients are constants
    reaction_wrench: Array  # (M, 6): wrench a rad/s^2 of each rotor's acceleration
    motion_wrench: Array  # (6M, 6): wrench a speed * twist, twist = velocity, rate in body axes
    inflow: Array  # (6, M): speed of each hub along its axis a twist, v_z + w_x r_y - w_y r_x
    propulsion: Propulsion


def rotor_geometry(aircraft: Aircraft) -> RotorGeometry:
    """Compute the maps of `aircraft`, about its centre of mass."""
    propulsion = aircraft.propulsion
    thrust, torque, reaction, motion, inflow = [], [], [], [], []
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
        inflow.append(np.concatenate([up, np.cross(r, up)]))  # (w x r) . z = w . (r x z)
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
        motion_wrench=np.ascontiguousarray(np.concatenate(motion)),
        inflow=np.ascontiguousarray(np.array(inflow).T),
        propulsion=propulsion,
    )


def rotors_struct(geometry: RotorGeometry) -> Any:  # noqa: ANN401 - a struct of cffi
    """Return the maps as C has them; keep `geometry` as long."""
    maps = {
        "thrust_wrench": geometry.thrust_wrench,
        "torque_wrench": geometry.torque_wrench,
        "reaction_wrench": geometry.reaction_wrench,
        "motion_wrench": geometry.motion_wrench,
        "inflow": geometry.inflow,
    }
    if geometry.square_wrench is not None:
        maps["square_wrench"] = geometry.square_wrench
    return struct("rotors", motors=len(geometry.thrust_wrench), **maps)


def rotor_wrench(
    before: Array, after: Array, dt: float, velocity: Array, rate: Array, geometry: RotorGeometry
) -> Array:
    """Compute the wrench of all rotors on the aircraft over one step, (N, 6).

    before, after: rotor speeds (N, M) [rad/s] at the step's ends; velocity (N, 3) [m/s] of the centre of
    mass through the air and rate (N, 3) [rad/s], both in body axes. Thrust and drag torque at the rotors'
    advance ratios, if the aircraft has coefficients of them; reaction to rotor acceleration, gyroscopic
    moment, rotor drag and rolling moment.
    """
    count = len(after)
    wrench, factors = np.empty((count, 6)), np.ones((count, 6))
    given = [np.ascontiguousarray(rows, np.float64) for rows in (before, after, velocity, rate)]
    advance = (library().ffi.NULL, library().ffi.NULL)
    if geometry.propulsion.advance is not None:
        found = advance_factors(after, velocity, rate, geometry)
        advance = (pointer(found[0]), pointer(found[1]))
    library().lib.rotor_wrenches(
        propulsion_struct(geometry.propulsion),
        rotors_struct(geometry),
        count,
        dt,
        *(pointer(rows) for rows in given),
        *advance,
        pointer(factors),
        pointer(wrench),
    )
    return wrench


def advance_factors(
    speed: Array, velocity: Array, rate: Array, geometry: RotorGeometry
) -> tuple[Array, Array]:
    """Compute factors (N, M) of thrust and drag torque at the advance ratio J of each rotor.

    speed: (N, M) [rad/s]; velocity (N, 3) [m/s] of the centre of mass through the air and rate (N, 3)
    [rad/s], body axes. J = V / (n D) = 2 pi V / (w D), V the speed of the hub along its axis,
    v_z + w_x r_y - w_y r_x. Where V is below 0 the rotor sinks into its own wake, of which coefficients over
    J say nothing: J is 0 there. For an aircraft with [propulsion.advance_ratio].
    """
    given = [np.ascontiguousarray(rows, np.float64) for rows in (speed, velocity, rate)]
    thrust, torque = np.empty_like(given[0]), np.empty_like(given[0])
    library().lib.rotor_advance(
        propulsion_struct(geometry.propulsion),
        rotors_struct(geometry),
        len(thrust),
        *(pointer(rows) for rows in given),
        pointer(thrust),
        pointer(torque),
    )
    return thrust, torque


def load_factors(thrust: Array, torque: Array) -> Array:
    """Combine factors (N,) of thrust and of the torque ratio into factors (N, 6) of the wrench.

    Rotors are upright: thrust has no yaw moment, and drag torque has no other.
    """
    factors = np.repeat(thrust[:, None], 6, axis=1)
    factors[:, 5] *= torque
    return factors
