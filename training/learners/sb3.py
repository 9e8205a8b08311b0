"""Common to all learners of Stable-Baselines3: the aircraft, segments, reports."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.utils import set_random_seed

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.training.config.training_config import TrainingConfig
from neuroflight.training.envs.sb3_vector import LearnerVecEnv
from neuroflight.training.learners.protocol import Report

MODULES = {"tanh": torch.nn.Tanh, "relu": torch.nn.ReLU}
REWARD_SCALE_MIN = 1e-4
REPORT_STEPS = 4096  # control steps, all aircraft together, between reports at least


class Sb3Learner:
    """A learner of Stable-Baselines3. A subclass builds `_model` and names its optimizers."""

    _model: BaseAlgorithm

    def __init__(self, aircraft: Aircraft, config: TrainingConfig, discount: float) -> None:
        self._config = config
        self.part = 0.0  # share of the run that is over
        # Scaled so, a value is a mean reward for any horizon. A new critic with small weights can output that
        # at once; for a sum over a hundred steps its weights would have to grow for a million steps.
        self._reward_scale = max(1.0 - discount, REWARD_SCALE_MIN)
        count = config.algorithm.aircraft
        self._env = LearnerVecEnv(aircraft, config, count, reward_scale=self._reward_scale)

    @property
    def steps(self) -> int:
        """See Learner."""
        return int(self._model.num_timesteps)

    def learn(self, segment: int, report: Callable[[Report], None]) -> None:
        """See Learner."""
        sequence = np.random.SeedSequence([self._config.seed, segment])
        self._env.restart(np.random.default_rng(sequence))
        seed = int(sequence.generate_state(1)[0])
        set_random_seed(seed)
        self._env.action_space.seed(seed)
        model = self._model
        model._last_obs = None  # a new segment begins with new episodes
        model.set_logger(Logger(None, []))  # the default logger would make an empty folder in /tmp
        steps = min(self._config.algorithm.leg_steps, self._config.steps - self.steps)

        def reported(update: Report) -> None:
            self.part = min(1.0, update.steps / self._config.steps)
            report(update)

        model.learn(steps, callback=_Reporter(reported, self._reward_scale), reset_num_timesteps=False)

    def policy(self) -> dict[str, torch.Tensor]:
        """See Learner."""
        state = self._model.policy.state_dict()
        wanted = ("mlp_extractor.policy_net", "action_net")
        return {name: tensor for part in wanted for name, tensor in state.items() if name.startswith(part)}

    def state(self) -> dict[str, Any]:
        """See Learner."""
        return {
            "steps": self.steps,
            "updates": self._model._n_updates,
            "networks": self._model.policy.state_dict(),
            "optimizers": [optimizer.state_dict() for optimizer in self._optimizers()],
        }

    def restore(self, state: dict[str, Any]) -> None:
        """See Learner."""
        self._model.num_timesteps = state["steps"]
        self._model._n_updates = state["updates"]
        self.part = min(1.0, self.steps / self._config.steps)
        self._model.policy.load_state_dict(state["networks"])
        for optimizer, kept in zip(self._optimizers(), state["optimizers"], strict=True):
            optimizer.load_state_dict(kept)

    def close(self) -> None:
        """See Learner."""
        self._env.close()

    def _optimizers(self) -> list[torch.optim.Optimizer]:
        """Return the optimizers whose state is kept."""
        raise NotImplementedError

    def _networks(self, **more: Any) -> dict[str, Any]:  # noqa: ANN401 - of Stable-Baselines3's policies
        """Return the arguments of a policy with the configuration's layers."""
        layers, kind = list(self._config.hidden), MODULES[self._config.activation]
        return {"net_arch": layers, "activation_fn": kind, **more}

    def _annealed(self, rate: float) -> Callable[[float], float]:
        """Return a learning rate that falls linearly to a tenth over the run, across segments."""
        return lambda _: rate * (1.0 - 0.9 * self.part)


class _Reporter(BaseCallback):
    """A callback that reports after rollouts, with the mean reward per control step since the last report."""

    def __init__(self, report: Callable[[Report], None], reward_scale: float) -> None:
        super().__init__()
        self._report, self._reward_scale = report, reward_scale
        self._sum, self._count = 0.0, 0

    def _on_step(self) -> bool:
        rewards = self.locals["rewards"]
        self._sum += float(rewards.sum())
        self._count += len(rewards)
        return True

    def _on_rollout_end(self) -> None:
        model = self.model
        if self._count < REPORT_STEPS and model.num_timesteps < model._total_timesteps:
            return
        figures = {name: float(value) for name, value in model.logger.name_to_value.items()}
        self._report(Report(self.num_timesteps, self._sum / self._count / self._reward_scale, figures))
        self._sum, self._count = 0.0, 0
