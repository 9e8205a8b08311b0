"""One aircraft as a Gymnasium environment.

`import training`, then `gymnasium.make("neuroflight/Attitude-v0", aircraft="nf1", task="pulse")`; or let
Gymnasium import it: `gymnasium.make("training:neuroflight/Attitude-v0")`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from sim.aircraft import load_aircraft
from sim.observation import limits
from toolchain.errors import TrainingError
from training.configuration import TrainingConfig
from training.simulation import AttitudeSimulation
from training.tasks import TASKS


class AttitudeEnv(gymnasium.Env[NDArray[np.float32], NDArray[np.float32]]):
    """Track rate commands with one aircraft.

    Observation: the blocks of `observation`, raw units (rad/s, rad, fractions), float32 (n,).
    Action: motor fractions 0..1 before the throttle mix, float32 (M,).
    Ends only by its clock, as a truncation. `info` holds `setpoint` and `rate`, (3,) [rad/s].
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012 - Gymnasium's declaration

    def __init__(
        self,
        aircraft: str | Path = "nf1",
        task: str = "pulse",
        observation: str = "rate_error,rate_error_delta",
        control_rate_hz: int = 1000,
    ) -> None:
        if task not in TASKS:
            raise TrainingError(f"task {task!r}, expected one of: {', '.join(TASKS)}")
        self._aircraft = load_aircraft(aircraft)
        self._config = TrainingConfig(
            observation=observation, control_rate_hz=control_rate_hz, task=TASKS[task]()
        )
        self._simulation: AttitudeSimulation | None = self._build(np.random.default_rng())
        self.observation_space = spaces.Box(
            *limits(self._config.blocks(), self._aircraft.motor_count), dtype=np.float32
        )
        self.action_space = spaces.Box(0.0, 1.0, (self._aircraft.motor_count,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin an episode; a seed repeats commands and noise exactly."""
        super().reset(seed=seed)
        if seed is not None or self._simulation is None:
            self.close()
            self._simulation = self._build(self.np_random)
        observation = self._simulation.reset()
        return observation[0], self._info(self._simulation)

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Advance one control period. Raises ValueError on an action that is not finite."""
        if self._simulation is None:
            raise RuntimeError("step() on a closed environment; call reset() first")
        if not np.isfinite(action).all():
            raise ValueError(f"action {action} is not finite, expected motor fractions 0..1")
        result = self._simulation.step(np.asarray(action, np.float32)[None])
        info = self._info(self._simulation)
        return result.observation[0], float(result.reward[0]), False, bool(result.ended[0]), info

    def close(self) -> None:
        """Leave the physics client."""
        if self._simulation is not None:
            self._simulation.close()
            self._simulation = None

    def _build(self, rng: np.random.Generator) -> AttitudeSimulation:
        return AttitudeSimulation(self._aircraft, 1, config=self._config, rng=rng)

    @staticmethod
    def _info(simulation: AttitudeSimulation) -> dict[str, Any]:
        return {"setpoint": simulation.setpoint[0], "rate": simulation.rate[0].copy()}
