"""PPO1 learns, and the running moments of its returns are those of the samples."""

import itertools
from contextlib import closing

import numpy as np
import pytest

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.training.config.algorithms import Ppo1Config
from neuroflight.training.config.training_config import TrainingConfig
from neuroflight.training.learners.ppo1.learner import Ppo1Learner
from neuroflight.training.learners.ppo1.normalization import ReturnMoments
from neuroflight.training.learners.ppo1.rollout import advantages
from neuroflight.training.learners.protocol import Report
from neuroflight.training.tasks.reward import TrackingReward
from neuroflight.training.tasks.task import EpisodicTask

NF1 = load_aircraft("nf1")


def test_outputs_fall_within_ten_thousand_steps_when_they_cost() -> None:
    """The first outputs' mean is 0.5, of the normal distribution around it."""
    ppo1 = Ppo1Config(aircraft=16, horizon=64, learning_rate=3e-3, leg=10)
    config = TrainingConfig(
        steps=10_240,
        hidden=(16,),
        task=EpisodicTask(hold_s=0.3),
        reward=TrackingReward(error=0.0, output=1.0),
        algorithm=ppo1,
    )
    reports: list[Report] = []
    with closing(Ppo1Learner(NF1, config, ppo1)) as learner:
        learner.learn(0, reports.append)
        outputs = 0.5 + 0.5 * learner.outputs(np.zeros((1, 6), np.float32))
        updates = learner.state()["updates"]
    assert learner.steps == reports[-1].steps == 10_240
    # Adam's corrections count on: 10 rollouts, the epochs of each, and the minibatches of its 1024 samples.
    assert updates == 10 * ppo1.epochs * 1024 // ppo1.minibatch
    assert reports[0].reward == pytest.approx(-0.5, abs=0.05)
    assert reports[-1].reward > -0.45
    assert np.clip(outputs, 0.0, 1.0).mean() < 0.45
    rates = [report.figures["train/learning_rate"] for report in reports]
    assert all(later < rate for rate, later in itertools.pairwise(rates))
    assert rates[-1] == pytest.approx(0.1 * ppo1.learning_rate)  # of the last of ten updates


def test_returns_moments_are_the_first_rollouts_then_follow_later_ones() -> None:
    rng = np.random.default_rng(3)
    first, later = rng.normal(-1e9, 1e8, 1000), rng.normal(5.0, 2.0, 1000)
    moments = ReturnMoments().with_more(first)
    assert moments.mean == pytest.approx(first.mean())
    assert moments.spread == pytest.approx(first.std(), rel=1e-4)
    for _ in range(1500):
        moments = moments.with_more(later)
    assert moments.mean == pytest.approx(later.mean(), rel=1e-3)
    assert moments.spread == pytest.approx(later.std(), rel=1e-2)


def test_advantages_are_sums_of_surprises_up_to_an_episodes_end() -> None:
    """By hand: surprise = reward + discount following - value, and later ones count 0.5 * 0.8 each."""
    rewards, values, following = np.array([[1.0], [2.0], [3.0]]), np.zeros((3, 1)), np.zeros((3, 1))
    following[1] = 10.0
    ended = np.array([[False], [True], [False]])
    found = advantages(rewards, values, following, ended, 0.5, 0.8)
    np.testing.assert_allclose(found[:, 0], [1.0 + 0.4 * 7.0, 7.0, 3.0])
