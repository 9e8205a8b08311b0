"""Makes the learner of a configured algorithm."""

from __future__ import annotations

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.toolchain.errors import TrainingError
from neuroflight.training.config.algorithms import (
    Ddpg1Config,
    OffPolicyConfig,
    Ppo1Config,
    PpoConfig,
    TrpoConfig,
)
from neuroflight.training.config.pathwise_config import PathwiseConfig
from neuroflight.training.config.training_config import TrainingConfig
from neuroflight.training.learners.protocol import Learner


def make_learner(aircraft: Aircraft, config: TrainingConfig) -> Learner:
    """Make a fresh learner; `close()` when done."""
    match config.algorithm:
        case PpoConfig() as ppo:
            from neuroflight.training.learners.ppo import PpoLearner

            return PpoLearner(aircraft, config, ppo)
        case Ppo1Config() as ppo1:
            from neuroflight.training.learners.ppo1.learner import Ppo1Learner

            return Ppo1Learner(aircraft, config, ppo1)
        case TrpoConfig() as trpo:
            from neuroflight.training.learners.trpo import TrpoLearner

            return TrpoLearner(aircraft, config, trpo)
        case Ddpg1Config() as ddpg1:
            from neuroflight.training.learners.ddpg1.learner import Ddpg1Learner

            return Ddpg1Learner(aircraft, config, ddpg1)
        case OffPolicyConfig() as off_policy:
            from neuroflight.training.learners.off_policy import OffPolicyLearner

            return OffPolicyLearner(aircraft, config, off_policy)
        case PathwiseConfig() as pathwise:
            from neuroflight.training.learners.pathwise.learner import PathwiseLearner

            return PathwiseLearner(aircraft, config, pathwise)
    raise TrainingError(f"algorithm {config.algorithm.name!r} has no learner")
