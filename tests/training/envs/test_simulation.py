"""All tasks and rewards in the twin, and the values that a reward gets."""

import copy
import pickle
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.training.config.training_config import TrainingConfig, WorldConfig
from neuroflight.training.envs.simulation import AttitudeSimulation
from neuroflight.training.tasks.recorded import RecordedTask
from neuroflight.training.tasks.registry import TASKS
from neuroflight.training.tasks.reward import REWARDS, Rewards, TrackingReward, Transition
from neuroflight.training.tasks.task import EpisodicTask, PulseTask

NF1 = load_aircraft("nf1")


@pytest.fixture
def recording(tmp_path: Path) -> str:
    path = tmp_path / "flight.csv"
    path.write_text("t_s,roll_deg_s,pitch_deg_s,yaw_deg_s\n0,10,-20,30\n6,0,0,0\n")
    return str(path)


def simulation(config: TrainingConfig, seed: int = 1) -> AttitudeSimulation:
    return AttitudeSimulation(NF1, 3, config=config, rng=np.random.default_rng(seed))


@pytest.mark.parametrize("reward", REWARDS)
@pytest.mark.parametrize("task", TASKS)
def test_every_task_flies_for_every_reward(task: str, reward: str, recording: str) -> None:
    asked_for = RecordedTask(recording) if task == "recorded" else TASKS[task]()
    config = TrainingConfig(task=asked_for, reward=REWARDS[reward]())
    twins = simulation(config)
    twins.reset()
    seen = [twins.step(np.full((3, 4), 0.2, np.float32)) for _ in range(5)]
    twins.close()
    assert twins.steps == round(1000 * asked_for.duration_s)
    assert all(np.isfinite(result.reward).all() for result in seen)
    assert not any(result.ended.any() for result in seen)


class Remembering:
    """A reward that keeps its transitions."""

    name: ClassVar[str] = "remembering"

    def __init__(self) -> None:
        self.seen: list[Transition] = []

    def __call__(self, step: Transition) -> Rewards:
        self.seen.append(step)
        return np.zeros(len(step.error), np.float32)


@pytest.fixture
def flown() -> Iterator[tuple[AttitudeSimulation, list[Transition]]]:
    """Rest for 2 steps, a command from the third; outputs 2, -1, 0.5 and 0.25."""
    reward = Remembering()
    task = PulseTask(idle_s=0.002, command_s=1.0, rest_s=0.0)
    twins = simulation(TrainingConfig(task=task, reward=reward, world=WorldConfig(noise=False)))
    twins.reset()
    for _ in range(40):
        twins.step(np.tile(np.array([2.0, -1.0, 0.5, 0.25], np.float32), (3, 1)))
    yield twins, reward.seen
    twins.close()


def test_a_transition_holds_the_values_before_and_after_the_step(
    flown: tuple[AttitudeSimulation, list[Transition]],
) -> None:
    twins, seen = flown
    assert not seen[0].setpoint_before.any()
    assert not seen[0].setpoint.any()
    assert not seen[0].action_before.any()
    assert not seen[1].setpoint_before.any()
    assert seen[1].setpoint.all()  # the command is there at the sample after the second step
    for before, after in pairwise(seen):
        assert np.array_equal(before.setpoint, after.setpoint_before)
        assert np.array_equal(before.error, after.error_before)
        assert np.array_equal(before.action, after.action_before)
    assert seen[-1].unclipped[0].tolist() == [2.0, -1.0, 0.5, 0.25]
    assert seen[-1].action[0].tolist() == [1.0, 0.0, 0.5, 0.25]
    assert np.array_equal(seen[-1].error, twins.setpoint - twins.rate)
    assert np.abs(twins.rate).max() > 0.5  # it does fly


def test_a_configuration_survives_a_copy_and_another_process(recording: str) -> None:
    config = TrainingConfig(task=RecordedTask(recording), reward=TrackingReward(change=0.1))
    for other in (copy.deepcopy(config), pickle.loads(pickle.dumps(config))):
        assert other == config
        one, two = (c.task.episodes(2, np.random.default_rng(1), 1000) for c in (config, other))
        assert np.array_equal(one, two)


def test_throttle_is_drawn_for_its_share_of_the_episodes() -> None:
    world = WorldConfig(throttle_max=0.8, throttle_share=0.25)
    config = TrainingConfig(observation="throttle", task=EpisodicTask(), world=world)
    twins = AttitudeSimulation(NF1, 500, config=config, rng=np.random.default_rng(1))
    thrust = twins.reset()[:, 0]
    twins.close()
    assert (thrust > 0.0).mean() == pytest.approx(0.25, abs=0.06)
    assert thrust.max() <= 0.8
    assert thrust[thrust > 0.0].mean() == pytest.approx(0.4, abs=0.06)
    none = simulation(replace(config, world=WorldConfig()))
    assert not none.reset().any()
    none.close()
