"""PPO with a smoothness term in the policy's loss; actor and critic are trained in two threads.

The term follows CAPS (Mysore et al. 2021). Its spatial part is the difference of the mean outputs for an
observation and for the same one with new noise, drawn as the gyro's own: outputs that follow noise heat the
motors. Its temporal part is the difference for an observation and the following one. A penalty on sampled
actions does not work: PPO then moves its outputs to where they are clipped.

The critic outputs values normalized by their mean and spread (van Hasselt et al. 2016, PopArt): the returns
of an aircraft that cannot fly yet are a hundred times as negative as those of one that can.

Actor and critic share no weight, and each has its own optimizer and its own clipped gradient. So the result
does not depend on the order of their updates, and two threads can run them: torch releases the interpreter's
lock inside its kernels.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.utils import explained_variance
from stable_baselines3.common.vec_env import VecEnv
from torch.nn import functional

from neuroflight.training.learners.exploration import BetaExploration, NormalExploration

ADAM_EPS = 1e-5  # Stable-Baselines3's for PPO
VALUE_SPREAD_MIN = 1e-6


@dataclass(frozen=True)
class Smoothness:
    """Weights of the mean output's change, squared and summed over motors, in the policy's loss."""

    spatial: float  # under gyro noise
    temporal: float  # from a control step to the next
    observation_noise: NDArray[np.float32]  # (n,), standard deviation of each scaled observation


@dataclass(frozen=True, eq=False)
class Rollout:
    """A rollout's steps: those of the first aircraft, then those of the second, ..."""

    observations: torch.Tensor  # (S, n), scaled
    actions: torch.Tensor  # (S, M), drawn network outputs
    log_prob: torch.Tensor  # (S,), of the actions when they were drawn
    advantages: torch.Tensor  # (S,)
    returns: torch.Tensor  # (S,)
    followed: torch.Tensor  # (S,) 1 where the next row is the same episode's next step, else 0


