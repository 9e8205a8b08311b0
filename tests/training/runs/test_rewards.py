"""The record of a run's training reward: thinned without losing anything, and read back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from neuroflight.toolchain.errors import TrainingError
from neuroflight.training.runs.rewards import POINTS_MAX, Rewards, read_rewards


def reported(reports: list[tuple[int, float]], wanted: int, rewards: Rewards | None = None) -> Rewards:
    rewards = rewards or Rewards()
    for steps, reward in reports:
        rewards = rewards.reported(steps, reward, wanted)
    return rewards


def many(count: int, wanted: int) -> list[tuple[int, float]]:
    """Reports at random steps."""
    rng = np.random.default_rng(5)
    steps = np.sort(rng.choice(np.arange(1, wanted), count - 1, replace=False)).tolist()
    return list(zip([*steps, wanted], rng.normal(-3.0, 1.0, count).tolist(), strict=True))


def test_the_sum_of_all_rewards_is_kept_when_there_are_more_reports_than_points() -> None:
    reports = many(3000, 100_000)
    points = np.array(reported(reports, 100_000).points)
    assert POINTS_MAX * 0.9 < len(points) <= POINTS_MAX
    assert points[-1, 0] == 100_000
    given = np.array(reports)
    sums = [(each[:, 1] * np.diff(each[:, 0], prepend=0.0)).sum() for each in (given, points)]
    assert sums[1] == pytest.approx(sums[0], rel=1e-12)


def test_every_report_is_a_point_when_there_are_few() -> None:
    reports = many(20, 4096)
    assert reported(reports, 4096).points == tuple(reports)


def test_a_reward_that_is_no_number_is_left_out() -> None:
    assert reported([(10, -1.0), (20, float("nan")), (30, -2.0)], 30).points == ((10, -1.0), (30, -2.0))


def test_the_file_goes_on_where_it_ended(tmp_path: Path) -> None:
    reports = many(2000, 100_000)
    reported(reports[:777], 100_000).write(tmp_path / "rewards.csv")
    resumed = reported(reports[777:], 100_000, read_rewards(tmp_path / "rewards.csv"))
    assert resumed == reported(reports, 100_000)


@pytest.mark.parametrize(
    "text", ["", "steps,reward\n1\n", "steps,reward\n5,-1\n5,-2\n", "steps,reward\n5,nan\n", "a,b\n1,2\n"]
)
def test_another_file_is_refused(text: str, tmp_path: Path) -> None:
    (tmp_path / "rewards.csv").write_text(text)
    with pytest.raises(TrainingError, match="no record of rewards; --resume writes it anew"):
        read_rewards(tmp_path / "rewards.csv")
