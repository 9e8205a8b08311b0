"""DDPG1 learns, its perturbations fit their distance, and its buffer holds what happened."""

from contextlib import closing
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest
from numpy.typing import NDArray

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.training.config.algorithms import Ddpg1Config
from neuroflight.training.config.training_config import OutputMap, TrainingConfig
from neuroflight.training.learners.ddpg1.learner import Ddpg1Learner
from neuroflight.training.learners.ddpg1.replay import Replay
from neuroflight.training.learners.protocol import Report
from neuroflight.training.tasks.reward import TrackingReward, Transition
from neuroflight.training.tasks.task import EpisodicTask, PulseTask

NF1 = load_aircraft("nf1")
PLAIN = Ddpg1Config(updates=1, buffer=2000, leg=4)
CONFIG = TrainingConfig(
    steps=10**6,
    hidden=(16, 8),
    activation="relu",
    output=OutputMap(scale=0.5, offset=0.5, squash=True),
    algorithm=PLAIN,
)


@dataclass(frozen=True)
class MotorReward:
    """What the first motor does: a row's reward tells the action that it should stand beside."""

    name: ClassVar[str] = "first-motor"

    def __call__(self, step: Transition) -> NDArray[np.float32]:
        """0 to 1."""
        return step.action[:, 0].astype(np.float32)  # a copy


def learner_of(ddpg1: Ddpg1Config, config: TrainingConfig = CONFIG) -> Ddpg1Learner:
    return Ddpg1Learner(NF1, replace(config, algorithm=ddpg1), ddpg1)


def test_outputs_fall_within_ten_thousand_steps_when_they_cost() -> None:
    """At first they are 0.5, of perturbed actors around it."""
    ddpg1 = Ddpg1Config(updates=25, buffer=10_000, actor_learning_rate=3e-4, leg=100)
    reward = TrackingReward(error=0.0, output=1.0)
    config = replace(CONFIG, steps=10_000, task=EpisodicTask(hold_s=0.3), reward=reward)
    reports: list[Report] = []
    with closing(learner_of(ddpg1, config)) as learner:
        learner.learn(0, reports.append)
        outputs = 0.5 + 0.5 * learner.outputs(np.zeros((1, 6), np.float32))
        updates = learner.state()["updates"]
    assert learner.steps == reports[-1].steps == 10_000
    assert updates == 25 * 10_000 // (ddpg1.aircraft * ddpg1.horizon)  # Adam's corrections count on
    assert outputs.mean() < 0.3
    assert reports[-1].reward > reports[0].reward + 0.1


def test_perturbed_outputs_differ_by_the_noise_when_it_was_adapted() -> None:
    """Whatever the deviation was at first: learning does not disturb, its rates are next to nothing."""
    still = replace(PLAIN, learning_rate=1e-12, actor_learning_rate=1e-12, leg=300)
    for first in (1.0, 0.02):
        with closing(learner_of(still)) as learner:
            # Another actor: one whose outputs are within 0.003 of 0 hardly differ.
            actor, _ = learner._networks.parts(learner._learnt.parameters)
            actor[-2][:] = np.random.default_rng(2).normal(0.0, 0.3, actor[-2].shape)
            learner._deviation = first
            learner.learn(0, lambda report: None)
            rng = np.random.default_rng(3)
            found = [learner._adapt(rng) for _ in range(200)]
        assert np.median(found) == pytest.approx(still.noise, rel=0.15), first


def test_the_buffer_holds_actions_rewards_and_last_observations_when_episodes_end() -> None:
    """Every observation that follows is the next one of the same aircraft, but where its episode ended."""
    short = PulseTask(idle_s=0.004, command_s=0.01, rest_s=0.006)
    config = replace(CONFIG, task=short, reward=MotorReward())
    with closing(learner_of(replace(PLAIN, leg=10), config)) as learner:
        learner.learn(0, lambda report: None)
    assert learner._replay.filled == 1000
    rows = learner._replay.rows[:1000].reshape(50, 20, -1)  # control steps, aircraft
    seen, actions, rewards, following = np.split(rows, [6, 10, 11], axis=2)
    fractions = np.clip(0.5 + 0.5 * actions[..., 0], 0.0, 1.0)
    np.testing.assert_allclose(rewards[..., 0], fractions, atol=1e-6)
    assert fractions.std() > 0.01
    other = (following[:-1] != seen[1:]).any(axis=2)
    assert set(other.sum(axis=0).tolist()) == {2, 3}  # episodes of 20 control steps, spread over their time
    last, first = following[:-1][other], seen[1:][other]
    assert (first[:, 3:] == 0.0).all()  # no change of the error at an episode's begin
    assert (np.abs(last[:, 3:]).max(axis=1) > 0.0).all()


def test_the_oldest_rows_make_way_when_the_buffer_is_full() -> None:
    replay = Replay(5, 1, 1)
    for number in range(4):
        value = np.full((2, 1), number, np.float32)
        replay.add(value, value + 10, value[:, 0] + 20, value + 30)
    assert replay.filled == 5
    assert sorted(replay.rows[:, 0].tolist()) == [1.0, 2.0, 2.0, 3.0, 3.0]
    assert (replay.rows - replay.rows[:, :1] == [0.0, 10.0, 20.0, 30.0]).all()
    drawn = replay.draw(np.random.default_rng(1), 20, 10)
    assert np.unique(drawn).tolist() == [0, 1, 2, 3, 4]


def test_only_filled_rows_are_drawn() -> None:
    replay = Replay(1000, 1, 1)
    replay.add(*(np.ones(shape, np.float32) for shape in ((3, 1), (3, 1), (3,), (3, 1))))
    assert np.unique(replay.draw(np.random.default_rng(1), 200)).tolist() == [0, 1, 2]


def test_an_aircraft_flies_one_perturbation_until_its_episode_ends() -> None:
    short = PulseTask(idle_s=0.004, command_s=0.01, rest_s=0.006)
    with closing(learner_of(PLAIN, replace(CONFIG, task=short))) as learner:
        rng = np.random.default_rng(4)
        learner._perturbations = rng.standard_normal((learner._networks.counts[0], 20), np.float32)
        observation, changed = learner._env.reset(), []
        for _ in range(5):  # rollouts of 5 control steps; an episode has 20
            before = learner._perturbations.copy()
            observation, _ = learner._fly(observation, rng)
            changed.append((learner._perturbations != before).mean(axis=0))
    shares = np.array(changed)
    assert set(np.unique(shares.round(2))) == {0.0, 1.0}  # all of a perturbation or nothing
    counts = shares.round().sum(axis=0)
    assert set(counts.tolist()) <= {1.0, 2.0}
