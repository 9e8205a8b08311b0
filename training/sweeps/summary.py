"""Results of a sweep: its runs, configurations averaged over seeds, and their Pareto front."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from neuroflight.toolchain.contract import POLICY_WEIGHT_COUNT_MAX
from neuroflight.training.sweeps.axes import Varied
from neuroflight.training.sweeps.config import Board, Sweep, Trial
from neuroflight.training.sweeps.trial import FIGURES, Figure, Outcome


@dataclass(frozen=True)
class Run:
    """A trial and its result."""

    trial: Trial
    outcome: Outcome | None = None  # None: not done
    reason: str | None = None  # why it failed

    @property
    def state(self) -> str:
        """One of: done, failed, open."""
        return "done" if self.outcome else "failed" if self.reason else "open"


@dataclass(frozen=True)
class Configuration:
    """Finished runs that differ only in their seed."""

    varied: Varied  # without the seed
    runs: tuple[Run, ...]
    mae: Figure  # over the seeds; of a single run, over the commands
    mse: Figure
    output: Figure
    change: Figure
    instructions: int | None
    predicted_cycles: float | None
    training_seconds: float  # mean
    front: bool = False  # no other is at least as good in error, change and cycles and better in one

    @property
    def number(self) -> int:
        """The number of its first run."""
        return self.runs[0].trial.number


def unfit(outcome: Outcome, board: Board | None) -> str | None:
    """Return why the board cannot fly a policy; None if it can, as far as is known."""
    if outcome.weights > POLICY_WEIGHT_COUNT_MAX:
        return f"{outcome.weights:,} weights of {POLICY_WEIGHT_COUNT_MAX:,}"
    if board is None or outcome.predicted_cycles is None:
        return None
    cycles = outcome.predicted_cycles + board.other_cycles
    if cycles <= board.control_task_cycles:
        return None
    return f"{cycles:,.0f} cycles of {board.control_task_cycles:,}"


def configurations(runs: Sequence[Run]) -> tuple[Configuration, ...]:
    """Return the finished runs by configuration, in their order."""
    groups: list[list[Run]] = []
    for run in runs:
        if run.outcome is None:
            continue
        same = (group for group in groups if group[0].trial.configuration == run.trial.configuration)
        group = next(same, None)
        if group is None:
            groups.append([run])
        else:
            group.append(run)
    found = [_configuration(group) for group in groups]
    points = [(c.mae.mean, c.change.mean, c.predicted_cycles or 0.0) for c in found]
    front = pareto(np.array(points)) if points else ()
    return tuple(
        Configuration(**{**vars(c), "front": bool(best)}) for c, best in zip(found, front, strict=True)
    )


def pareto(points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return True for points (P, objectives) that no other point dominates, less being better, (P,)."""
    no_worse = (points[:, None] <= points[None, :]).all(axis=2)
    better = (points[:, None] < points[None, :]).any(axis=2)
    return np.logical_not(np.asarray((no_worse & better).any(axis=0)))


def document(sweep: Sweep, runs: Sequence[Run], command: str) -> dict[str, Any]:
    """Return the content of sweep.json."""
    return {
        "command": command,
        "sweep": sweep.name,
        "aircraft": {"name": sweep.aircraft.name, "sha256": sweep.aircraft.sha256},
        "validation": asdict(sweep.validation),
        "baseline": sweep.baseline,
        "board": asdict(sweep.board) if sweep.board else None,
        "complete": all(run.outcome for run in runs),
        "runs": [
            {
                "number": run.trial.number,
                "folder": run.trial.folder,
                "varied": run.trial.varied,
                "state": run.state,
                "reason": run.reason,
                "steps": run.trial.config.steps,
                "outcome": asdict(run.outcome) if run.outcome else None,
                "unfit": unfit(run.outcome, sweep.board) if run.outcome else None,
            }
            for run in runs
        ],
        "configurations": [
            {
                "varied": found.varied,
                "runs": [run.trial.number for run in found.runs],
                **{name: asdict(getattr(found, name)) for name in FIGURES},
                "instructions": found.instructions,
                "predicted_cycles": found.predicted_cycles,
                "training_seconds": found.training_seconds,
                "front": found.front,
            }
            for found in configurations(runs)
        ],
    }


def _configuration(runs: Sequence[Run]) -> Configuration:
    outcomes = [run.outcome for run in runs if run.outcome]
    first = outcomes[0]
    mae, mse, output, change = (
        _over_seeds([getattr(outcome, name) for outcome in outcomes]) for name in FIGURES
    )
    return Configuration(
        varied=runs[0].trial.configuration,
        runs=tuple(runs),
        mae=mae,
        mse=mse,
        output=output,
        change=change,
        instructions=first.instructions,
        predicted_cycles=first.predicted_cycles,
        training_seconds=sum(outcome.training_seconds for outcome in outcomes) / len(outcomes),
    )


def _over_seeds(figures: Sequence[Figure]) -> Figure:
    if len(figures) == 1:
        return figures[0]
    return Figure.of([figure.mean for figure in figures])
