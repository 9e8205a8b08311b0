"""The policy's input as the firmware computes it, for N aircraft at once.

Blocks, terms and their meaning are those of `toolchain.contract`; values are float32, and every rounding is
the firmware's.
"""

from __future__ import annotations

import math

import numpy as np

from neuroflight.sim.arrays import Array32, Flags, Indices, Which
from neuroflight.sim.control.estimator import Estimator
from neuroflight.toolchain.contract import (
    GYRO_FULL_SCALE_DEG_S,
    IDLE_DEFAULT,
    RATE_ERROR_INTEGRAL_LIMIT_RAD,
    RATE_FULL_STICK_DEG_S,
    ObservationTerm,
    measures_rotors,
    needs_model,
    observation_count,
)
from neuroflight.toolchain.policy.model_constants import ModelConstants

_RATE_MAX = math.radians(GYRO_FULL_SCALE_DEG_S)
_ERROR_MAX = math.radians(RATE_FULL_STICK_DEG_S) + _RATE_MAX
_ROTOR_SPEED_MAX = 10_000.0  # [rad/s], 95,000 rpm: no propeller holds that
_LIMITS = {
    "rate": (-_RATE_MAX, _RATE_MAX),
    "rate_error": (-_ERROR_MAX, _ERROR_MAX),
    "rate_error_delta": (-2 * _ERROR_MAX, 2 * _ERROR_MAX),
    "rate_error_integral": (-RATE_ERROR_INTEGRAL_LIMIT_RAD, RATE_ERROR_INTEGRAL_LIMIT_RAD),
    "previous_action": (0.0, 1.0),
    "throttle": (0.0, 1.0),
    "rotor_speed": (0.0, _ROTOR_SPEED_MAX),
    "gravity": (-1.0, 1.0),
    "previous_motors": (-1.0, 1.0),
    "rotor_estimate": (-_ROTOR_SPEED_MAX, _ROTOR_SPEED_MAX),
    "rotor_measured": (-_ROTOR_SPEED_MAX, _ROTOR_SPEED_MAX),
    "rate_estimate": (-_RATE_MAX, _RATE_MAX),
    "rate_estimate_error": (-_ERROR_MAX, _ERROR_MAX),
}


def limits(terms: tuple[ObservationTerm, ...], motors: int) -> tuple[Array32, Array32]:
    """Return the least and the greatest value of each observation, (n,) each, raw units."""
    pairs = [_LIMITS[term.name] for term in terms for _ in range(term.count(motors))]
    low, high = np.array(pairs, np.float32).T
    return low, high


