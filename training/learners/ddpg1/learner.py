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

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.training.config.algorithms import Ddpg1Config
from neuroflight.training.config.training_config import TrainingConfig
from neuroflight.training.envs.sb3_vector import LearnerVecEnv
from neuroflight.training.learners.ddpg1.replay import Replay, row_width
from neuroflight.training.learners.ddpg1.update import ActorCritic, Engine, Learnt, Losses
from neuroflight.training.learners.memory import check_memory
from neuroflight.training.learners.network.normalization import ObservedMoments
from neuroflight.training.learners.protocol import Report, named_layers

REPORT_STEPS = 4096  # control steps, all aircraft together, between reports at least
ADAPTATION = 1.01  # factor of the perturbation's deviation from a rollout to the next

Floats = NDArray[np.float32]


class Ddpg1Learner:
    """The learner DDPG. The replay buffer is part of the state."""

    def __init__(self, aircraft: Aircraft, config: TrainingConfig, ddpg1: Ddpg1Config) -> None:
        self._config, self._ddpg1 = config, ddpg1
        inputs, motors = len(config.observation_scale(aircraft.motor_count)), aircraft.motor_count
        check_memory(ddpg1.buffer, config.steps, row_width(inputs, motors))
        self._env = LearnerVecEnv(aircraft, config, ddpg1.aircraft)
        self._networks = ActorCritic(inputs, config.hidden, motors, config.activation)
        self._engine = Engine(self._networks)
        self._learnt = Learnt.fresh(self._networks.fresh(np.random.default_rng(config.seed)))
        self._observed = ObservedMoments.none(inputs)
        self._replay = Replay(ddpg1.buffer, inputs, motors)
        self._deviation = ddpg1.noise  # of the perturbations
        self._steps = self._updates = 0

    @property
    def steps(self) -> int:
        """See Learner."""
        return self._steps

    def learn(self, segment: int, report: Callable[[Report], None]) -> None:
        """See Learner."""
        ddpg1 = self._ddpg1
        flight, noise = np.random.SeedSequence([self._config.seed, segment]).spawn(2)
        self._env.restart(np.random.default_rng(flight))
        rng = np.random.Generator(np.random.SFC64(noise))
        observation = self._env.reset()
        perturbations = _normal(rng, self._networks.counts[0], ddpg1.aircraft)
        rewards, count = 0.0, 0
        for index in range(ddpg1.leg):
            if self._steps >= self._config.steps:
                return
            observation, reward = self._fly(observation, perturbations, rng)
            self._steps += ddpg1.aircraft * ddpg1.horizon
            rewards, count = rewards + reward, count + ddpg1.aircraft * ddpg1.horizon
            distance = self._adapt(rng)
            figures = self._update(rng)
            last = index == ddpg1.leg - 1 or self._steps >= self._config.steps
            if count >= REPORT_STEPS or last:
                figures |= {"train/action_distance": distance, "train/parameter_noise": self._deviation}
                report(Report(self._steps, rewards / count, figures))
                rewards, count = 0.0, 0

    def outputs(self, observations: Floats) -> Floats:
        """Compute the deterministic policy's outputs (N, M), in -1..1, for scaled observations (N, n)."""
        normalization = self._observed.normalization
        return self._engine.outputs(self._learnt.parameters, normalization, observations).astype(np.float32)

    def values(self, observations: Floats, actions: Floats) -> Floats:
        """Estimate, by the critic, returns (N,) from scaled observations (N, n) and actions (N, M) on."""
        normalization, parameters = self._observed.normalization, self._learnt.parameters
        return self._engine.values(parameters, normalization, observations, actions).astype(np.float32)

    def _fly(
        self, observation: Floats, perturbations: Floats, rng: np.random.Generator
    ) -> tuple[Floats, float]:
        """Fly a rollout from `observation` (N, n) on; return the observation after it, and the sum of its
        rewards.

        perturbations: of each aircraft, (parameters of an actor, N), changed in place when an episode ends.
        """
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

    def policy(self) -> dict[str, torch.Tensor]:
        """See Learner."""
        actor, _ = self._networks.parts(self._learnt.parameters)
        tensors = [torch.from_numpy(part) for part in self._observed.folded(actor)]
        pairs = zip(tensors[::2], tensors[1::2], strict=True)
        return named_layers([{"weight": weight, "bias": bias} for weight, bias in pairs])

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

    def close(self) -> None:
        """Leave the physics client."""
        self._env.close()


def _normal(rng: np.random.Generator, *shape: int) -> Floats:
    return rng.standard_normal(shape, np.float32)
