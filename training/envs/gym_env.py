"""One aircraft as a Gymnasium environment, for any library with a Gymnasium interface.

`import training`, then `gymnasium.make("neuroflight/Attitude-v0", aircraft="nf1", task="pulse")`; or let
Gymnasium import it: `gymnasium.make("training:neuroflight/Attitude-v0")`. A stock learner on it:

    import gymnasium
    import numpy as np
    from stable_baselines3 import PPO
    from training.tasks.reward import TrackingReward

    env = gymnasium.make(
        "training:neuroflight/Attitude-v0",
        aircraft="nf1",
        task={"name": "pulse", "sigma_deg_s": 60},
        reward=TrackingReward(change=0.2),
        observation="rate_error,rate_error_delta,previous_action",
    )
    env = gymnasium.wrappers.RescaleAction(env, np.float32(-1), np.float32(1))  # as most learners expect
    PPO("MlpPolicy", env).learn(100_000)

With `config` (a recipe, a file or a TrainingConfig) all of this comes from there, and the world too.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from sim.aircraft.model import load_aircraft
from sim.control.observation import limits
from training.config.algorithms import PpoConfig
from training.config.config_file import load_config
from training.config.config_table import ConfigReader
from training.config.training_config import TrainingConfig
from training.envs.simulation import AttitudeSimulation
from training.tasks.registry import TASKS
from training.tasks.reward import REWARDS, Reward
from training.tasks.task import Task

Named = str | Mapping[str, Any]  # a name, or a table with a name and fields
ONE_AIRCRAFT = PpoConfig(aircraft=1, horizon=1, minibatch=1)  # the environment does not depend on the learner


class AttitudeEnv(gymnasium.Env[NDArray[np.float32], NDArray[np.float32]]):
    """Track rate commands with one aircraft.

    Observation: the terms of `observation`, raw units (rad/s, rad, fractions), float32 (n,).
    Action: motor fractions 0..1 before the throttle mix, float32 (M,), clipped to this range.
    Ends only by its clock, as a truncation. `info` holds `setpoint` and `rate`, (3,) [rad/s].
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012 - Gymnasium's declaration

    def __init__(
        self,
        aircraft: str | Path = "nf1",
        task: Named | Task | None = None,
        reward: Named | Reward | None = None,
        observation: str | None = None,
        control_rate_hz: int | None = None,
        config: str | Path | TrainingConfig | None = None,
    ) -> None:
        """aircraft: shipped name or file; the others replace the values of `config`.

        Raises AircraftError or TrainingError, one line, on invalid arguments.
        """
        given = {
            "task": _named(TASKS, "task", task),
            "reward": _named(REWARDS, "reward", reward),
            "observation": observation,
            "control_rate_hz": control_rate_hz,
        }
        base = config if isinstance(config, TrainingConfig) else load_config(config)
        changes: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
        self._config = replace(base, algorithm=ONE_AIRCRAFT, **changes)
        self._aircraft = load_aircraft(aircraft)
        self._config.check(self._aircraft)
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


def _named(registry: Mapping[str, type[Any]], what: str, value: object) -> object:
    """The task or reward that a name or a table describes; another value is returned as it is."""
    if isinstance(value, str | Mapping):
        return ConfigReader("environment", {}).named(registry, value, what)
    return value
