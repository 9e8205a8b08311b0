"""The training reward of a run over its steps, thinned, as it is kept in the checkpoint and in rewards.csv.

A run reports its reward after every update. The run's steps are divided into POINTS_MAX equal parts, and all
reports that end in one part are averaged, weighted with their control steps. A point needs only its own steps
and those of the point before, so that a resumed run continues the points of its checkpoint without a gap.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from neuroflight.toolchain.errors import TrainingError
from neuroflight.toolchain.files import read_limited, write_text

POINTS_MAX = 400
FILE_BYTES_MAX = 1 << 20
HEADING = "steps,reward"

Point = tuple[int, float]  # control steps of the run at its end; mean reward of a control step


@dataclass(frozen=True)
class Rewards:
    """Points by rising steps; each is the mean since the point before."""

    points: tuple[Point, ...] = ()

    def reported(self, steps: int, reward: float, steps_wanted: int) -> Rewards:
        """Add one more report: the mean `reward` of the control steps since the last report, up to `steps`.

        steps_wanted: of the whole run. A reward that is no finite number is left out.
        """
        last = self.points[-1][0] if self.points else 0
        if not math.isfinite(reward) or steps <= last:
            return self
        if not self.points or _part(steps, steps_wanted) > _part(last, steps_wanted):
            return Rewards((*self.points, (steps, float(reward))))
        before = self.points[-2][0] if len(self.points) > 1 else 0
        old, new = last - before, steps - last
        mean = (self.points[-1][1] * old + float(reward) * new) / (old + new)
        return Rewards((*self.points[:-1], (steps, mean)))

    def write(self, path: Path) -> None:
        """Replace the file as a whole."""
        lines = [HEADING, *(f"{steps},{reward!r}" for steps, reward in self.points)]
        write_text(path, "\n".join(lines) + "\n")


def read_rewards(path: Path) -> Rewards:
    """Read a run's rewards.csv. Raises TrainingError if it is none."""
    if not path.exists():
        raise TrainingError(
            f"{path} does not exist: the run has written no checkpoint yet, or an older version trained it; "
            f"train it anew"
        )
    data = read_limited(path, str(path), FILE_BYTES_MAX, TrainingError)
    wrong = TrainingError(f"{path} is no record of rewards; --resume writes it anew")
    try:
        heading, *lines = data.decode().splitlines() or [""]
        points = tuple((int(steps), float(reward)) for steps, reward in (line.split(",") for line in lines))
    except ValueError as error:
        raise wrong from error
    steps = [0, *(step for step, _ in points)]
    rising = all(before < after for before, after in pairwise(steps))
    if heading != HEADING or not rising or not all(math.isfinite(reward) for _, reward in points):
        raise wrong
    return Rewards(points)


def _part(steps: int, steps_wanted: int) -> int:
    """Return the part of the run, from 0 on, that contains `steps`."""
    return (steps - 1) * POINTS_MAX // steps_wanted
