"""TRPO as a learner: sb3-contrib's implementation on the aircraft of one twin."""

from __future__ import annotations

import torch
from sb3_contrib import TRPO

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.training.config.algorithms import TrpoConfig
from neuroflight.training.config.training_config import TrainingConfig
from neuroflight.training.learners.sb3 import Sb3Learner


class TrpoLearner(Sb3Learner):
    """The learner TRPO."""

    _model: TRPO

    def __init__(self, aircraft: Aircraft, config: TrainingConfig, trpo: TrpoConfig) -> None:
        super().__init__(aircraft, config, trpo.discount)
        self._model = TRPO(
            "MlpPolicy",
            self._env,
            learning_rate=self._annealed(trpo.learning_rate),
            n_steps=trpo.horizon,
            batch_size=trpo.minibatch,
            gamma=trpo.discount,
            gae_lambda=trpo.gae_lambda,
            cg_max_steps=trpo.cg_max_steps,
            cg_damping=trpo.cg_damping,
            n_critic_updates=trpo.critic_updates,
            target_kl=trpo.target_kl,
            policy_kwargs=self._networks(log_std_init=trpo.log_std),
            seed=config.seed,
            device="cpu",
        )

    def _optimizers(self) -> list[torch.optim.Optimizer]:
        return [self._model.policy.optimizer]
