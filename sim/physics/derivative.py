"""Derivatives of one step of the twin, from its equations of motion, along a flown trajectory.

For aircraft that turn about their centre of mass (`Mount.CENTRE`) in calm air. State and command of a step
are rotor speeds w and body rate r before it and the command c that acts in it; w' and r' come after it.
Shapes are (..., N, M) and (..., N, 3): N aircraft with M rotors, and any axes before, such as the steps of
a flight.

Exact but for two things. The battery's voltage is taken as constant over the step: that a rotor which gains
speed makes it sag is left out. The body's turn within a step enters to its second order, which at
2000 deg/s and 1 kHz leaves a relative error of 1e-5.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.polynomial.polynomial import polyder, polymul, polyval
from numpy.typing import NDArray

from sim.aircraft.model import Aircraft, Propulsion, TorqueResponse
from sim.physics.rotation import cross_matrix
from sim.physics.rotor import RotorGeometry, rotor_geometry, target_speed, thrust_and_torque
from sim.physics.variation import Variation

Array = NDArray[np.float64]
CROSS = np.array([cross_matrix(unit) for unit in np.eye(3)])  # (3, 3, 3): v x is the matrix v @ CROSS


class Pull(NamedTuple):
    """Derivatives of a scalar by the state and command before a step."""

    speed: Array  # (N, M) [s/rad]
    rate: Array  # (N, 3) [s/rad]
    command: Array  # (N, M) [1]


@dataclass(frozen=True, eq=False)
class StepDerivatives:
    """Derivatives of many steps. A rotor's speed depends on its own speed and command alone."""

    speed_by_speed: Array  # (..., N, M): dw'_i / dw_i
    speed_by_command: Array  # (..., N, M) [rad/s]: dw'_i / dc_i
    rate_by_speed: Array  # (..., N, M, 3): row i is dr' / dw_i
    rate_by_rate: Array  # (..., N, 3, 3): row i is dr' / dr_i
    rate_by_command: Array  # (..., N, M, 3) [rad/s]: row i is dr' / dc_i

    def pull(self, k: int, speed: Array, rate: Array) -> Pull:
        """Backward pass through step `k`: from derivatives by w' and r' to those by w, r and c."""
        along = rate[:, :, None]
        return Pull(
            speed * self.speed_by_speed[k] + (self.rate_by_speed[k] @ along)[:, :, 0],
            (self.rate_by_rate[k] @ along)[:, :, 0],
            speed * self.speed_by_command[k] + (self.rate_by_command[k] @ along)[:, :, 0],
        )


