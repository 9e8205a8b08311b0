"""PPO as a learner: Stable-Baselines3's, over the aircraft of one twin."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.utils import set_random_seed

from sim.aircraft import Aircraft
from training.algorithm import PpoConfig
from training.configuration import TrainingConfig
from training.learner import Report
from training.smooth_ppo import SmoothPpo
from training.vector import AttitudeVecEnv

MODULES = {"tanh": torch.nn.Tanh, "relu": torch.nn.ReLU}


class PpoLearner:
    """See Learner."""

    def __init__(self, aircraft: Aircraft, config: TrainingConfig, ppo: PpoConfig) -> None:
        self._config, self._ppo = config, ppo
        self._part = 0.0  # of the run that is over
        self._env = AttitudeVecEnv(aircraft, config, ppo.aircraft)
        model = SmoothPpo(
            "MlpPolicy",
            self._env,
            learning_rate=lambda _: ppo.learning_rate * (1.0 - 0.9 * self._part),
            n_steps=ppo.horizon,
            batch_size=ppo.minibatch,
            n_epochs=ppo.epochs,
            gamma=ppo.discount,
            gae_lambda=ppo.gae_lambda,
            clip=ppo.clip,
            log_std=lambda: ppo.log_std[0] + (ppo.log_std[1] - ppo.log_std[0]) * self._part,
            policy_kwargs={
                "net_arch": list(config.hidden),
                "activation_fn": MODULES[config.activation],
                "log_std_init": ppo.log_std[0],
            },
            seed=config.seed,
            device="cpu",
            observation_noise=observation_noise(aircraft, config),
            smoothness=ppo.smoothness,
        )
        self._model = model

    @property
    def steps(self) -> int:
        """See Learner."""
        return int(self._model.num_timesteps)

    def learn(self, leg: int, report: Callable[[Report], None]) -> None:
        """See Learner."""
        seed = np.random.SeedSequence([self._config.seed, leg])
        self._env.restart(np.random.default_rng(seed))
        set_random_seed(int(seed.generate_state(1)[0]))
        model = self._model
        model._last_obs = None  # a new leg begins with new episodes
        steps = min(self._ppo.leg_steps, self._config.steps - self.steps)

        def reported(update: Report) -> None:
            self._part = min(1.0, update.steps / self._config.steps)
            report(update)

        model.learn(steps, callback=_Reporter(reported), reset_num_timesteps=False)

    def policy(self) -> dict[str, torch.Tensor]:
        """See Learner."""
        state = self._model.policy.state_dict()
        return {
            name: tensor
            for name, tensor in state.items()
            if name.startswith(("mlp_extractor.policy", "action"))
        }

    def state(self) -> dict[str, Any]:
        """See Learner."""
        policy = self._model.policy
        return {
            "steps": self.steps,
            "networks": policy.state_dict(),
            "optimizer": policy.optimizer.state_dict(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """See Learner."""
        self._model.num_timesteps = state["steps"]
        self._part = min(1.0, self.steps / self._config.steps)
        self._model.policy.load_state_dict(state["networks"])
        self._model.policy.optimizer.load_state_dict(state["optimizer"])

    def close(self) -> None:
        """See Learner."""
        self._env.close()


def observation_noise(aircraft: Aircraft, config: TrainingConfig) -> NDArray[np.float32]:
    """Standard deviation of each scaled observation under the gyro's noise alone, (n,)."""
    gyro = np.array(aircraft.gyro.noise)
    raw = {"rate": gyro, "rate_error": gyro, "rate_error_delta": np.sqrt(2.0) * gyro}
    noise = [raw.get(b.name, np.zeros(b.count(aircraft.motor_count))) for b in config.blocks()]
    scale = np.array(config.observation_scale(aircraft.motor_count))
    scaled: NDArray[np.float64] = np.concatenate(noise) * scale
    return scaled.astype(np.float32)


class _Reporter(BaseCallback):
    """Reports after each rollout."""

    def __init__(self, report: Callable[[Report], None]) -> None:
        super().__init__()
        self._report = report

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        model = self.model
        assert isinstance(model, SmoothPpo)
        figures = {name: float(value) for name, value in model.logger.name_to_value.items()}
        self._report(Report(self.num_timesteps, float(model.rollout_buffer.rewards.mean()), figures))
