"""DDPG: what Koch 2019 trained with, OpenAI Baselines' of 2018; its networks and updates are C (`c/`).

Differences from the learner `ddpg`:

- Exploration is noise on the actor's parameters (Plappert et al. 2018), not on its outputs: an aircraft flies
  a whole episode with one perturbation. Its deviation adapts until outputs differ by `noise`.
- Actor and critic have learning rates of their own, which stay. The critic takes the action at its second
  layer.
- Observations are normalized by the running mean and deviation of all so far. `policy` folds these into the
  first layer. Rewards are not scaled.
- Updates begin after the first rollout, and all of a rollout's are one call of C.

Differences from Baselines:

- No layer has layer normalization, which a frozen policy would have to compute. So all parameters of the
  actor are perturbed.
- The critic's weights do not decay unless `critic_decay` says so. Baselines has 1e-2, not in the last layer.
  Layer normalization follows all weights that decay there. Here none does: 1e-2 brought those of the action
  from 0.11 to 0.004 within 4,000 control steps, and the actor's outputs stayed at their limits.
- Several aircraft share a rollout, each with a perturbation of its own, which is drawn when its episode
  begins. It is added to the newest actor in every rollout, where Baselines' perturbed actor stays that of the
  episode's begin: an episode is here as many rollouts longer as there are aircraft.
- An episode ends by time alone, and the value of its last observation counts for what would have followed;
  Baselines takes the end of time for an end.
- The buffer has 200,000 control steps by default, a fifth of Baselines', because a checkpoint has a limit.
- What is normalized is not clipped to +-5: a frozen policy would not.
- The moments of observations are brought up to date after each rollout, not after each control step.
- Adam's eps is added behind the bias correction.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.arrays import Array32
from neuroflight.training.config.algorithms import Ddpg1Config
from neuroflight.training.config.training_config import TrainingConfig
from neuroflight.training.learners.ddpg1.replay import Replay, row_width
from neuroflight.training.learners.ddpg1.update import ActorCritic, Engine, Learnt, Losses
from neuroflight.training.learners.memory import check_memory
from neuroflight.training.learners.network.learner import RolloutLearner
from neuroflight.training.learners.network.normalization import ObservedMoments

ADAPTATION = 1.01  # factor of the perturbation's deviation from a rollout to the next


class Ddpg1Learner(RolloutLearner):
    """The learner DDPG. The replay buffer is part of the state."""

    def __init__(self, aircraft: Aircraft, config: TrainingConfig, ddpg1: Ddpg1Config) -> None:
        inputs, motors = len(config.observation_scale(aircraft.motor_count)), aircraft.motor_count
        check_memory(ddpg1.buffer, config.steps, row_width(inputs, motors))
        super().__init__(aircraft, config, ddpg1)
        self._ddpg1 = ddpg1
        self._networks = ActorCritic(inputs, config.hidden, motors, config.activation)
        self._engine = Engine(self._networks)
        self._learnt = Learnt.fresh(self._networks.fresh(np.random.default_rng(config.seed)))
        self._replay = Replay(ddpg1.buffer, inputs, motors)
        self._deviation = ddpg1.noise  # of the perturbations
        # Of each aircraft, (parameters of an actor, N); one is drawn anew when its episode ends.
        self._perturbations = np.empty((self._networks.counts[0], 0), np.float32)

    def _begin(self, rng: np.random.Generator) -> None:
        """See RolloutLearner."""
        self._perturbations = _normal(rng, self._networks.counts[0], self._ddpg1.aircraft)

    def _rollout(
        self, observation: Array32, rng: np.random.Generator
    ) -> tuple[Array32, float, dict[str, float]]:
        """See RolloutLearner."""
        after, rewards = self._fly(observation, rng)
        distance = self._adapt(rng)
        figures = {**self._update(rng), "train/action_distance": distance}
        return after, rewards, figures | {"train/parameter_noise": self._deviation}

    def outputs(self, observations: Array32) -> Array32:
        """Compute the deterministic policy's outputs (N, M), in -1..1, for scaled observations (N, n)."""
        normalization = self._observed.normalization
        return self._engine.outputs(self._learnt.parameters, normalization, observations).astype(np.float32)

    def values(self, observations: Array32, actions: Array32) -> Array32:
        """Estimate, by the critic, returns (N,) from scaled observations (N, n) and actions (N, M) on."""
        normalization, parameters = self._observed.normalization, self._learnt.parameters
        return self._engine.values(parameters, normalization, observations, actions).astype(np.float32)

    def _fly(self, observation: Array32, rng: np.random.Generator) -> tuple[Array32, float]:
        """Fly from `observation` (N, n) on; return the observation after it, and the sum of the rewards."""
        perturbations = self._perturbations
        env, replay, normalization = self._env, self._replay, self._observed.normalization
        actor = self._networks.split(self._learnt.parameters)[0]
        deviation = np.float32(self._deviation)
        actors = actor[:, None] + deviation * perturbations
        act, seen, rewards = self._engine.acting(actors, normalization), [], 0.0
        for _ in range(self._ddpg1.horizon):
            actions = act(observation)
            env.step_async(actions)
            after, reward, ended, infos = env.step_wait()
            following = after
            if ended.any():
                following, whose = after.copy(), np.flatnonzero(ended)
                following[whose] = [infos[who]["terminal_observation"] for who in whose]
                perturbations[:, whose] = _normal(rng, len(actor), len(whose))
                actors[:, whose] = actor[:, None] + deviation * perturbations[:, whose]
            replay.add(observation, actions, reward, following)
            seen.append(observation)
            observation, rewards = after, rewards + float(reward.sum(dtype=np.float64))
        self._observed = self._observed.with_more(np.concatenate(seen))
        return observation, rewards

    def _adapt(self, rng: np.random.Generator) -> float:
        """Bring the deviation nearer to that whose outputs differ by `noise`; returns what they differ by."""
        parameters, normalization = self._learnt.parameters, self._observed.normalization
        width = self._networks.inputs
        observations = self._replay.rows[self._replay.draw(rng, self._ddpg1.minibatch), :width]
        perturbed = parameters.copy()
        actor = self._networks.split(perturbed)[0]
        actor += np.float32(self._deviation) * _normal(rng, len(actor))
        away = self._engine.outputs(perturbed, normalization, observations) - self._engine.outputs(
            parameters, normalization, observations
        )
        distance = float(np.sqrt(np.square(away).mean(dtype=np.float64)))
        self._deviation *= ADAPTATION if distance < self._ddpg1.noise else 1.0 / ADAPTATION
        return distance

    def _update(self, rng: np.random.Generator) -> dict[str, float]:
        """Do all updates that follow a rollout."""
        ddpg1 = self._ddpg1
        rates = ddpg1.actor_learning_rate, ddpg1.learning_rate
        figures, _ = self._engine.update(
            self._learnt,
            self._updates,
            self._observed.normalization,
            self._replay.rows,
            self._replay.draw(rng, ddpg1.updates, ddpg1.minibatch),
            Losses(ddpg1.discount, ddpg1.tau, ddpg1.critic_decay, rates),
        )
        self._updates += ddpg1.updates
        return {"train/critic_loss": float(figures[0]), "train/value": float(figures[1])}

    def _actor_parts(self) -> list[Array32]:
        """See RolloutLearner."""
        return self._networks.parts(self._learnt.parameters)[0]

    def state(self) -> dict[str, Any]:
        """See Learner."""
        return {
            "steps": self._steps,
            "updates": self._updates,
            "deviation": self._deviation,
            "learnt": {name: torch.from_numpy(array.copy()) for name, array in vars(self._learnt).items()},
            "observed": self._observed.state(),
            "memory": self._replay.state(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """See Learner."""
        self._steps, self._updates, self._deviation = state["steps"], state["updates"], state["deviation"]
        self._learnt = Learnt(**{name: tensor.numpy().copy() for name, tensor in state["learnt"].items()})
        self._observed = ObservedMoments.restored(state["observed"])
        self._replay.restore(state["memory"])


def _normal(rng: np.random.Generator, *shape: int) -> Array32:
    return rng.standard_normal(shape, np.float32)