@dataclass(frozen=True, eq=False)
class StepModel:
    """N aircraft as their steps depend on state and command."""

    propulsion: Propulsion
    geometry: RotorGeometry
    inertia: Array  # (3, 3) [kg m^2], about the centre of mass, of the aircraft as its file says
    dt: float  # [s]
    variation: Variation

    @staticmethod
    def of(aircraft: Aircraft, rate_hz: int, variation: Variation) -> StepModel:
        """Aircraft like `aircraft`, each with its own `variation`, stepped at `rate_hz`."""
        inertia = aircraft.mass_properties.inertia
        return StepModel(aircraft.propulsion, rotor_geometry(aircraft), inertia, 1.0 / rate_hz, variation)

    def derivatives(
        self, speed: Array, rate: Array, command: Array, voltage: Array | None = None
    ) -> StepDerivatives:
        """Of steps that begin with rotor `speed` [rad/s] and body `rate` [rad/s] under `command` 0..1.

        voltage: of the battery, (..., N, 1) [V]; None: the bench supply.
        """
        after, by_speed, by_command = self._rotors(speed, command, voltage)
        moment, by_after, by_before, by_rate = self._moments(speed, after, rate)
        direct, push = self._turning(rate, moment)
        rate_by_after = by_after @ push
        return StepDerivatives(
            speed_by_speed=by_speed,
            speed_by_command=by_command,
            rate_by_speed=by_speed[..., None] * rate_by_after + by_before @ push,
            rate_by_rate=direct + by_rate @ push,
            rate_by_command=by_command[..., None] * rate_by_after,
        )

    def _rotors(self, speed: Array, command: Array, voltage: Array | None) -> tuple[Array, Array, Array]:
        """Speed after the step (..., N, M) [rad/s], and its derivatives by speed and command.

        The equations are `sim.physics.rotor.next_speed`'s.
        """
        propulsion, dt = self.propulsion, self.dt
        factor, lag = self.variation.speed[:, None], self.variation.lag[:, None]
        response = propulsion.response
        away = factor * target_speed(command, propulsion, voltage) - speed
        if isinstance(response, TorqueResponse):
            inertia = propulsion.rotor_inertia * lag
            follow = -np.expm1(-response.gain / inertia * dt)
            change = follow * away
            up, down = response.torque_up / inertia * dt, response.torque_down / inertia * dt
            share = np.where((change > -down) & (change < up), follow, 0.0)
            after = speed + np.clip(change, -down, up)
        else:
            rise = -np.expm1(-dt / (response.time_constant_up * lag))
            fall = -np.expm1(-dt / (response.time_constant_down * lag))
            share = np.where(away > 0.0, rise, fall)
            after = speed + share * away
        turns = after > 0.0
        a, b, _ = propulsion.speed_curve
        slope = factor * (2.0 * a * command + b)
        if voltage is not None and propulsion.supply_voltage is not None:
            slope = slope * voltage / propulsion.supply_voltage
        return np.maximum(after, 0.0), turns * (1.0 - share), turns * share * slope

    def _moments(self, before: Array, after: Array, rate: Array) -> tuple[Array, Array, Array, Array]:
        """Moment (..., N, 3) [N m] over inertia factor, and its derivatives by w', w and r; as rotor_wrench.

        An aircraft with twice the inertia turns as one with half the moment, so the factor goes in here.
        """
        propulsion, geometry, variation = self.propulsion, self.geometry, self.variation
        light = 1.0 / variation.inertia[:, None]
        lift = light * variation.thrust[:, None]
        drag = lift * variation.torque[:, None]
        by_thrust, by_torque = geometry.thrust_wrench[:, 3:], geometry.torque_wrench[:, 3:]
        reaction = geometry.reaction_wrench[:, 3:] / self.dt
        count = len(reaction)
        motion = geometry.motion_wrench[:, 3:].reshape(count, 6, 3)[:, 3:]  # (M, 3, 3), calm air

        thrust, torque = thrust_and_torque(after, propulsion)
        of_rate = (rate @ motion.transpose(1, 0, 2).reshape(3, -1)).reshape(*rate.shape[:-1], count, 3)
        of_rate = light[..., None] * of_rate
        moment = (
            (lift * thrust) @ by_thrust
            + (drag * torque) @ by_torque
            + light * ((after - before) @ reaction)
            + (after[..., None] * of_rate).sum(axis=-2)
        )
        thrust_of = polymul((0.0, 0.0, 1.0), propulsion.thrust_coefficient)
        torque_of = polymul(thrust_of, propulsion.torque_ratio)
        own = light[..., None] * reaction
        by_after = (
            (lift * polyval(after, polyder(thrust_of)))[..., None] * by_thrust
            + (drag * polyval(after, polyder(torque_of)))[..., None] * by_torque
            + own
            + of_rate
        )
        by_rate = ((light * after) @ motion.reshape(count, 9)).reshape(*rate.shape, 3)
        return moment, by_after, -own, by_rate

    def _turning(self, rate: Array, moment: Array) -> tuple[Array, Array]:
        """Rate after the step by rate and by moment, (..., N, 3, 3) each, rows by component; as world.py.

        The world keeps the momentum h = I r: in body axes h' = E (h + m dt/2) + m dt/2, where E undoes the
        step's turn, made at the rate in its middle, r + dt/2 I^-1 (m - r x I r).
        """
        inertia, half = self.inertia, 0.5 * self.dt
        inverse = np.linalg.inv(inertia)
        momentum = rate @ inertia
        middle = rate + half * (moment - np.cross(rate, momentum)) @ inverse
        pushed = momentum + half * moment
        turn = _cross(self.dt * middle)  # matrices of the cross product, acting on columns
        across = _cross(pushed)
        undo = np.eye(3) - turn + 0.5 * turn @ turn
        twist = np.cross(self.dt * middle, pushed)
        by_middle = self.dt * (across - 0.5 * (_cross(twist) + turn @ across))
        gyroscopic = _cross(rate) @ inertia - _cross(momentum)
        by_rate = undo @ inertia + by_middle @ (np.eye(3) - half * inverse @ gyroscopic)
        by_moment = half * (undo + np.eye(3) + by_middle @ inverse)
        return np.swapaxes(inverse @ by_rate, -1, -2), np.swapaxes(inverse @ by_moment, -1, -2)


def _cross(vectors: Array) -> Array:
    """Matrices (..., 3, 3) of v x, for v (..., 3)."""
    matrices: Array = (vectors @ CROSS.reshape(3, 9)).reshape(*vectors.shape, 3)
    return matrices
