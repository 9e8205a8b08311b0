"""Learning curves: the training reward of runs that differ by their seed, averaged, with a trend.

A curve is a configuration: runs whose configurations are equal but for the seed.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from neuroflight.sim.analysis.confidence import Mean, mean_of
from neuroflight.sim.arrays import Array
from neuroflight.toolchain.errors import TrainingError
from neuroflight.training.runs.rewards import read_rewards
from neuroflight.training.runs.train import RECORD, REWARDS, read_record

POINTS = 200  # of a mean over seeds
POINTS_MIN = 5  # of each run: fewer show no course, and leave a parabola no freedom
LAST = 0.05  # part of the run whose mean is its reward at the end; also the window that smooths
REACHED = 0.95  # of the way from the lowest reward to that at the end
TREND_DEGREE = 2


@dataclass(frozen=True, eq=False)
class SeedRewards:
    """The training reward of one run."""

    seed: int
    steps: Array  # (N,), control steps, rising
    reward: Array  # (N,), mean of a control step since the point before
    config: dict[str, Any]  # without the seed
    episode_steps: int  # control steps of an episode

    @property
    def final(self) -> float:
        """Mean reward of a control step over the last part of the run."""
        return float(self._smooth()[-1])

    @property
    def reached_steps(self) -> float | None:
        """Steps until REACHED of the way from the lowest reward to the final one; None if it did not rise.

        From the lowest, because a first reward says little: in many tasks the first episodes begin at rest.
        """
        smooth = self._smooth()
        lowest = int(smooth.argmin())
        if lowest == len(smooth) - 1:
            return None
        rise = smooth[lowest:] - smooth[lowest]
        return float(self.steps[lowest + int((rise >= REACHED * rise[-1]).argmax())])

    def at(self, steps: Array) -> Array:
        """Return the reward at these steps, interpolated."""
        return np.asarray(np.interp(steps, self.steps, self.reward), np.float64)

    def _smooth(self) -> Array:
        """Average each point with those of the LAST part of the run before it, weighted with their steps."""
        width = np.diff(self.steps, prepend=0.0)
        summed = np.concatenate([[0.0], np.cumsum(self.reward * width)])
        ends = np.concatenate([[0.0], np.cumsum(width)])
        begin = np.searchsorted(ends, self.steps - LAST * self.steps[-1], side="right") - 1
        begin = np.clip(begin, 0, np.arange(len(self.steps)))
        return np.asarray((summed[1:] - summed[begin]) / (ends[1:] - ends[begin]), np.float64)


@dataclass(frozen=True, eq=False)
class Curve:
    """The runs of one configuration."""

    label: str
    runs: tuple[SeedRewards, ...]  # by seed

    @property
    def steps(self) -> Array:
        """The steps that all runs have done, in POINTS equal parts, (POINTS,)."""
        first, last = max(run.steps[0] for run in self.runs), min(run.steps[-1] for run in self.runs)
        return np.linspace(min(first, last), last, POINTS)

    @property
    def reward(self) -> Mean:
        """Mean over seeds with its 95 % confidence at `steps`, (POINTS,) each."""
        values = np.array([run.at(self.steps) for run in self.runs])
        return mean_of(values)

    @property
    def trend(self) -> Array:
        """The parabola of least squares through the mean at `steps`, (POINTS,)."""
        part = self.steps / self.steps[-1]
        return np.asarray(np.polyval(np.polyfit(part, self.reward.value, TREND_DEGREE), part), np.float64)

    @property
    def final(self) -> Mean:
        """Reward of a control step over the last part of the runs, over seeds."""
        return mean_of(np.array([run.final for run in self.runs]))

    @property
    def reached_steps(self) -> Mean | None:
        """Steps until REACHED of the way to that reward, over the seeds whose reward rose; None: none did."""
        found = [steps for run in self.runs if (steps := run.reached_steps) is not None]
        return mean_of(np.array(found)) if found else None

    @property
    def best(self) -> SeedRewards:
        """The run with the highest reward at its end."""
        return max(self.runs, key=lambda run: run.final)

    @property
    def episode_steps(self) -> int:
        """Control steps of an episode."""
        return self.runs[0].episode_steps


def run_folders(folder: Path) -> list[Path]:
    """List the runs in a folder of `neuroflight policy train`: those of its seeds, or itself."""
    seeds = sorted(path.parent for path in folder.glob(f"seed-*/{RECORD}"))
    return seeds or [folder]


def read_run(folder: Path) -> SeedRewards:
    """Read the rewards of one run. Raises TrainingError if it has none, or too few to draw."""
    from neuroflight.training.config.config_file import load_config

    record = read_record(folder)
    rewards = read_rewards(folder / REWARDS)
    if len(rewards.points) < POINTS_MIN:
        raise TrainingError(
            f"{folder / REWARDS} has {len(rewards.points)} points, expected at least {POINTS_MIN}: "
            f"train for more steps"
        )
    config = load_config(str(folder / RECORD), [])
    try:
        document = {key: value for key, value in dict(record["config"]).items() if key != "seed"}
    except (KeyError, TypeError, ValueError) as error:
        raise TrainingError(f"{folder / RECORD} has no configuration; --resume writes it anew") from error
    steps, reward = np.array(rewards.points, np.float64).T
    episode = round(config.task.duration_s * config.control_rate_hz)
    return SeedRewards(config.seed, steps, reward, document, episode)


def curves(folders: Sequence[Path], labels: Sequence[str]) -> list[Curve]:
    """Make a curve for each different label, in their order; labels: one for each folder.

    Folders with the same label are runs of one configuration. Raises TrainingError if they are not, or have
    a seed twice.
    """
    grouped: dict[str, list[SeedRewards]] = {}
    for folder, label in zip(folders, labels, strict=True):
        grouped.setdefault(label, []).extend(read_run(run) for run in run_folders(folder))
    for label, runs in grouped.items():
        seeds = sorted(run.seed for run in runs)
        if len(set(seeds)) < len(seeds):
            raise TrainingError(
                f"{label}: seeds {seeds}, expected different ones; label other runs otherwise"
            )
        for run in runs[1:]:
            both = [{key: json.dumps(value) for key, value in each.config.items()} for each in (runs[0], run)]
            keys = sorted({key for key, _ in both[0].items() ^ both[1].items()})
            if keys:
                raise TrainingError(
                    f"{label}: the runs of seeds {runs[0].seed} and {run.seed} differ in "
                    f"{', '.join(keys)}, expected the same configuration; label them differently"
                )
    return [Curve(label, tuple(sorted(runs, key=lambda run: run.seed))) for label, runs in grouped.items()]
