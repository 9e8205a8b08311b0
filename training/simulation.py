"""N aircraft on one task: the environment that both the Gymnasium env and the vector env wrap.

One step is one control period: observe, act, mix, quantise to DShot, advance the twin.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.aircraft import Aircraft
from sim.imu import quantised_rate
from sim.motors import motor_commands
from sim.observation import Observer
from sim.twin import Twin
from sim.world import Mount
from toolchain.contract import IDLE_DEFAULT, ObservationBlock
from training.reward import TrackingReward
from training.task import Task


@dataclass(frozen=True)
class StepResult:
    """What a control step brought, for each of N aircraft."""

    observation: NDArray[np.float32]  # (N, n), of the new sample
    reward: NDArray[np.float32]  # (N,)
    ended: NDArray[np.bool_]  # (N,), the episode's time is over (a truncation; nothing terminates)


class AttitudeSimulation:
    """N twins, their commands and their observations, advanced together at the control rate."""

    def __init__(
        self,
        aircraft: Aircraft,
        count: int,
        *,
        blocks: tuple[ObservationBlock, ...],
        control_rate_hz: int,
        task: Task,
        reward: TrackingReward,
        rng: np.random.Generator,
        mount: Mount = Mount.CENTRE,
        noise: bool = True,
        throttle_max: float = 0.0,
    ) -> None:
        self.count = count
        self.motors = aircraft.motor_count
        self.steps = round(task.duration_s * control_rate_hz)
        self._rate_hz = control_rate_hz
        self._task = task
        self._reward = reward
        self._rng = rng
        self._throttle_max = throttle_max
        self._twin = Twin(aircraft, count, rate_hz=control_rate_hz, mount=mount, noise=noise, rng=rng)
        self._observer = Observer(blocks, count, self.motors, control_rate_hz)
        self.width = self._observer.width
        self._step = np.zeros(count, np.intp)
        self._command = np.zeros((count, 3))
        self._throttle = np.zeros(count, np.float32)
        self._action = np.zeros((count, self.motors), np.float32)

    def close(self) -> None:
        """Leave the physics client."""
        self._twin.close()

    def reset(self, *, stagger: bool = False) -> NDArray[np.float32]:
        """Begin an episode on every aircraft; returns the observations (N, n).

        stagger: spread the aircraft over the episode's clock, so that a batch always sees all of it.
        """
        self._begin(np.arange(self.count))
        if stagger:
            self._step = self._rng.integers(0, self.steps, self.count)
        return self._observe(slice(None))

    def step(self, action: NDArray[np.float32]) -> StepResult:
        """Advance one control period with the controller's outputs (N, M) in 0..1.

        The observation of an aircraft whose episode ended is still that episode's last; call
        `restart` to begin its next one.
        """
        self._twin.step(motor_commands(action, self._throttle, IDLE_DEFAULT))
        before, self._action = self._action, action
        self._step += 1
        error = self.setpoint - self._twin.rate
        reward = self._reward(error, action, before)
        return StepResult(self._observe(slice(None)), reward, self._step >= self.steps)

    def restart(self, index: NDArray[np.intp]) -> NDArray[np.float32]:
        """Begin a new episode on the aircraft of `index`; returns their observations (len, n)."""
        self._begin(index)
        return self._observe(index)

    @property
    def setpoint(self) -> NDArray[np.float64]:
        """Commanded rate of the present sample [rad/s], (N, 3)."""
        return self._task.setpoint(self._command, self._step, self._rate_hz)

    @property
    def rate(self) -> NDArray[np.float64]:
        """True rate of the present sample [rad/s], (N, 3)."""
        return self._twin.rate

    def _begin(self, index: NDArray[np.intp]) -> None:
        self._twin.reset(index)
        self._observer.reset(index)
        self._step[index] = 0
        self._command[index] = self._task.draw(len(index), self._rng)
        self._throttle[index] = self._rng.uniform(0.0, self._throttle_max, len(index))
        self._action[index] = 0.0

    def _observe(self, which: NDArray[np.intp] | slice) -> NDArray[np.float32]:
        return self._observer.observe(
            which,
            self.setpoint[which].astype(np.float32),
            quantised_rate(self._twin.gyro[which]),
            self._action[which],
            self._throttle[which],
        )
