"""PPO1: what Koch 2019 trained with, OpenAI Baselines' first PPO; its networks and updates are C (`c/`).

Differences from the learner `ppo`:

- The deviation of each motor's normal distribution is learned, and every control step draws anew.
- Observations are normalized by the running mean and deviation of all so far. `policy` folds these into the
  first layer. Baselines also clips what is normalized to +-5; a frozen policy would not, so this does not.
- Advantages are normalized over the whole rollout. The loss has no smoothness term.
- The gradient is not clipped. Learning rate and clip range fall linearly to 0 over the run (`anneal`).
- Minibatches are small: 64 samples, some hundred steps of Adam for two thousand control steps. In torch each
  takes half a millisecond, here some hundredths of one.

Differences from Baselines: several aircraft share a rollout, where it has one (or one a process); an episode
ends by time alone, and the value of its last observation counts for what would have followed; the critic
outputs values normalized by their running mean and spread, and its last layer is rescaled when these change
(van Hasselt et al. 2016, PopArt), because rewards of the dissertation reach from 1 to 1e9; Adam's eps is
added behind the bias correction.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.arrays import Array32
from neuroflight.training.config.algorithms import Ppo1Config
from neuroflight.training.config.training_config import OutputMap, TrainingConfig
from neuroflight.training.learners.network.learner import RolloutLearner
from neuroflight.training.learners.network.normalization import ObservedMoments
from neuroflight.training.learners.network.shape import Shape
from neuroflight.training.learners.ppo1.normalization import ReturnMoments
from neuroflight.training.learners.ppo1.rollout import Rollout, advantages
from neuroflight.training.learners.ppo1.update import ActorCritic, Engine, Losses, Samples

NUMBER_MIN = 1e-8
FIGURES = "train/surrogate", "train/value_loss", "train/clipped"


class Ppo1Learner(RolloutLearner):
    """The learner PPO1."""

    def __init__(self, aircraft: Aircraft, config: TrainingConfig, ppo1: Ppo1Config) -> None:
        super().__init__(aircraft, config, ppo1)
        self._ppo1 = ppo1
        layers, plain = (self._inputs, *config.hidden), OutputMap()
        self._networks = ActorCritic(
            Shape((*layers, aircraft.motor_count), config.activation, plain),
            Shape((*layers, 1), config.activation, plain),
        )
        self._engine = Engine(self._networks)
        rng = np.random.default_rng(config.seed)
        self._parameters = self._networks.fresh(ppo1.log_std, rng)
        self._adam = np.zeros_like(self._parameters), np.zeros_like(self._parameters)
        self._returned = ReturnMoments()

    def _rollout(
        self, observation: Array32, rng: np.random.Generator
    ) -> tuple[Array32, float, dict[str, float]]:
        """See RolloutLearner."""
        left = 1.0 - self._steps / self._config.steps if self._ppo1.anneal else 1.0
        rollout = self._fly(observation, rng)
        figures = self._update(rollout, left, rng)
        return rollout.observations[-1], float(rollout.rewards.sum()), figures

    def outputs(self, observations: Array32) -> Array32:
        """Compute the deterministic policy's outputs (N, M) for scaled observations (N, n)."""
        return self._engine.outputs(self._parameters, self._observed.normalization, observations).astype(
            np.float32
        )

    def values(self, observations: Array32) -> NDArray[np.float64]:
        """Estimate, by the critic, returns (...) from scaled observations (..., n) on."""
        rows = observations.reshape(-1, observations.shape[-1])
        values = self._engine.values(self._parameters, self._observed.normalization, rows).astype(np.float64)
        return (values * self._returned.spread + self._returned.mean).reshape(observations.shape[:-1])

    def _fly(self, observation: Array32, rng: np.random.Generator) -> Rollout:
        """Fly a rollout from `observation` (N, n) on."""
        networks, normalization = self._networks, self._observed.normalization
        rollout = Rollout.empty(self._ppo1.horizon, len(observation), observation.shape[1], networks.motors)
        drawn = rng.standard_normal(rollout.actions.shape, np.float32)
        drawn *= np.exp(networks.split(self._parameters)[1])
        env, actor = self._env, self._engine.acting(self._parameters, normalization, len(observation))
        rollout.observations[0] = observation
        for step, noise in enumerate(drawn):
            rollout.actions[step] = actor(observation) + noise
            env.step_async(rollout.actions[step])
            observation, rollout.rewards[step], ended, infos = env.step_wait()
            rollout.observations[step + 1] = observation
            rollout.ended[step] = ended
            for who in np.flatnonzero(ended).tolist():
                rollout.last.append((step, who, infos[who]["terminal_observation"]))
        return rollout

    def _update(self, rollout: Rollout, left: float, rng: np.random.Generator) -> dict[str, float]:
        """Do all epochs over a rollout; left: share of the learning rate and of the clip range."""
        ppo1 = self._ppo1
        values = self.values(rollout.observations)
        following = rollout.following(values, self.values)
        found = advantages(
            rollout.rewards, values[:-1], following, rollout.ended, ppo1.discount, ppo1.gae_lambda
        )
        returns = (found + values[:-1]).ravel()
        rows = rollout.observations[:-1].reshape(returns.size, -1)
        self._observed = self._observed.with_more(rows)
        self._rescale_critic(self._returned.with_more(returns))
        normalization = self._observed.normalization
        actions = rollout.actions.reshape(returns.size, -1)
        samples = Samples(
            observations=rows,
            actions=actions,
            log_prob=self._engine.log_prob(self._parameters, normalization, rows, actions),
            advantages=((found - found.mean()) / (found.std() + NUMBER_MIN)).astype(np.float32).ravel(),
            returns=((returns - self._returned.mean) / self._returned.spread).astype(np.float32),
        )
        losses = Losses(ppo1.clip * left, ppo1.entropy, ppo1.learning_rate * left, ppo1.minibatch)
        for _ in range(ppo1.epochs):
            order = rng.permutation(returns.size).astype(np.int32)
            figures, _ = self._engine.epoch(
                self._parameters, self._adam, self._updates, normalization, samples, order, losses
            )
            self._updates += returns.size // ppo1.minibatch
        std = np.exp(self._networks.split(self._parameters)[1]).mean()
        return {
            **dict(zip(FIGURES, figures.tolist(), strict=True)),
            "train/std": float(std),
            "train/learning_rate": losses.rate,
            "train/explained_variance": 1.0 - float(found.var() / max(returns.var(), NUMBER_MIN)),
        }

    def _rescale_critic(self, returned: ReturnMoments) -> None:
        """Take over new moments, and change the last layer so that the critic's values stay the same."""
        old, self._returned = self._returned, returned
        *_, weight, bias = self._networks.critic.split(self._networks.split(self._parameters)[2])
        bias[:] = (bias * old.spread + old.mean - returned.mean) / returned.spread
        weight *= np.float32(old.spread / returned.spread)

    def _actor_parts(self) -> list[Array32]:
        """See RolloutLearner."""
        return self._networks.actor.split(self._networks.split(self._parameters)[0])

    def state(self) -> dict[str, Any]:
        """See Learner."""
        first, second = self._adam
        return {
            "steps": self._steps,
            "updates": self._updates,
            "parameters": torch.from_numpy(self._parameters.copy()),
            "adam": [torch.from_numpy(first.copy()), torch.from_numpy(second.copy())],
            "observed": self._observed.state(),
            "returned": dict(vars(self._returned)),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """See Learner."""
        self._steps, self._updates = state["steps"], state["updates"]
        self._parameters = state["parameters"].numpy().copy()
        first, second = (mean.numpy().copy() for mean in state["adam"])
        self._adam = first, second
        self._observed = ObservedMoments.restored(state["observed"])
        self._returned = ReturnMoments(**state["returned"])
