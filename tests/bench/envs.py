"""Speed of the environments beside the batch that they are views of.

All are stepped with the same actions in turn, several times, and the best of each counts, so that other load
on the machine slows a turn, not the figure.
"""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass

import gymnasium
import numpy as np
from stable_baselines3.common.vec_env import DummyVecEnv

from neuroflight.training.envs.batch import AttitudeBatch
from neuroflight.training.envs.gym_vector import AttitudeVectorEnv
from neuroflight.training.envs.sb3_vector import AttitudeVecEnv
from neuroflight.training.envs.setup import make_setup
from tests.bench.subject import Subject

ID = "neuroflight/Attitude-v0"
COUNTS = (1, 8, 64, 256)
ROUNDS = 5


@dataclass(frozen=True)
class Speed:
    """Aircraft steps a second of an environment, and of the internal batch of as many aircraft."""

    name: str
    value: float
    batch: float


def env_speeds(seconds: float) -> list[Speed]:
    """Return the speeds. seconds: for each figure."""
    with ExitStack() as stack:
        subjects = [subject for count in COUNTS for subject in _subjects(count, stack)]
        for _ in range(ROUNDS):
            for subject in subjects:
                subject.time(seconds / ROUNDS)
    batch = {subject.aircraft: subject.best for subject in subjects if subject.name == "batch"}
    return [Speed(f"{s.name}, {s.aircraft} aircraft", s.best, batch[s.aircraft]) for s in subjects]


def _subjects(count: int, stack: ExitStack) -> list[Subject]:
    batch = AttitudeBatch(make_setup(count), count, np.random.default_rng(1))
    vector, stable = AttitudeVectorEnv(count), AttitudeVecEnv(count)
    sync = gymnasium.make_vec(ID, count, vectorization_mode="sync")
    dummy = DummyVecEnv([lambda: gymnasium.make(ID)] * count)
    actions = np.random.default_rng(2).uniform(-1.0, 1.0, (count, 4)).astype(np.float32)
    for env in (batch, vector, stable, sync, dummy):
        stack.callback(env.close)
        env.reset()  # type: ignore[attr-defined]
    return [
        Subject("batch", count, lambda: batch.step(actions)),
        Subject("Gymnasium's VectorEnv", count, lambda: vector.step(actions)),
        Subject("Stable-Baselines3's VecEnv", count, lambda: stable.step(actions)),
        Subject("SyncVectorEnv of single ones", count, lambda: sync.step(actions)),
        Subject("DummyVecEnv of single ones", count, lambda: dummy.step(actions)),
    ]
