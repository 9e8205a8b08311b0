"""The commands of each task, and the errors of invalid ones."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from neuroflight.toolchain.errors import TrainingError
from neuroflight.training.tasks.task import (
    ContinuousTask,
    EnvelopeTask,
    EpisodicTask,
    PulseTask,
    Setpoints,
    normal_commands,
)

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


@pytest.mark.parametrize(("task", "seconds"), [(EpisodicTask(), 1.0), (EnvelopeTask(), 1.5)])
def test_command_is_held_from_the_first_step_when_the_task_is(task: EpisodicTask, seconds: float) -> None:
    assert task.duration_s == seconds
    seen = task.episodes(2, np.random.default_rng(1), 500)
    assert seen.shape == (2, 500 * seconds, 3)
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


def test_any_task_takes_another_distribution() -> None:
    pulses = PulseTask(distribution="uniform", limit_deg_s=50.0, idle_s=0.0, command_s=0.001, rest_s=0.0)
    drawn = np.rad2deg(pulses.episodes(50_000, np.random.default_rng(1), 1000))
    assert np.abs(drawn).max() == pytest.approx(50.0, abs=0.01)
    assert drawn.std() == pytest.approx(50.0 / np.sqrt(3), rel=0.01)
    held = EpisodicTask(distribution="normal", sigma_deg_s=40.0, limit_deg_s=60.0, hold_s=0.001)
    drawn = np.rad2deg(held.episodes(50_000, np.random.default_rng(1), 1000))
    assert np.abs(drawn).max() == pytest.approx(60.0)
    assert (np.abs(drawn) < 40.0).mean() == pytest.approx(0.6827, abs=0.005)


def runs(setpoints: Setpoints) -> tuple[np.ndarray, np.ndarray]:
    """Lengths [steps] and values (n, 3) of the parts of one episode during which nothing changes."""
    edges = np.flatnonzero((np.diff(setpoints, axis=0) != 0).any(axis=1)) + 1
    begins = np.concatenate([[0], edges])
    return np.diff(np.concatenate([begins, [len(setpoints)]])), setpoints[begins]


def test_commands_and_rests_take_turns_when_the_task_is_continuous() -> None:
    task = ContinuousTask(length_s=600.0, command_s=(0.2, 0.4), rest_s=(0.1, 0.15))
    [episode] = task.episodes(1, np.random.default_rng(1), 1000)
    assert episode.shape == (600_000, 3)
    lengths, values = runs(episode)
    rests, commands = lengths[0:-1:2], lengths[1:-1:2]  # the last one is cut off
    assert not values[::2].any()
    assert values[1::2].all()
    assert len(commands) == pytest.approx(600 / 0.425, rel=0.03)
    for drawn, least, greatest in ((rests, 100, 150), (commands, 200, 400)):
        assert least <= drawn.min() < least + 2
        assert greatest - 2 < drawn.max() <= greatest
        assert drawn.mean() == pytest.approx((least + greatest) / 2, rel=0.02)
    spread = np.rad2deg(values[1::2])
    assert np.abs(spread).max() <= 360.001
    assert spread.std() == pytest.approx(360 / np.sqrt(3), rel=0.03)


def test_episodes_differ_and_a_seed_repeats_them_when_the_task_is_continuous() -> None:
    first, second, other = (ContinuousTask().episodes(2, np.random.default_rng(s), 1000) for s in (1, 1, 2))
    assert first.shape == (2, 10_000, 3)
    assert np.array_equal(first, second)
    assert not np.array_equal(first[0], first[1])
    assert not np.array_equal(first, other)


def test_an_episode_is_filled_to_its_end_when_holds_are_as_short_as_they_may_be() -> None:
    [episode] = ContinuousTask(length_s=2.0, command_s=(0.01, 0.01), rest_s=(0.01, 0.01)).episodes(
        1, np.random.default_rng(1), 1000
    )
    lengths, values = runs(episode)
    assert lengths.tolist() == [10] * 200
    assert values[1::2].all()


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: PulseTask(command_s=math.nan), "task pulse: command_s nan, expected 0 to 600"),
        (
            lambda: ContinuousTask(rest_s=(2.0, 1.0)),
            r"task continuous: rest_s \[2.0, 1.0\], expected \[least, greatest\]",
        ),
    ],
)
def test_a_task_that_cannot_be_flown_is_rejected(build: Callable[[], object], message: str) -> None:
    with pytest.raises(TrainingError, match=message):
        build()
