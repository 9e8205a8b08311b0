"""The end of a training whose policy is to be flown: the best checkpoint that is fit becomes policy.onnx."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.toolchain.policy.check_stamp import write_stamp
from neuroflight.training.checkpoints.metrics import CheckpointMetrics
from neuroflight.training.checkpoints.selection import rank
from neuroflight.training.fitness.check import Verdict, check
from neuroflight.training.fitness.flying import Progress
from neuroflight.training.fitness.references import References
from neuroflight.training.runs.checkpoint import load_run
from neuroflight.training.runs.seeds import Planned
from neuroflight.training.runs.train import CHECKPOINT, POLICY, RECORD, go_back

Show = Callable[[str], Progress | None]  # by a checkpoint's name: how far its check is


@dataclass(frozen=True)
class Rejected:
    """A checkpoint that is not fit to fly."""

    name: str
    reasons: tuple[str, ...]


@dataclass(frozen=True)
class Ending:
    """The checkpoint that became policy.onnx, and those that would have come before it."""

    seed: int
    name: str  # of the checkpoint
    chosen: CheckpointMetrics  # its metrics
    verdict: Verdict
    rejected: tuple[Rejected, ...]

    def document(self) -> dict[str, Any]:
        """Return the result as JSON data."""
        return {
            "fit": self.verdict.fit,
            "checkpoint": self.name,
            "reasons": self.verdict.reasons,
            "rejected": [asdict(each) for each in self.rejected],
        }


@dataclass(frozen=True)
class _Candidate:
    run: Planned
    metrics: CheckpointMetrics
    chosen: bool  # by the rule, of its run

    @property
    def name(self) -> str:
        return f"seed {self.run.config.seed}, {self.metrics.steps:,} steps"

    @property
    def rank(self) -> tuple[bool, float]:
        return rank(self.metrics, self.run.config.selection)


def choose_fit(
    aircraft: Aircraft, runs: Sequence[Planned], references: References, show: Show = lambda name: None
) -> Ending:
    """Check the kept checkpoints of finished runs, best first, until one is fit.

    It becomes policy.onnx in the folder of its run, with its stamp beside it. Where none is fit that stays
    the best by the rule that chose it, with a stamp that says it is not.
    """
    candidates = sorted(_candidates(aircraft, runs), key=lambda each: each.rank)
    rejected: list[Rejected] = []
    verdicts: list[Verdict] = []
    with tempfile.TemporaryDirectory(prefix="neuroflight-") as name:
        for each in candidates:
            folder = Path(name)
            for file in (CHECKPOINT, RECORD):
                shutil.copy(each.run.out / file, folder / file)
            go_back(aircraft, each.run.config, folder, each.metrics.steps)
            verdicts.append(check(folder / POLICY, aircraft, references, show(each.name)))
            if verdicts[-1].fit:
                break
            rejected.append(Rejected(each.name, tuple(verdicts[-1].reasons)))
    found = len(verdicts) - 1 if verdicts[-1].fit else 0
    best, verdict = candidates[found], verdicts[found]
    if not best.chosen:
        go_back(aircraft, best.run.config, best.run.out, best.metrics.steps)
    write_stamp(best.run.out / POLICY, verdict.document())
    return Ending(best.run.config.seed, best.name, best.metrics, verdict, tuple(rejected))


def _candidates(aircraft: Aircraft, runs: Sequence[Planned]) -> Iterator[_Candidate]:
    """Yield the kept checkpoints of all runs."""
    for run in runs:
        _, state = load_run(run.out / CHECKPOINT, run.config.document(aircraft))
        kept = [*([state.chosen] if state.chosen else []), *state.others]
        for number, (metrics, _) in enumerate(kept):
            yield _Candidate(run, metrics, chosen=state.chosen is not None and number == 0)
