"""PPO with smoothness of the mean output in the policy's loss.

After CAPS (Mysore et al. 2021), spatial term: an observation and the same one under fresh gyro noise
should give the same output. The noise is the gyro's own, so what is punished is exactly what makes motors
hot: outputs that follow noise. Punishing sampled actions instead teaches PPO to hide behind the clip.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.utils import explained_variance
from torch.nn import functional


class SmoothPpo(PPO):
    """Stable-Baselines3's PPO, its `train` with one term more.

    The clip range is constant, and exploration follows a schedule, so there is no entropy term.
    """

    def __init__(
        self,
        *args: Any,  # noqa: ANN401 - PPO's own
        observation_noise: NDArray[np.float32],
        smoothness: float,
        clip: float,
        log_std: Callable[[], float],
        **kwargs: Any,  # noqa: ANN401 - PPO's own
    ) -> None:
        """observation_noise: (n,), standard deviation of each scaled observation under gyro noise.

        log_std: of the exploration, asked for before each update. Left to itself PPO keeps so much of it
        that the mean output drifts: nothing in the reward can tell.
        """
        super().__init__(*args, **kwargs)
        self._log_std = log_std
        self.policy.log_std.requires_grad_(False)
        self._noise = torch.as_tensor(observation_noise)
        self._smoothness = smoothness
        self._clip = clip

    def train(self) -> None:
        """Update the policy from the rollout buffer."""
        self.policy.set_training_mode(True)
        self._update_learning_rate(self.policy.optimizer)
        self.policy.log_std.fill_(self._log_std())
        for _ in range(self.n_epochs):
            for data in self.rollout_buffer.get(self.batch_size):
                loss = self._loss(data)
                self.policy.optimizer.zero_grad()
                loss.backward()  # type: ignore[no-untyped-call]
                torch.nn.utils.clip_grad_norm_(self.policy.parameters(), self.max_grad_norm)
                self.policy.optimizer.step()
            self._n_updates += 1
        buffer = self.rollout_buffer
        self.logger.record(
            "train/explained_variance", explained_variance(buffer.values.flatten(), buffer.returns.flatten())
        )
        self.logger.record("train/std", float(self.policy.log_std.detach().exp().mean()))

    def _loss(self, data: Any) -> torch.Tensor:  # noqa: ANN401 - a named tuple of the rollout buffer
        clip = self._clip
        values, log_prob, _ = self.policy.evaluate_actions(data.observations, data.actions)
        advantages = (data.advantages - data.advantages.mean()) / (data.advantages.std() + 1e-8)
        ratio = torch.exp(log_prob - data.old_log_prob)
        surrogate = torch.min(advantages * ratio, advantages * ratio.clamp(1 - clip, 1 + clip)).mean()
        value_loss = functional.mse_loss(data.returns, values.flatten())
        disturbed = data.observations + torch.randn_like(data.observations) * self._noise
        change = self._mean(disturbed) - self._mean(data.observations)
        loss: torch.Tensor = (
            -surrogate + self.vf_coef * value_loss + self._smoothness * change.square().sum(dim=1).mean()
        )
        return loss

    def _mean(self, observation: torch.Tensor) -> torch.Tensor:
        output: torch.Tensor = self.policy.action_net(self.policy.mlp_extractor.forward_actor(observation))
        return output
