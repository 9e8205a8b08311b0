"""PPO as a learner: `smooth_ppo` on the aircraft of one twin."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.training.config.algorithms import PpoConfig
from neuroflight.training.config.training_config import TrainingConfig
from neuroflight.training.learners.exploration import EXPLORATIONS
from neuroflight.training.learners.sb3 import Sb3Learner
from neuroflight.training.learners.smooth_ppo import Smoothness, SmoothPpo


class PpoLearner(Sb3Learner):
    """The learner PPO."""

    _model: SmoothPpo

    def __init__(self, aircraft: Aircraft, config: TrainingConfig, ppo: PpoConfig) -> None:
        super().__init__(aircraft, config, ppo.discount)
        first, last = ppo.log_std
        self._model = SmoothPpo(
            "MlpPolicy",
            self._env,
            learning_rate=self._annealed(ppo.learning_rate),
            n_steps=ppo.horizon,
            batch_size=ppo.minibatch,
            n_epochs=ppo.epochs,
            gamma=ppo.discount,
            gae_lambda=ppo.gae_lambda,
            clip=ppo.clip,
            hold=ppo.hold,
            exploration=EXPLORATIONS[ppo.distribution](),
            log_std=lambda: first + (last - first) * self.part,
            policy_kwargs=self._networks(log_std_init=first),
            seed=config.seed,
            device="cpu",
            smoothness=Smoothness(
                ppo.smoothness_spatial, ppo.smoothness_temporal, observation_noise(aircraft, config)
            ),
        )

    def _optimizers(self) -> list[torch.optim.Optimizer]:
        return [self._model.actor_optimizer, self._model.critic_optimizer]


def observation_noise(aircraft: Aircraft, config: TrainingConfig) -> NDArray[np.float32]:
    """Compute the standard deviation of each scaled observation under the gyro's noise alone, (n,)."""
    gyro = np.array(aircraft.gyro.noise)
    noise = []
    for term in config.blocks():
        # White noise after y += a (x - y), and the difference of two of its samples after the same filter.
        a = term.gain(config.control_rate_hz) or 1.0
        passed = {
            "rate": np.sqrt(a / (2.0 - a)),
            "rate_error": np.sqrt(a / (2.0 - a)),
            "rate_error_delta": a * np.sqrt(2.0 / (2.0 - a)),
        }
        none = np.zeros(term.count(aircraft.motor_count))
        noise.append(gyro * passed[term.name] if term.name in passed else none)
    scale = np.array(config.observation_scale(aircraft.motor_count))
    scaled: NDArray[np.float64] = np.concatenate(noise) * scale
    return scaled.astype(np.float32)
