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

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.training.config.algorithms import Ppo1Config
from neuroflight.training.config.training_config import OutputMap, TrainingConfig
from neuroflight.training.envs.sb3_vector import LearnerVecEnv
from neuroflight.training.learners.network.normalization import ObservedMoments
from neuroflight.training.learners.network.shape import Shape
from neuroflight.training.learners.ppo1.normalization import ReturnMoments
from neuroflight.training.learners.ppo1.rollout import Rollout, advantages
from neuroflight.training.learners.ppo1.update import ActorCritic, Engine, Losses, Samples
from neuroflight.training.learners.protocol import Report, named_layers

REPORT_STEPS = 4096  # control steps, all aircraft together, between reports at least
NUMBER_MIN = 1e-8
FIGURES = "train/surrogate", "train/value_loss", "train/clipped"

Floats = NDArray[np.float32]


class Ppo1Learner:
    """The learner PPO1."""

    def __init__(self, aircraft: Aircraft, config: TrainingConfig, ppo1: Ppo1Config) -> None:
        self._config, self._ppo1 = config, ppo1
        self._env = LearnerVecEnv(aircraft, config, ppo1.aircraft)
        inputs = len(config.observation_scale(aircraft.motor_count))
        layers, plain = (inputs, *config.hidden), OutputMap()
        self._networks = ActorCritic(
            Shape((*layers, aircraft.motor_count), config.activation, plain),
            Shape((*layers, 1), config.activation, plain),
        )
        self._engine = Engine(self._networks)
        rng = np.random.default_rng(config.seed)
        self._parameters = self._networks.fresh(ppo1.log_std, rng)
        self._adam = np.zeros_like(self._parameters), np.zeros_like(self._parameters)
        self._observed, self._returned = ObservedMoments.none(inputs), ReturnMoments()
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
        rewards, count = 0.0, 0
        for index in range(self._ppo1.leg):
            if self._steps >= self._config.steps:
                return
            left = 1.0 - self._steps / self._config.steps if self._ppo1.anneal else 1.0
            rollout = self._fly(observation, rng)
            observation = rollout.observations[-1]
            self._steps += rollout.rewards.size
            figures = self._update(rollout, left, rng)
            rewards, count = rewards + float(rollout.rewards.sum()), count + rollout.rewards.size
            last = index == self._ppo1.leg - 1 or self._steps >= self._config.steps
            if count >= REPORT_STEPS or last:
                report(Report(self._steps, rewards / count, figures))
                rewards, count = 0.0, 0

    def outputs(self, observations: Floats) -> Floats:
        """Compute the deterministic policy's outputs (N, M) for scaled observations (N, n)."""
        return self._engine.outputs(self._parameters, self._observed.normalization, observations).astype(
            np.float32
        )

    def values(self, observations: Floats) -> NDArray[np.float64]:
        """Estimate, by the critic, returns (...) from scaled observations (..., n) on."""
        rows = observations.reshape(-1, observations.shape[-1])
        values = self._engine.values(self._parameters, self._observed.normalization, rows).astype(np.float64)
        return (values * self._returned.spread + self._returned.mean).reshape(observations.shape[:-1])

    def _fly(self, observation: Floats, rng: np.random.Generator) -> Rollout:
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

    def policy(self) -> dict[str, torch.Tensor]:
        """See Learner."""
        actor = self._networks.actor.split(self._networks.split(self._parameters)[0])
        tensors = [torch.from_numpy(part) for part in self._observed.folded(actor)]
        pairs = zip(tensors[::2], tensors[1::2], strict=True)
        return named_layers([{"weight": weight, "bias": bias} for weight, bias in pairs])

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

    def close(self) -> None:
        """See Learner."""
        self._env.close()
