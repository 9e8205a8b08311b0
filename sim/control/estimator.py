"""A policy's observation through a model of its aircraft: rotor speeds and rates that the model predicts.

The rotors' equation is run on the motor fractions that were commanded; the rate is predicted from the rotors
and corrected by the gyro. float32 and in the firmware's order of operations (control/estimator.c).
"""

from __future__ import annotations

import numpy as np

from neuroflight.sim.aircraft.model import Aircraft, TorqueResponse
from neuroflight.sim.arrays import Array32, Flags, Which
from neuroflight.sim.control.motors import raised
from neuroflight.sim.physics.rotor import coefficient, response_rows, rotor_geometry, target_speed
from neuroflight.toolchain.contract import (
    ESTIMATOR_CORRECTION_HZ,
    ESTIMATOR_DELAY_MAX,
    GRAVITY,
    ObservationTerm,
    needs_model,
    welcomes_model,
)
from neuroflight.toolchain.errors import AircraftError
from neuroflight.toolchain.policy.model_constants import UNLIMITED, ModelConstants


def model_constants(aircraft: Aircraft, control_rate_hz: int) -> ModelConstants:
    """Compute the model of `aircraft` for policies at that rate.

    Coefficients that depend on the rotor's speed are taken at hover. Raises AircraftError on an aircraft that
    a model cannot say: its commands act later, or a number is beyond its limits.
    """
    propulsion, dt = aircraft.propulsion, 1.0 / control_rate_hz
    delay = max(1, round(propulsion.delay * control_rate_hz))
    if delay > ESTIMATOR_DELAY_MAX:
        raise AircraftError(
            f"aircraft {aircraft.name}: its delay {propulsion.delay:g} s is {delay} control steps, a model "
            f"has at most {ESTIMATOR_DELAY_MAX}; observe without rotor_estimate and rate_estimate"
        )
    if propulsion.friction:
        raise AircraftError(
            f"aircraft {aircraft.name}: propulsion.response.friction_n_m_s {propulsion.friction:g}, a model "
            f"of rotors has none; observe without rotor_estimate and rate_estimate"
        )
    limited = isinstance(propulsion.response, TorqueResponse)
    first, second, third = response_rows(propulsion, dt, np.ones(1))[0].tolist()
    speed = hover_speed(aircraft)
    thrust = float(coefficient(propulsion.thrust_coefficient, speed))
    torque = thrust * float(coefficient(propulsion.torque_ratio, speed))
    geometry, inverse = rotor_geometry(aircraft), np.linalg.inv(aircraft.mass_properties.inertia)
    moments = thrust * geometry.thrust_wrench[:, 3:] + torque * geometry.torque_wrench[:, 3:]
    document = {
        "delay_steps": delay,
        "speed_curve": list(propulsion.speed_curve),
        "rise": first,
        "fall": first if limited else second,
        "gain_max": second if limited else UNLIMITED,
        "loss_max": third if limited else UNLIMITED,
        "correction": -np.expm1(-2.0 * np.pi * ESTIMATOR_CORRECTION_HZ * dt).item(),
        "turn": (dt * inverse @ moments.T).tolist(),
        "reaction": (inverse @ geometry.reaction_wrench[:, 3:].T).tolist(),
    }
    try:
        return ModelConstants.of(document)
    except ValueError as error:
        raise AircraftError(
            f"aircraft {aircraft.name} has no model at {control_rate_hz} Hz: {error}"
        ) from error


def observed_model(
    aircraft: Aircraft, terms: tuple[ObservationTerm, ...], control_rate_hz: int
) -> ModelConstants | None:
    """Return the model that a policy which observes `terms` flies with; None: it needs none.

    A policy that observes rotor speeds has one where the aircraft has, as the firmware takes the speed of a
    rotor whose ESC is silent from it. Raises AircraftError as `model_constants` where one is needed.
    """
    if needs_model(terms):
        return model_constants(aircraft, control_rate_hz)
    try:
        return model_constants(aircraft, control_rate_hz) if welcomes_model(terms) else None
    except AircraftError:
        return None


