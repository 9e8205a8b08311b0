"""Backward pass: derivatives of the loss along a flight, from its last control step to the first.

They are exact, with the twin's equations and the memory of the observation. Three operations are taken as the
identity: the gyro's noise and counts, the rounding of the DShot value, and the clip of the outputs, unless
descent would move an output further outside.
"""

from __future__ import annotations

from collections import defaultdict

import numpy as np
from numpy.typing import NDArray

from sim.aircraft.model import Gyro
from sim.physics.derivative import StepModel
from toolchain.contract import RATE_ERROR_INTEGRAL_LIMIT_RAD, ObservationTerm
from training.learners.pathwise.flight import Batch, Flight
from training.learners.pathwise.loss import FlightGradient
from training.learners.pathwise.network import Network, Passed

Array = NDArray[np.float64]
Floats = NDArray[np.float32]


def gradient(
    flight: Flight,
    batch: Batch,
    by_flight: FlightGradient,
    network: Network,
    scale: Floats,
    terms: tuple[ObservationTerm, ...],
    model: StepModel,
    gyro: Gyro,
    idle: float,
) -> list[Floats]:
    """Derivatives of the loss by the network's `parameters`, in their order.

    scale: factor of each raw observation value, (n,); model: of the batch's aircraft, at the control rate.
    """
    steps, count, motors = flight.action.shape
    everyone = np.arange(count)
    delay = np.maximum(1, np.rint(batch.variation.delay_s / model.dt).astype(np.intp))
    first = int(delay.max())
    # Row k + first holds control step k: with a delay, the commands of the first steps precede the flight.
    command = np.zeros((steps + first, count, motors))
    lift = batch.throttle[None, :, None] * (1.0 - flight.action.max(axis=2, keepdims=True))
    command[first:] = idle + (1.0 - idle) * (flight.action + lift)
    rows = np.arange(steps)[:, None] + first - delay
    derivatives = model.derivatives(flight.rotor_speed, flight.rate, command[rows, everyone], flight.voltage)
    asked_by_command = np.zeros_like(command)
    top = flight.action.argmax(axis=2)
    by_observation = _Observation(flight, batch, terms, model.dt, motors)
    chip = _LowPass(
        None if gyro.bandwidth_hz is None else -np.expm1(-2 * np.pi * gyro.bandwidth_hz * model.dt)
    )
    by_sums: list[list[Floats]] = []
    by_action_before: Array = np.zeros((count, motors))
    speed, rate = np.zeros((count, motors)), np.zeros((count, 3))
    for k in range(steps - 1, -1, -1):
        pulled = derivatives.pull(k, speed, rate)
        speed, rate = pulled.speed, pulled.rate
        asked_by_command[rows[k], everyone] += pulled.command
        mixed = (1.0 - idle) * asked_by_command[k + first]
        action = by_flight.action[k] + by_action_before + mixed
        action[everyone, top[k]] -= batch.throttle * mixed.sum(axis=1)
        passed = flight.passed[k]
        action[_outwards(passed, action)] = 0.0
        of_scaled, sums = network.backward(passed, action.astype(np.float32))
        by_sums.append(sums)
        gyro_reading, by_action_before, own_speed = by_observation.pull(
            k, (of_scaled * scale).astype(np.float64)
        )
        speed = speed + own_speed
        rate = rate + chip.pull(k, gyro_reading) + by_flight.rate[k]
    by_sums.reverse()
    return network.gradient(
        flight.observation.reshape(steps * count, -1),
        [np.concatenate(layer) for layer in zip(*(p.hidden for p in flight.passed), strict=True)],
        [np.concatenate(layer) for layer in zip(*by_sums, strict=True)],
    )


def _outwards(passed: Passed, action: Array) -> NDArray[np.bool_]:
    """Where an output lies outside 0..1 and descent would move it further outside."""
    outwards: NDArray[np.bool_] = ((passed.unclipped < 0.0) & (action > 0.0)) | (
        (passed.unclipped > 1.0) & (action < 0.0)
    )
    return outwards


class _LowPass:
    """y += a (x - y), y = x at first: from derivatives by y to those by x, step by step backwards."""

    def __init__(self, gain: float | None) -> None:
        """gain: a; None: y = x."""
        self._gain = gain
        self._later: Array | float = 0.0  # by y, of the steps after this one

    def pull(self, k: int, output: Array) -> Array:
        """Derivatives by x at step `k`, after those of all later steps."""
        if self._gain is None:
            return output
        by_output = output + self._later
        self._later = (1.0 - self._gain) * by_output
        return self._gain * by_output if k else by_output


class _Observation:
    """From derivatives by a step's observation to those by gyro reading, previous action and rotor speed."""

    def __init__(
        self, flight: Flight, batch: Batch, terms: tuple[ObservationTerm, ...], dt: float, motors: int
    ) -> None:
        rate_hz = round(1.0 / dt)
        steps = len(flight.gyro)
        ends = np.cumsum([term.count(motors) for term in terms])
        self._terms = [
            (term, slice(end - term.count(motors), end), _LowPass(term.gain(rate_hz) or None))
            for term, end in zip(terms, ends.tolist(), strict=True)
        ]
        self._by_value = np.zeros((steps + max(term.age for term in terms), *flight.observation.shape[1:]))
        self._dt = dt
        self._free = _unclamped(batch.setpoint - flight.gyro, dt)
        self._nothing = np.zeros((flight.gyro.shape[1], 3))
        self._by_integral = self._nothing
        self._by_error_before = self._nothing  # through the rate_error_delta of the following step
        self._no_motors = np.zeros((flight.gyro.shape[1], motors))

    def pull(self, k: int, observation: Array) -> tuple[Array, Array, Array]:
        """Derivatives by gyro reading (B, 3), by previous action and rotor speed (B, M), of step `k`."""
        self._by_value[k] = observation
        blocks: dict[str, Array] = defaultdict(lambda: self._nothing)
        for term, columns, low_pass in self._terms:
            value = low_pass.pull(k, self._by_value[k + term.age][:, columns])
            blocks[term.name] = blocks[term.name] + value if term.name in blocks else value
        self._by_integral = (self._by_integral + blocks["rate_error_integral"]) * self._free[k]
        error = blocks["rate_error"] + self._by_error_before + self._dt * self._by_integral
        self._by_error_before = self._nothing
        if k:
            error = error + blocks["rate_error_delta"]
            self._by_error_before = -blocks["rate_error_delta"]
        return (
            blocks["rate"] - error,
            blocks.get("previous_action", self._no_motors),
            blocks.get("rotor_speed", self._no_motors),
        )


def _unclamped(error: Floats, dt: float) -> NDArray[np.bool_]:
    """Where the integral of `error` (T, B, 3) is not clamped, as sim.control.observation integrates."""
    limit, step = np.float32(RATE_ERROR_INTEGRAL_LIMIT_RAD), np.float32(dt)
    integral = np.zeros(error.shape[1:], np.float32)
    free = np.empty(error.shape, bool)
    for k, value in enumerate(error):
        integral = integral + value * step
        free[k] = np.abs(integral) < limit
        np.clip(integral, -limit, limit, out=integral)
    return free
