"""How well a controller flies unseen commands: many aircraft at once, no firmware in between."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.aircraft import Aircraft
from sim.controller import Controller
from sim.imu import quantised_rate
from sim.metrics import Effort, Tracking, effort, tracking
from sim.motors import motor_commands
from sim.twin import Twin
from sim.world import Mount
from toolchain.contract import IDLE_DEFAULT
from training.task import PulseTask


@dataclass(frozen=True)
class Evaluation:
    """Figures of a controller over `episodes` commands; errors are against the true rate."""

    episodes: int
    tracking: Tracking  # mean over episodes, per axis
    worst_mae: float  # [deg/s], of the worst episode and axis
    effort: Effort


def evaluate(
    controller: Controller,
    aircraft: Aircraft,
    *,
    episodes: int,
    seed: int,
    control_rate_hz: int,
    task: PulseTask | None = None,
    mount: Mount = Mount.CENTRE,
    noise: bool = True,
    throttle: float = 0.0,
    idle: float = IDLE_DEFAULT,
    progress: Callable[[int, int], None] | None = None,
) -> Evaluation:
    """Fly `episodes` commands, one aircraft each, all at once.

    controller: for `episodes` aircraft; seed: of commands and noise; progress: called with steps done
    and to do. The same seed gives every controller the same commands.
    """
    task = task or PulseTask()
    commands, noise_rng = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(2))
    command = task.draw(episodes, commands)
    steps = round(task.duration_s * control_rate_hz)
    thrust = np.full(episodes, throttle, np.float32)
    wanted = np.empty((steps, episodes, 3), np.float32)
    flown = np.empty((steps, episodes, 3), np.float32)
    outputs = np.empty((steps, episodes, aircraft.motor_count), np.float32)
    twin = Twin(aircraft, episodes, rate_hz=control_rate_hz, mount=mount, noise=noise, rng=noise_rng)
    try:
        controller.reset()
        for k in range(steps):
            setpoint = task.setpoint(command, np.full(episodes, k), control_rate_hz).astype(np.float32)
            wanted[k], flown[k] = setpoint, twin.rate
            outputs[k] = y = controller.step(setpoint, quantised_rate(twin.gyro), thrust)
            twin.step(motor_commands(y, thrust, idle))
            if progress is not None:
                progress(k + 1, steps)
    finally:
        twin.close()
    errors = tracking(_by_episode(wanted), _by_episode(flown), 1.0 / control_rate_hz)
    return Evaluation(
        episodes=episodes,
        tracking=errors.mean(),
        worst_mae=float(errors.mae.max()),
        effort=effort(_by_episode(outputs), 1.0 / control_rate_hz),
    )


def _by_episode(array: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.swapaxes(array, 0, 1)