class SmoothPpo(PPO):
    """Stable-Baselines3's PPO with another `train`, and a `collect_rollouts` that runs the critic once.

    The clip range is constant, and exploration follows a schedule, so there is no entropy term.
    """

    def __init__(
        self,
        *args: Any,  # noqa: ANN401 - PPO's own
        smoothness: Smoothness,
        clip: float,
        log_std: Callable[[], float],
        hold: int,
        exploration: NormalExploration | None = None,
        **kwargs: Any,  # noqa: ANN401 - PPO's own
    ) -> None:
        """log_std: schedule of the exploration, called before each update.

        If PPO learns it, it stays so large that the mean output drifts: the reward hardly depends on it.
        hold: control steps for which a draw is held. Rotors hardly respond to a change of one millisecond;
        they respond to a held one, and each of its steps is credited with the rewards of the others.
        exploration: the distribution of outputs; None: a normal one.
        """
        super().__init__(*args, **kwargs)
        self._log_std, self._hold = log_std, hold
        self._exploration = exploration or NormalExploration()
        self.policy.log_std.requires_grad_(False)
        self._smoothness = smoothness
        self._noise = torch.as_tensor(smoothness.observation_noise)
        self._clip = clip
        layers = self.policy.mlp_extractor
        bound = [torch.nn.Tanh()] if isinstance(self._exploration, BetaExploration) else []
        self.actor = torch.nn.Sequential(*layers.policy_net, self.policy.action_net, *bound)
        self.critic = torch.nn.Sequential(*layers.value_net, self.policy.value_net)
        self._value_mean, self._value_spread = torch.zeros(()), torch.ones(())
        self.policy.register_buffer("value_mean", self._value_mean)  # so it is saved with the networks
        self.policy.register_buffer("value_spread", self._value_spread)
        rate = self.lr_schedule(1.0)
        self.actor_optimizer = torch.optim.Adam(self.actor.parameters(), rate, eps=ADAM_EPS)
        self.critic_optimizer = torch.optim.Adam(self.critic.parameters(), rate, eps=ADAM_EPS)
        self._beside = ThreadPoolExecutor(1, "critic", initializer=torch.set_num_threads, initargs=(1,))

    def collect_rollouts(
        self, env: VecEnv, callback: BaseCallback, rollout_buffer: RolloutBuffer, n_rollout_steps: int
    ) -> bool:
        """Fly n_rollout_steps with drawn outputs. Returns whether the callback wants to go on."""
        observation = self._last_obs
        assert isinstance(observation, np.ndarray)
        buffer, log_std = rollout_buffer, float(self.policy.log_std.detach()[0])
        buffer.reset()
        callback.on_rollout_start()
        draws = torch.randn(-(-n_rollout_steps // self._hold), *buffer.actions.shape[1:])
        noise = draws.repeat_interleave(self._hold, dim=0)[:n_rollout_steps]
        held, centres = noise.numpy(), np.empty_like(buffer.actions)
        ends: list[tuple[int, int, NDArray[np.float32]]] = []  # step, aircraft, its last observation
        for step in range(n_rollout_steps):
            with torch.no_grad():
                centres[step] = self.actor(torch.from_numpy(observation)).numpy()
            action = self._exploration.drawn(centres[step], held[step], log_std)
            buffer.observations[step] = observation
            buffer.actions[step] = action
            buffer.episode_starts[step] = self._last_episode_starts
            following, rewards, ended, infos = env.step(action)
            assert isinstance(following, np.ndarray)
            observation = following
            buffer.rewards[step] = rewards
            for who in np.flatnonzero(ended).tolist():
                ends.append((step, who, infos[who]["terminal_observation"]))
            self._last_obs, self._last_episode_starts = observation, ended
            self.num_timesteps += env.num_envs
            callback.update_locals(locals())
            if not callback.on_step():
                return False
        buffer.pos, buffer.full = n_rollout_steps, True
        actions, means = torch.from_numpy(buffer.actions), torch.from_numpy(centres)
        buffer.log_probs[:] = self._exploration.log_prob_drawn(actions, means, noise, log_std).numpy()
        buffer.values[:] = self._values(buffer.observations)
        if ends:  # truncated episodes: the critic estimates the value of what would have followed
            steps, whose, last = zip(*ends, strict=True)
            buffer.rewards[list(steps), list(whose)] += self.gamma * self._values(np.stack(last))
        buffer.compute_returns_and_advantage(torch.from_numpy(self._values(observation)), ended)
        callback.update_locals(locals())
        callback.on_rollout_end()
        return True

    def train(self) -> None:
        """Update actor and critic from the rollout buffer."""
        self._update_learning_rate([self.actor_optimizer, self.critic_optimizer])
        rollout = self._rollout()
        self._rescale_values(rollout.returns)
        count = len(rollout.observations)
        orders = torch.cat([torch.randperm(count) for _ in range(self.n_epochs)])
        batches = list(torch.split(orders, self.batch_size))
        fit = self._beside.submit(self._fit_critic, rollout, batches)
        change = self._fit_actor(rollout, batches)
        value_loss = fit.result()
        self.policy.log_std.fill_(self._log_std())
        self._n_updates += self.n_epochs
        buffer = self.rollout_buffer
        explained = explained_variance(buffer.values.flatten(), buffer.returns.flatten())
        self.logger.record("train/explained_variance", explained)
        self.logger.record("train/value_loss", value_loss)
        self.logger.record("train/output_change", change)
        self.logger.record("train/std", float(self.policy.log_std.detach().exp().mean()))

    def _rollout(self) -> Rollout:
        buffer = self.rollout_buffer
        followed = np.zeros_like(buffer.episode_starts)
        followed[:-1] = 1.0 - buffer.episode_starts[1:]

        def rows(values: NDArray[np.float32]) -> torch.Tensor:
            return torch.from_numpy(buffer.swap_and_flatten(values))

        return Rollout(
            rows(buffer.observations),
            rows(buffer.actions),
            rows(buffer.log_probs)[:, 0],
            rows(buffer.advantages)[:, 0],
            rows(buffer.returns)[:, 0],
            rows(followed)[:, 0],
        )

    def _fit_actor(self, rollout: Rollout, batches: list[torch.Tensor]) -> float:
        change = torch.zeros(())
        for batch in batches:
            mean = self.actor(rollout.observations[batch])
            change = self._change(rollout, batch, mean)
            loss = change - self._surrogate(rollout, batch, mean)
            self._descend(loss, self.actor, self.actor_optimizer)
        return float(change.detach())

    def _rescale_values(self, returns: torch.Tensor) -> None:
        """Set new mean and spread, and change the last layer so that the critic's values stay the same."""
        last = self.critic[-1]
        assert isinstance(last, torch.nn.Linear)
        mean, spread = returns.mean(), returns.std() + VALUE_SPREAD_MIN
        with torch.no_grad():
            ratio = self._value_spread / spread
            last.bias.copy_(last.bias * ratio + (self._value_mean - mean) / spread)
            last.weight.mul_(ratio)
            self._value_mean.copy_(mean)
            self._value_spread.copy_(spread)

    def _fit_critic(self, rollout: Rollout, batches: list[torch.Tensor]) -> float:
        loss = torch.zeros(())
        returns = (rollout.returns - self._value_mean) / self._value_spread
        for batch in batches:
            values = self.critic(rollout.observations[batch])[:, 0]
            loss = functional.mse_loss(values, returns[batch])
            self._descend(loss, self.critic, self.critic_optimizer)
        return float(loss.detach())

    def _surrogate(self, rollout: Rollout, batch: torch.Tensor, mean: torch.Tensor) -> torch.Tensor:
        log_prob = self._exploration.log_prob(rollout.actions[batch], mean, self.policy.log_std)
        advantages = rollout.advantages[batch]
        advantages = (advantages - advantages.mean()) / (advantages.std() + 1e-8)
        ratio = torch.exp(log_prob - rollout.log_prob[batch])
        clipped = ratio.clamp(1 - self._clip, 1 + self._clip)
        return torch.min(advantages * ratio, advantages * clipped).mean()

    def _change(self, rollout: Rollout, batch: torch.Tensor, mean: torch.Tensor) -> torch.Tensor:
        """Compute both smoothness terms, weighted, from a quarter of the shuffled batch, as a sample."""
        some = batch[: (len(batch) + 3) // 4]
        mean, loss = mean[: len(some)], torch.zeros(())
        if self._smoothness.spatial:
            observations = rollout.observations[some]
            disturbed = self.actor(observations + torch.randn_like(observations) * self._noise)
            loss = loss + self._smoothness.spatial * (disturbed - mean).square().sum(dim=1).mean()
        if self._smoothness.temporal:
            following = (some + 1).clamp(max=len(rollout.observations) - 1)
            change = (self.actor(rollout.observations[following]) - mean).square().sum(dim=1)
            loss = loss + self._smoothness.temporal * (change * rollout.followed[some]).mean()
        return loss

    def _descend(
        self, loss: torch.Tensor, network: torch.nn.Module, optimizer: torch.optim.Optimizer
    ) -> None:
        optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(network.parameters(), self.max_grad_norm)
        optimizer.step()

    def _values(self, observations: NDArray[np.float32]) -> NDArray[np.float32]:
        """Compute the critic's values (...) of observations (..., n)."""
        with torch.no_grad():
            values = self.critic(torch.from_numpy(observations))[..., 0]
            found: NDArray[np.float32] = (values * self._value_spread + self._value_mean).numpy()
        return found
