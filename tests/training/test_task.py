"""What each task asks for."""

import numpy as np
import pytest

from training.task import EnvelopeTask, EpisodicTask, PulseTask, normal_commands
from training.tasks import TASKS

TASK = PulseTask()


def test_setpoint_is_held_between_rests() -> None:
    command = np.array([[1.0, -2.0, 0.5]])
    seen = TASK.of(command, 1000)[0]
    assert TASK.duration_s == 4.5
    assert not seen[:500].any()
    assert (seen[500:2500] == command).all()
    assert not seen[2500:].any()


def test_each_episode_has_commands_of_its_own() -> None:
    seen = TASK.episodes(3, np.random.default_rng(1), 1000)
    assert seen.shape == (3, 4500, 3)
    assert len(np.unique(seen[:, 600])) == 9


def test_commands_are_normal_and_within_full_stick() -> None:
    drawn = np.rad2deg(normal_commands(100.0, 100_000, np.random.default_rng(1)))
    assert drawn.std() == pytest.approx(100.0, rel=0.01)
    assert drawn.mean() == pytest.approx(0.0, abs=1.0)
    wide = np.rad2deg(normal_commands(5000.0, 1000, np.random.default_rng(1)))
    assert np.abs(wide).max() == pytest.approx(1000.0)


@pytest.mark.parametrize("name", ["episodic", "envelope"])
def test_command_is_held_from_the_first_step_when_the_task_is(name: str) -> None:
    task = TASKS[name]()
    assert task.duration_s == 1.0
    seen = task.episodes(2, np.random.default_rng(1), 500)
    assert seen.shape == (2, 500, 3)
    assert (seen == seen[:, :1]).all()
    assert seen[:, 0].all()


def test_commands_are_uniform_when_the_task_is_episodic() -> None:
    drawn = np.rad2deg(EpisodicTask(hold_s=0.001).episodes(50_000, np.random.default_rng(1), 1000))
    assert np.abs(drawn).max() <= 300.0001
    assert drawn.std() == pytest.approx(300.0 / np.sqrt(3), rel=0.01)
    assert np.histogram(drawn, bins=10)[0] / drawn.size == pytest.approx(np.full(10, 0.1), rel=0.03)


def test_commands_are_wide_and_normal_when_the_task_is_the_envelope() -> None:
    drawn = np.rad2deg(EnvelopeTask(hold_s=0.001).episodes(50_000, np.random.default_rng(1), 1000))
    assert np.abs(drawn).max() == pytest.approx(1000.0)
    assert (np.abs(drawn) < 300.0).mean() == pytest.approx(0.6827, abs=0.005)