class Observer:
    """A builder of observations (N, n) step by step; keeps past values and filter states."""

    def __init__(
        self,
        terms: tuple[ObservationTerm, ...],
        count: int,
        motors: int,
        control_rate_hz: int,
        *,
        model: ModelConstants | None = None,
        idle: float = IDLE_DEFAULT,
        standing: bool = False,
    ) -> None:
        """model: of the aircraft, for terms made by one; idle: the policy's. Raises ValueError without it.

        standing: the ground holds the aircraft all the time, and nothing moves by what the motors do:
        integrals do not grow, and the policy does not see what it has answered.
        """
        if model is None and needs_model(terms):
            raise ValueError("this observation needs a model of the aircraft, got none")
        self._estimator = Estimator(model, count, idle) if needs_model(terms) and model is not None else None
        self._measures = measures_rotors(terms)
        self._motors = np.zeros((count, motors), np.float32)  # the last fractions less the throttle
        self.names = frozenset(term.name for term in terms)  # of the blocks that are observed
        self.width = observation_count(terms, motors)
        self._terms = [_Term(term, count, motors, control_rate_hz) for term in terms]
        self._dt = np.float32(1.0 / control_rate_hz)
        self._standing = standing
        self._error = np.zeros((count, 3), np.float32)
        self._integral = np.zeros((count, 3), np.float32)
        self._fresh = np.ones(count, bool)

    def reset(self, index: Indices) -> None:
        """Clear the state of the aircraft of `index`, as arming does: their next step is the first."""
        self._fresh[index] = True
        self._integral[index] = 0.0
        self._motors[index] = 0.0
        if self._estimator is not None:
            self._estimator.reset(index)
        for term in self._terms:
            term.reset(index)

    def commanded(self, which: Which, fractions: Array32, throttle: Array32) -> None:
        """Record the step's result: motor fractions (K, M) after the mix, before the idle; throttle (K,)."""
        self._motors[which] = fractions - throttle[:, None]
        if self._estimator is not None:
            self._estimator.command(which, fractions)

    def observe(
        self,
        which: Which,
        setpoint: Array32,
        rate: Array32,
        previous_action: Array32,
        throttle: Array32,
        *,
        rotor_speed: Array32 | None = None,
        gravity: Array32 | None = None,
    ) -> Array32:
        """Compute the observation (K, n) of this control step for the K aircraft of `which`, raw units.

        setpoint, rate: (K, 3) [rad/s]; previous_action: (K, M); throttle: (K,); rotor_speed: (K, M)
        [rad/s], gravity: (K, 3), unit vectors in body axes, for terms that are made of them. Call once a
        step, and `commanded` after it. Raises ValueError if one of these two is needed and not given.
        """
        first = self._fresh[which, None]
        fresh = first if first.any() else None
        error = setpoint - rate
        blocks = {
            "rate": rate,
            "rate_error": error,
            "previous_action": np.zeros_like(previous_action) if self._standing else previous_action,
            "throttle": throttle[:, None],
            "rotor_speed": rotor_speed,
            "gravity": gravity,
            "previous_motors": np.zeros_like(self._motors[which]) if self._standing else self._motors[which],
        }
        if "rate_error_delta" in self.names:
            delta = error - self._error[which]
            blocks["rate_error_delta"] = delta if fresh is None else np.where(fresh, np.float32(0.0), delta)
            self._error[which] = error
        if self._estimator is not None:
            measured = rotor_speed if self._measures else None
            if self._measures and measured is None:
                raise ValueError("observe needs rotor_speed for rotor_measured, got none")
            self._estimator.observe(which, fresh, rate, measured, standing=self._standing)
            estimate = self._estimator.rate_estimate(which)
            rotors = self._estimator.rotor_estimate(which, throttle)
            blocks["rotor_estimate"] = np.zeros_like(rotors) if self._standing else rotors
            blocks["rotor_measured"] = blocks["rotor_estimate"]
            blocks["rate_estimate"] = estimate
            blocks["rate_estimate_error"] = setpoint - estimate
        if "rate_error_integral" in self.names:
            limit = np.float32(RATE_ERROR_INTEGRAL_LIMIT_RAD)
            grown = self._integral[which] + error * (np.float32(0.0) if self._standing else self._dt)
            blocks["rate_error_integral"] = integral = np.minimum(np.maximum(grown, -limit), limit)
            self._integral[which] = integral
        seen = []
        for term in self._terms:
            value = blocks[term.name]
            if value is None:
                raise ValueError(f"observe needs {term.name}, got none")
            seen.append(term.observe(which, fresh, value))
        if fresh is not None:
            self._fresh[which] = False
        return np.concatenate(seen, axis=1)


class _Term:
    """State of a term for N aircraft: its low-pass, and the past values of a delayed term."""

    def __init__(self, term: ObservationTerm, count: int, motors: int, control_rate_hz: int) -> None:
        self.name = term.name
        width = term.count(motors)
        self._gain = np.float32(term.gain(control_rate_hz))
        self._passed = None if term.cutoff_hz is None else np.zeros((count, width), np.float32)
        self._waiting = np.zeros((term.age, count, width), np.float32)  # the newest first

    def reset(self, index: Indices) -> None:
        """Clear the past values of the aircraft of `index`."""
        self._waiting[:, index] = 0.0

    def observe(self, which: Which, fresh: Flags | None, value: Array32) -> Array32:
        """Compute the term (K, width) of this step from its block's `value`.

        fresh: (K, 1), True in the first step; None: of no aircraft.
        """
        if self._passed is not None:
            passed = self._passed[which]
            followed = passed + self._gain * (value - passed)
            value = followed if fresh is None else np.where(fresh, value, followed)
            self._passed[which] = value
        waiting = self._waiting
        if not len(waiting):
            return value
        oldest = waiting[-1, which].copy()
        waiting[1:, which] = waiting[:-1, which]
        waiting[0, which] = value
        return oldest
