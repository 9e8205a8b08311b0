"""Many aircraft as one Stable-Baselines3 vector env: one physics client, one call a step for all."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.utils import EzPickle
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.arrays import Array32
from neuroflight.training.config.training_config import TrainingConfig
from neuroflight.training.envs.batch import AttitudeBatch, check_render_mode
from neuroflight.training.envs.setup import Setup, make_setup
from neuroflight.training.envs.simulation import StepResult

# SB3 clips the outputs of a policy without bounds to the action space, which must be finite. This limit is
# beyond the outputs of any network in use: the simulation clips, so that the reward can see by how much.
OUTPUT_MAX = 1e3

Infos = list[dict[str, Any]]


class BatchVecEnv(VecEnv):
    """A batch behind SB3's vector interface.

    An episode ends only when its time is over: every end is reported as a truncation with its last
    observation, so that the learner bootstraps its value.
    """

    def __init__(self, batch: AttitudeBatch, action_space: spaces.Box, render_mode: str | None) -> None:
        self.batch, self.render_mode = batch, render_mode
        self._actions = np.zeros((batch.count, *action_space.shape), np.float32)
        super().__init__(batch.count, batch.observation_space, action_space)

    def step_async(self, actions: Array32) -> None:
        """Take the actions (N, M) for the next `step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[Array32, Array32, NDArray[np.bool_], Infos]:
        """Advance all aircraft; ended ones begin anew, their last observation goes into the info."""
        result = self._advance(self._actions)
        infos: Infos
        observation, infos = result.observation, [{} for _ in range(self.num_envs)]
        if result.ended.any():
            index = np.flatnonzero(result.ended)
            for i in index:
                infos[i] = {"TimeLimit.truncated": True, "terminal_observation": observation[i].copy()}
            observation[index] = self.batch.restart(index)
        return observation, result.reward, result.ended, infos

    def _advance(self, actions: Array32) -> StepResult:
        raise NotImplementedError

    def close(self) -> None:
        """Close the physics simulation."""
        self.batch.close()

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """Return a picture of each aircraft."""
        return self.batch.frames(range(self.num_envs))

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return the same attribute for each aircraft: they share one object."""
        return [getattr(self, attr_name)] * len(list(self._get_indices(indices)))

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
        """Refuse: aircraft have no methods of their own."""
        raise AttributeError(f"{type(self).__name__} has no per-aircraft method {method_name!r}")

    def env_is_wrapped(self, wrapper_class: type[Any], indices: VecEnvIndices = None) -> list[bool]:
        """Return that no aircraft is wrapped."""
        return [False] * len(list(self._get_indices(indices)))


class AttitudeVecEnv(BatchVecEnv, EzPickle):
    """N aircraft, each as `AttitudeEnv` has it: `PPO("MlpPolicy", AttitudeVecEnv(8))`.

    One random stream serves all: a seed repeats the flights of all aircraft together. Infos are empty but at
    an episode's end, as a dictionary an aircraft takes as long as its flight: `batch.info()` has the rates.
    """

    def __init__(
        self,
        num_envs: int = 1,
        *,
        render_mode: str | None = None,
        **arguments: Any,  # noqa: ANN401
    ) -> None:
        """arguments: see `training.envs.setup.make_setup`; render_mode: None or "rgb_array"."""
        EzPickle.__init__(self, num_envs, render_mode=render_mode, **arguments)
        check_render_mode(render_mode)
        batch = AttitudeBatch(make_setup(num_envs, **arguments), num_envs, np.random.default_rng())
        super().__init__(batch, batch.action_space, render_mode)

    def reset(self) -> Array32:
        """Begin an episode on every aircraft; after `seed`, those that its number repeats."""
        if self._seeds[0] is not None:
            self.batch.reseed(np.random.default_rng(self._seeds[0]))
        elif self.batch.closed:
            self.batch.reseed(np.random.default_rng())
        self._reset_seeds()
        self._reset_options()
        return self.batch.reset()

    def _advance(self, actions: Array32) -> StepResult:
        return self.batch.step(actions)


class LearnerVecEnv(BatchVecEnv):
    """N aircraft as our own learners fly them: no limit on outputs, episodes spread over their time.

    Off-policy actors end in tanh, and PPO's with a beta distribution too, so their actions lie in -1..1;
    those of the others have no bound, and with `OutputMap.squash` go through tanh here.
    """

    def __init__(
        self, aircraft: Aircraft, config: TrainingConfig, count: int, *, reward_scale: float = 1.0
    ) -> None:
        """Create `count` aircraft; the first episodes use the configuration's seed; rewards are scaled."""
        rng = np.random.default_rng(config.seed)
        batch = AttitudeBatch(Setup(aircraft, config, reward_scale), count, rng)
        bounded = config.drawn_bounded
        self._squash = config.output.squash and not bounded
        limit = 1.0 if bounded else OUTPUT_MAX
        super().__init__(batch, spaces.Box(-limit, limit, (aircraft.motor_count,), np.float32), None)

    def restart(self, rng: np.random.Generator) -> None:
        """Replace the twin by a new one with the random stream `rng`; call `reset` next."""
        self.batch.reseed(rng)

    def reset(self) -> Array32:
        """Begin an episode on every aircraft, spread over the episode's time."""
        return self.batch.reset(stagger=True)

    def _advance(self, actions: Array32) -> StepResult:
        return self.batch.step(np.tanh(actions) if self._squash else actions, limit=None)
