"""Common to the learners whose networks are in C: the aircraft, segments of rollouts, reports, the policy."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.arrays import Array32
from neuroflight.training.config.algorithms import Rollouts
from neuroflight.training.config.training_config import TrainingConfig
from neuroflight.training.envs.sb3_vector import LearnerVecEnv
from neuroflight.training.learners.network.normalization import ObservedMoments
from neuroflight.training.learners.protocol import Report, named_layers

REPORT_STEPS = 4096  # control steps, all aircraft together, between reports at least


class RolloutLearner:
    """A learner that flies a rollout and then updates its networks."""

    def __init__(self, aircraft: Aircraft, config: TrainingConfig, rollouts: Rollouts) -> None:
        self._config, self._rollouts = config, rollouts
        self._inputs = len(config.observation_scale(aircraft.motor_count))
        self._env = LearnerVecEnv(aircraft, config, rollouts.aircraft)
        self._observed = ObservedMoments.none(self._inputs)
        self._steps = self._updates = 0

    @property
    def steps(self) -> int:
        """See Learner."""
        return self._steps

    def learn(self, segment: int, report: Callable[[Report], None]) -> None:
        """See Learner."""
        flight, noise = np.random.SeedSequence([self._config.seed, segment]).spawn(2)
        self._env.restart(np.random.default_rng(flight))
        rng = np.random.Generator(np.random.SFC64(noise))
        observation = self._env.reset()
        self._begin(rng)
        rewards, count = 0.0, 0
        for index in range(self._rollouts.leg):
            if self._steps >= self._config.steps:
                return
            observation, reward, figures = self._rollout(observation, rng)
            self._steps += self._rollouts.batch
            rewards, count = rewards + reward, count + self._rollouts.batch
            last = index == self._rollouts.leg - 1 or self._steps >= self._config.steps
            if count >= REPORT_STEPS or last:
                report(Report(self._steps, rewards / count, figures))
                rewards, count = 0.0, 0

    def policy(self) -> dict[str, torch.Tensor]:
        """See Learner."""
        tensors = [torch.from_numpy(part) for part in self._observed.folded(self._actor_parts())]
        pairs = zip(tensors[::2], tensors[1::2], strict=True)
        return named_layers([{"weight": weight, "bias": bias} for weight, bias in pairs])

    def close(self) -> None:
        """See Learner."""
        self._env.close()

    def _begin(self, rng: np.random.Generator) -> None:
        """Draw what a segment begins with."""

    def _rollout(
        self, observation: Array32, rng: np.random.Generator
    ) -> tuple[Array32, float, dict[str, float]]:
        """Fly a rollout from `observation` (N, n) on and update; return the next one, rewards and figures."""
        raise NotImplementedError

    def _actor_parts(self) -> Sequence[Array32]:
        """Return weights and biases of the actor's layers, which take normalized observations."""
        raise NotImplementedError
