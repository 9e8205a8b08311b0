"""Synthesis: PPO in the twin, from a configuration to checkpoint.pt, policy.onnx and training.json."""

from __future__ import annotations

import json
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.callbacks import BaseCallback

from sim.aircraft import Aircraft
from toolchain.files import write_text
from toolchain.freeze import freeze
from training.checkpoint import save_checkpoint
from training.configuration import TrainingConfig
from training.simulation import AttitudeSimulation
from training.smooth_ppo import SmoothPpo
from training.vector import AttitudeVecEnv

MODULES = {"tanh": torch.nn.Tanh, "relu": torch.nn.ReLU}
CHECKPOINT_EVERY_S = 20.0  # wall time between checkpoints


@dataclass(frozen=True)
class Progress:
    """Where a run stands; given to the caller after every rollout and at the end."""

    steps: int
    steps_wanted: int
    seconds: float
    reward: float  # mean of a control step in the last rollout


def train(
    aircraft: Aircraft,
    config: TrainingConfig,
    out: Path,
    progress: Callable[[Progress], None] | None = None,
) -> Progress:
    """Train and write `out`/checkpoint.pt, policy.onnx and training.json.

    A checkpoint is kept every 20 s. An interruption (KeyboardInterrupt) writes all three for the steps
    done, then goes on its way.
    """
    # Networks this small gain little from a second thread and lose twenty times as much to a busy neighbour.
    torch.set_num_threads(1)
    env = vector_env(aircraft, config)
    model = learner(aircraft, config, env)
    document = config.document(aircraft)
    run = _Run(config.steps, progress, lambda: _save(out, model, document))
    try:
        model.learn(config.steps, callback=run)
    finally:
        if run.state.steps:
            _save(out, model, document)
            freeze(out / "checkpoint.pt", out / "policy.onnx")
            write_text(out / "training.json", _record(document, run.state))
        env.close()
    return run.state


def vector_env(aircraft: Aircraft, config: TrainingConfig) -> AttitudeVecEnv:
    """The aircraft to learn on; `close()` when done."""
    simulation = AttitudeSimulation(
        aircraft,
        config.ppo.aircraft,
        blocks=config.blocks(),
        control_rate_hz=config.control_rate_hz,
        task=config.task,
        reward=config.reward,
        throttle_max=config.throttle_max,
        rng=np.random.default_rng(config.seed),
    )
    return AttitudeVecEnv(simulation, config)


def learner(aircraft: Aircraft, config: TrainingConfig, env: AttitudeVecEnv) -> SmoothPpo:
    """A fresh PPO on `env`."""
    ppo = config.ppo
    return SmoothPpo(
        "MlpPolicy",
        env,
        learning_rate=lambda left: ppo.learning_rate * (0.1 + 0.9 * left),
        n_steps=ppo.horizon,
        batch_size=ppo.minibatch,
        n_epochs=ppo.epochs,
        gamma=ppo.discount,
        gae_lambda=ppo.gae_lambda,
        clip=ppo.clip,
        log_std=ppo.log_std,
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


def observation_noise(aircraft: Aircraft, config: TrainingConfig) -> NDArray[np.float32]:
    """Standard deviation of each scaled observation under the gyro's noise alone, (n,)."""
    gyro = np.array(aircraft.gyro.noise)
    raw = {"rate": gyro, "rate_error": gyro, "rate_error_delta": np.sqrt(2.0) * gyro}
    noise = [raw.get(b.name, np.zeros(b.count(aircraft.motor_count))) for b in config.blocks()]
    scale = np.array(config.observation_scale(aircraft.motor_count))
    scaled: NDArray[np.float64] = np.concatenate(noise) * scale
    return scaled.astype(np.float32)


class _Run(BaseCallback):
    """Reports after each rollout and keeps a checkpoint now and then."""

    def __init__(
        self, wanted: int, report: Callable[[Progress], None] | None, save: Callable[[], None]
    ) -> None:
        super().__init__()
        self.state = Progress(0, wanted, 0.0, 0.0)
        self._report = report
        self._save = save
        self._began = self._saved = time.monotonic()

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        now = time.monotonic()
        model = self.model
        assert isinstance(model, SmoothPpo)
        self.state = Progress(
            steps=self.num_timesteps,
            steps_wanted=self.state.steps_wanted,
            seconds=now - self._began,
            reward=float(model.rollout_buffer.rewards.mean()),
        )
        if self._report is not None:
            self._report(self.state)
        if now - self._saved > CHECKPOINT_EVERY_S:
            self._save()
            self._saved = now


def _save(out: Path, model: SmoothPpo, document: dict[str, Any]) -> None:
    save_checkpoint(
        out / "checkpoint.pt",
        document,
        model.policy.state_dict(),
        model.policy.optimizer.state_dict(),
        {"steps": model.num_timesteps},
    )


def _record(document: dict[str, Any], state: Progress) -> str:
    """training.json: what was asked for, what was done, with which tools."""
    tools = ("torch", "stable_baselines3", "pybullet", "gymnasium", "numpy")
    record = {
        "config": document,
        "steps": state.steps,
        "complete": state.steps >= state.steps_wanted,
        "seconds": round(state.seconds, 1),
        "steps_per_second": round(state.steps / state.seconds),
        "command": (
            f"neuroflight train --aircraft {document['aircraft']['name']} "
            f"--steps {state.steps_wanted} --seed {document['seed']}"
        ),
        "python": platform.python_version(),
        "tools": {tool: version(tool) for tool in tools},
    }
    return json.dumps(record, indent=2) + "\n"
