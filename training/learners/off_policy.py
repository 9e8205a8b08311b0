"""DDPG, TD3 and SAC as learners: Stable-Baselines3's implementations on the aircraft of one twin."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import DDPG, SAC, TD3
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.noise import VectorizedActionNoise
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.training.config.algorithms import DdpgConfig, OffPolicyConfig, SacConfig, Td3Config
from neuroflight.training.config.training_config import TrainingConfig
from neuroflight.training.learners.memory import check_memory
from neuroflight.training.learners.protocol import Report, named_layers
from neuroflight.training.learners.sb3 import Sb3Learner

REMEMBERED = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


class OffPolicyLearner(Sb3Learner):
    """A learner by an off-policy algorithm. The replay buffer is part of the state."""

    _model: OffPolicyAlgorithm

    def __init__(self, aircraft: Aircraft, config: TrainingConfig, off_policy: OffPolicyConfig) -> None:
        inputs, motors = len(config.observation_scale(aircraft.motor_count)), aircraft.motor_count
        check_memory(off_policy.buffer, config.steps, 2 * inputs + motors + 3)  # REMEMBERED has so many
        super().__init__(aircraft, config, off_policy.discount)
        common: dict[str, Any] = {
            "learning_rate": self._annealed(off_policy.learning_rate),
            "buffer_size": off_policy.buffer,
            "learning_starts": off_policy.learning_starts,
            "batch_size": off_policy.minibatch,
            "tau": off_policy.tau,
            "gamma": off_policy.discount,
            "train_freq": (1, "step"),
            "gradient_steps": off_policy.gradient_steps,
            # Fused: one call a step instead of ten for each tensor.
            "policy_kwargs": self._networks(optimizer_kwargs={"fused": True}),
            "seed": config.seed,
            "device": "cpu",
        }
        match off_policy:
            case DdpgConfig():
                self._model = DDPG("MlpPolicy", self._env, action_noise=self._noise(off_policy), **common)
            case Td3Config():
                self._model = TD3(
                    "MlpPolicy",
                    self._env,
                    action_noise=self._noise(off_policy),
                    policy_delay=off_policy.policy_delay,
                    target_policy_noise=off_policy.target_noise,
                    target_noise_clip=off_policy.target_noise_clip,
                    **common,
                )
            case SacConfig():
                target = off_policy.target_entropy * aircraft.motor_count
                self._model = SAC("MlpPolicy", self._env, target_entropy=target, **common)

    def learn(self, segment: int, report: Callable[[Report], None]) -> None:
        """See Learner."""
        if isinstance(noise := self._model.action_noise, _FadingNoise):
            noise.restart()
        super().learn(segment, report)

    def policy(self) -> dict[str, torch.Tensor]:
        """See Learner."""
        # SAC's actor has two last layers, the mean's and the deviation's; the first is called mu.
        return named_layers(
            [
                layer.state_dict()
                for name, layer in self._model.actor.named_modules()
                if isinstance(layer, torch.nn.Linear) and name != "log_std"
            ]
        )

    def state(self) -> dict[str, Any]:
        """See Learner."""
        memory = self._memory
        filled = memory.buffer_size if memory.full else memory.pos
        return {
            **super().state(),
            "temperature": self._temperature(),
            "memory": {name: torch.tensor(getattr(memory, name)[:filled]) for name in REMEMBERED},
            "memory_next": memory.pos,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """See Learner."""
        super().restore(state)
        temperature = self._temperature()
        if temperature is not None:
            temperature.data.copy_(state["temperature"])
        memory = self._memory
        for name, kept in state["memory"].items():
            getattr(memory, name)[: len(kept)] = kept.numpy()
        memory.pos = state["memory_next"]
        memory.full = len(state["memory"]["rewards"]) == memory.buffer_size

    @property
    def _memory(self) -> ReplayBuffer:
        memory = self._model.replay_buffer
        assert memory is not None
        return memory

    def _temperature(self) -> torch.Tensor | None:
        """Return the logarithm of the weight of the entropy; SAC only."""
        model = self._model
        return model.log_ent_coef if isinstance(model, SAC) else None

    def _optimizers(self) -> list[torch.optim.Optimizer]:
        model = self._model
        assert isinstance(model, TD3 | SAC)  # DDPG is a TD3 here
        optimizers = [model.actor.optimizer, model.critic.optimizer]
        if isinstance(model, SAC) and model.ent_coef_optimizer is not None:
            optimizers.append(model.ent_coef_optimizer)
        return optimizers

    def _noise(self, off_policy: DdpgConfig | Td3Config) -> _FadingNoise:
        shape = self._env.action_space.shape
        assert shape is not None
        return _FadingNoise(self, off_policy.noise, off_policy.hold, (self._env.num_envs, *shape))


class _FadingNoise(VectorizedActionNoise):
    """Normal noise for all aircraft; its deviation goes from the first value to the last in a run."""

    def __init__(
        self, learner: Sb3Learner, deviation: tuple[float, float], hold: int, shape: tuple[int, ...]
    ) -> None:
        self._learner, self._deviation, self._hold = learner, deviation, hold
        self._drawn = np.zeros(shape, np.float32)
        self._step = 0  # since the segment began

    def restart(self) -> None:
        """Start a new segment: the next call draws anew."""
        self._step = 0

    def reset(self, indices: Iterable[int] | None = None) -> None:
        """Do nothing: a draw is held across the end of an episode."""

    def __call__(self) -> NDArray[np.float32]:
        """Return noise of all aircraft (N, M), from numpy's global generator as Stable-Baselines3's."""
        if self._step % self._hold == 0:
            first, last = self._deviation
            deviation = first + (last - first) * self._learner.part
            self._drawn = np.random.normal(0.0, deviation, self._drawn.shape).astype(np.float32)
        self._step += 1
        return self._drawn
