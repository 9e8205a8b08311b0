"""Forward pass: flies a batch of episodes in the twin and records what the backward pass needs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.control.motors import motor_commands
from sim.control.observation import Observer
from sim.physics.imu import quantised_rate
from sim.physics.twin import Twin
from sim.physics.variation import Variation
from training.learners.pathwise.network import Network, Passed
from training.tasks.random_steps import StepWeights

Array = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Batch:
    """Episodes of T control steps for B aircraft: the input of a flight."""

    setpoint: Array  # (T, B, 3) [rad/s]
    step_weights: StepWeights  # (B, T), weight of each control step
    throttle: Array  # (B,), the pilot's thrust
    variation: Variation  # of the B aircraft


@dataclass(frozen=True, eq=False)
class Flight:
    """The record of a flight: T control steps of B aircraft with M motors."""

    observation: Array  # (T, B, n), scaled
    gyro: Array  # (T, B, 3) [rad/s], what the controller used
    rate: NDArray[np.float64]  # (T, B, 3) [rad/s], true
    rotor_speed: NDArray[np.float64]  # (T, B, M) [rad/s]
    voltage: NDArray[np.float64] | None  # (T, B, 1) [V], of the supply; None: the bench supply
    passed: list[Passed]  # T of them
    action: Array  # (T, B, M), clipped to 0..1


def fly(twin: Twin, observer: Observer, network: Network, scale: Array, batch: Batch, idle: float) -> Flight:
    """Fly `batch` from rest with the deterministic policy, with noise, counts, delay, mix and DShot steps.

    twin, observer: of B aircraft, just reset; scale: factor of each raw observation value, (n,).
    """
    steps, count, _ = batch.setpoint.shape
    motors = twin.aircraft.motor_count
    flight = Flight(
        observation=np.empty((steps, count, observer.width), np.float32),
        gyro=np.empty((steps, count, 3), np.float32),
        rate=np.empty((steps, count, 3)),
        rotor_speed=np.empty((steps, count, motors)),
        voltage=None if np.isnan(batch.variation.charge).all() else np.empty((steps, count, 1)),
        passed=[],
        action=np.empty((steps, count, motors), np.float32),
    )
    action = np.zeros((count, motors), np.float32)
    everyone = slice(None)
    for k in range(steps):
        flight.rotor_speed[k], flight.rate[k] = twin.rotor_speed, twin.rate
        if flight.voltage is not None:
            flight.voltage[k, :, 0] = twin.telemetry.voltage
        flight.gyro[k] = gyro = quantised_rate(twin.gyro)
        sensed = {}
        if "rotor_speed" in observer.names:
            sensed["rotor_speed"] = twin.rotor_speed.astype(np.float32)
        raw = observer.observe(everyone, batch.setpoint[k], gyro, action, batch.throttle, **sensed)
        flight.observation[k] = observation = raw * scale
        passed = network.forward(observation)
        flight.passed.append(passed)
        flight.action[k] = action = np.clip(passed.unclipped, np.float32(0.0), np.float32(1.0))
        twin.step(motor_commands(action, batch.throttle, idle))
    return flight