def hover_speed(aircraft: Aircraft) -> float:
    """Compute the speed [rad/s] of each rotor in hover; full speed if the aircraft cannot hover."""
    propulsion = aircraft.propulsion
    speeds = np.asarray(target_speed(np.linspace(0.0, 1.0, 201), propulsion))
    thrust = aircraft.motor_count * coefficient(propulsion.thrust_coefficient, speeds) * speeds**2
    enough = np.flatnonzero(thrust >= aircraft.mass_properties.mass * GRAVITY)
    return float(speeds[enough[0] if len(enough) else -1])


class Estimator:
    """The models of N aircraft: `observe` once a control step, `command` what came of it."""

    def __init__(self, model: ModelConstants, count: int, idle: float) -> None:
        """idle: the fraction of armed motors without thrust."""
        self._model, self._idle = model, idle
        self._turn, self._reaction = (np.array(rows, np.float32) for rows in (model.turn, model.reaction))
        motors = model.motor_count
        self._commands = np.zeros((model.delay_steps + 1, count, motors), np.float32)  # the oldest first
        self._speed = np.zeros((count, motors), np.float32)
        self._rate = np.zeros((count, 3), np.float32)

    def reset(self, index: Which) -> None:
        """Set the rotors of the aircraft of `index` to rest."""
        self._commands[:, index] = 0.0
        self._speed[index] = 0.0
        self._rate[index] = 0.0

    def observe(
        self,
        which: Which,
        first: Flags | None,
        gyro: Array32,
        measured: Array32 | None = None,
        *,
        standing: bool = False,
    ) -> None:
        """Begin a control step of the aircraft of `which` with the gyro's rate (K, 3) [rad/s].

        first: (K, 1), True in the first step; None: of no aircraft. measured: the rotors' speeds (K, M)
        [rad/s]; None: as the model has them. standing: the ground holds them.
        """
        model = self._model
        before = self._speed[which]
        after = self._advanced(before, self._commands[0, which]) if measured is None else measured
        gained, square = after - before, after * after
        rate = self._rate[which]
        if not standing:
            terms = self._turn * square[:, None], self._reaction * gained[:, None]
            rate = np.add.accumulate(np.concatenate([rate[..., None], *terms], axis=2), axis=2)[..., -1]
        rate = rate + np.float32(model.correction) * (gyro - rate)
        self._rate[which] = rate if first is None else np.where(first, gyro, rate)
        self._speed[which] = after

    def command(self, which: Which, fractions: Array32) -> None:
        """End the step with these motor fractions (K, M) before the idle."""
        commands = self._commands[:, which]
        commands[:-1] = commands[1:]
        commands[-1] = raised(fractions, self._idle)
        self._commands[:, which] = commands

    def rotor_estimate(self, which: Which, throttle: Array32) -> Array32:
        """Return speeds (K, M) [rad/s] less those at which rotors settle under `throttle` (K,)."""
        at_rest = self._target(raised(throttle, self._idle))
        estimate: Array32 = self._speed[which] - at_rest[:, None]
        return estimate

    def rate_estimate(self, which: Which) -> Array32:
        """Return the predicted rates (K, 3) [rad/s]."""
        rate: Array32 = self._rate[which]
        return rate

    def _target(self, command: Array32) -> Array32:
        a, b, c = (np.float32(number) for number in self._model.speed_curve)
        target: Array32 = (a * command + b) * command + c
        return target

    def _advanced(self, speed: Array32, command: Array32) -> Array32:
        model = self._model
        away = self._target(command) - speed
        change = np.where(away > 0.0, np.float32(model.rise), np.float32(model.fall)) * away
        change = np.minimum(np.maximum(change, np.float32(-model.loss_max)), np.float32(model.gain_max))
        advanced: Array32 = np.maximum(np.float32(0.0), speed + change)
        return advanced
