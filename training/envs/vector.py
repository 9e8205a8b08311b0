"""Many aircraft as one Stable-Baselines3 vector env: one physics client, one call a step for all."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices

from sim.aircraft.model import Aircraft
from training.config.training_config import TrainingConfig
from training.envs.simulation import AttitudeSimulation

# SB3 clips the outputs of a policy without bounds to the action space, which must be finite. This limit is
# beyond the outputs of any network in use: the simulation clips, so that the reward can see by how much.
OUTPUT_MAX = 1e3


class AttitudeVecEnv(VecEnv):
    """N aircraft behind SB3's vector interface. Observations are scaled, actions are the network's.

    Off-policy actors end in tanh, and PPO's with a beta distribution too, so their actions lie in -1..1;
    those of the others have no bound, and with `OutputMap.squash` go through tanh here. An episode ends only
    when its time is over: every end is reported as a truncation with its last observation, so that the
    learner bootstraps its value.
    """

    def __init__(
        self, aircraft: Aircraft, config: TrainingConfig, count: int, *, reward_scale: float = 1.0
    ) -> None:
        """`count` aircraft; the first episodes use the configuration's seed; rewards are scaled."""
        self._reward_scale = np.float32(reward_scale)
        self._aircraft, self._config = aircraft, config
        self._simulation = simulation = self._build(count, np.random.default_rng(config.seed))
        self._scale = np.array(config.observation_scale(simulation.motors), np.float32)
        self._output = config.output
        bounded = config.drawn_bounded
        self._squash = config.output.squash and not bounded
        limit = 1.0 if bounded else OUTPUT_MAX
        self._action = np.zeros((simulation.count, simulation.motors), np.float32)
        self._infos: list[dict[str, Any]] = [{} for _ in range(simulation.count)]
        self.render_mode = None
        super().__init__(
            simulation.count,
            spaces.Box(-np.inf, np.inf, (simulation.width,), np.float32),
            spaces.Box(-limit, limit, (simulation.motors,), np.float32),
        )

    def restart(self, rng: np.random.Generator) -> None:
        """Replace the twin by a new one with the random stream `rng`; call `reset` next."""
        self._simulation.close()
        self._simulation = self._build(self.num_envs, rng)

    def reset(self) -> NDArray[np.float32]:
        """Begin an episode on every aircraft, spread over the episode's time."""
        return self._simulation.reset(stagger=True) * self._scale

    def step_async(self, actions: NDArray[np.float32]) -> None:
        """Take the network's outputs (N, M) for the next `step_wait`."""
        self._action = self._output.unclipped(np.tanh(actions) if self._squash else actions)

    def step_wait(
        self,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Advance all aircraft; ended ones begin anew, their last observation goes into the info."""
        result = self._simulation.step(self._action)
        observation = result.observation * self._scale
        infos = self._infos
        if result.ended.any():
            index = np.flatnonzero(result.ended)
            infos = [{} for _ in range(self.num_envs)]
            for i in index:
                infos[i] = {"TimeLimit.truncated": True, "terminal_observation": observation[i].copy()}
            observation[index] = self._simulation.restart(index) * self._scale
        return observation, result.reward * self._reward_scale, result.ended, infos

    def _build(self, count: int, rng: np.random.Generator) -> AttitudeSimulation:
        return AttitudeSimulation(self._aircraft, count, config=self._config, rng=rng)

    def close(self) -> None:
        """Leave the physics client."""
        self._simulation.close()

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """The same attribute for each aircraft: they share one object."""
        return [getattr(self, attr_name)] * len(self._indices(indices))

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:  # noqa: ANN401
        """Set an attribute of the one object all aircraft share."""
        setattr(self, attr_name, value)

    def env_method(
        self,
        method_name: str,
        *method_args: Any,  # noqa: ANN401
        indices: VecEnvIndices = None,
        **method_kwargs: Any,  # noqa: ANN401
    ) -> list[Any]:
        """Aircraft have no methods of their own."""
        raise AttributeError(f"AttitudeVecEnv has no per-aircraft method {method_name!r}")

    def env_is_wrapped(self, wrapper_class: type[Any], indices: VecEnvIndices = None) -> list[bool]:
        """No aircraft is wrapped."""
        return [False] * len(self._indices(indices))

    def _indices(self, indices: VecEnvIndices) -> Sequence[int]:
        return list(self._get_indices(indices))
