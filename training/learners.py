"""Which learner an algorithm's knobs stand for."""

from __future__ import annotations

from sim.aircraft import Aircraft
from toolchain.errors import TrainingError
from training.algorithm import PpoConfig
from training.configuration import TrainingConfig
from training.learner import Learner


def learner(aircraft: Aircraft, config: TrainingConfig) -> Learner:
    """A fresh learner; `close()` when done."""
    match config.algorithm:
        case PpoConfig() as ppo:
            from training.ppo import PpoLearner

            return PpoLearner(aircraft, config, ppo)
    raise TrainingError(f"algorithm {config.algorithm.name!r} has no learner")
