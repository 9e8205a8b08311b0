"""One run of a sweep: train, fly the validation's commands, count instructions and cycles on the board.

A worker does this. All its files are in the run's folder; an interrupted run resumes from its checkpoint.
"""

from __future__ import annotations

import hashlib
import json
import tempfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sim.aircraft.model import Aircraft
from sim.control.controller import PolicyController
from toolchain.codegen.compiler import compile_policy
from toolchain.cortex_m7.timing import mixed_observations, time_policy
from toolchain.errors import BuildError, TrainingError
from toolchain.files import file_size, write_text
from toolchain.policy.model import read_policy
from training.checkpoints.monitor_process import Monitor
from training.evaluation.evaluation import Scores, mean_over, record, scores
from training.runs.train import CHECKPOINT, POLICY, Callback, read_record, train
from training.sweeps.config import Trial, Validation
from training.tasks.registry import TASKS

RESULT = "result.json"
RESULT_BYTES_MAX = 1 << 20
TIMED_OBSERVATIONS = 30  # generated code has no branches that depend on them; every third one is extreme


@dataclass(frozen=True)
class Figure:
    """A mean and the half width of its 95 % confidence interval."""

    mean: float
    margin: float

    @staticmethod
    def of(values: ArrayLike) -> Figure:
        """The mean of (N,) values."""
        mean = mean_over(np.asarray(values, np.float64))
        return Figure(float(mean.value), float(mean.high - mean.value))


@dataclass(frozen=True)
class Outcome:
    """The result of a run; errors are against the true rate, means over axes and commands."""

    mae: Figure  # [deg/s]
    mse: Figure  # [(deg/s)²]
    output: Figure  # ū, fraction
    change: Figure  # |Δu| in 1 ms, fraction
    instructions: int | None  # of policy_step on the board, at most
    predicted_cycles: float | None  # likewise
    no_cycles_reason: str | None  # why one of the two is unknown
    training_seconds: float
    steps: int  # control steps trained
    policy_sha256: str


def run_trial(
    trial: Trial, aircraft: Aircraft, validation: Validation, folder: Path, callback: Callback
) -> Outcome:
    """Do the run in `folder`, or the rest of it, and write its result.json."""
    document = trial.config.document(aircraft)
    if not _trained(folder, document):
        kept = (folder / CHECKPOINT).exists()
        train(aircraft, trial.config, folder, callback, resume=kept, monitor=Monitor(aircraft, trial.config))
    policy = folder / POLICY
    trained = read_record(folder)
    flown = _flown(policy, trial, aircraft, validation)
    instructions, cycles, reason = _counted(policy)
    outcome = Outcome(
        mae=Figure.of(flown.tracking.mae.mean(axis=1)),
        mse=Figure.of(flown.tracking.mse.mean(axis=1)),
        output=Figure.of(flown.output),
        change=Figure.of(flown.change),
        instructions=instructions,
        predicted_cycles=cycles,
        no_cycles_reason=reason,
        training_seconds=float(trained["seconds"]),
        steps=int(trained["steps"]),
        policy_sha256=hashlib.sha256(policy.read_bytes()).hexdigest(),
    )
    result = {
        "varied": trial.varied,
        "validation": asdict(validation),
        "config": document,
        "outcome": asdict(outcome),
    }
    write_text(folder / RESULT, json.dumps(result, indent=2) + "\n")
    return outcome


def read_outcome(folder: Path, trial: Trial, aircraft: Aircraft, validation: Validation) -> Outcome | None:
    """The outcome of a finished run, None if it is not finished.

    Raises TrainingError if the result is damaged or of another run.
    """
    path = folder / RESULT
    if not path.is_file():
        return None
    try:
        if file_size(path) > RESULT_BYTES_MAX:
            raise ValueError(f"more than {RESULT_BYTES_MAX} bytes")
        document = json.loads(path.read_text())
        outcome = _outcome(document["outcome"])
        wanted = {"config": trial.config.document(aircraft), "validation": asdict(validation)}
        same = all(document[key] == json.loads(json.dumps(value)) for key, value in wanted.items())
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise TrainingError(f"{path} is damaged ({error!r}); remove its folder to train it again") from error
    if not same:
        raise TrainingError(
            f"{path} is of another run than the sweep now asks for; restore the sweep file and its recipe, "
            f"or start the sweep in another folder"
        )
    return outcome


def _outcome(values: Mapping[str, Any]) -> Outcome:
    figures = {name: Figure(**values[name]) for name in ("mae", "mse", "output", "change")}
    return Outcome(**{**values, **figures})


def _trained(folder: Path, document: dict[str, Any]) -> bool:
    """Whether the record says that this configuration is fully trained."""
    try:
        record = read_record(folder)
        return bool(record["complete"]) and record["config"] == json.loads(json.dumps(document))
    except (TrainingError, KeyError):
        return False


def _flown(path: Path, trial: Trial, aircraft: Aircraft, validation: Validation) -> Scores:
    """The scores of the policy on the validation's commands."""
    policy = read_policy(path)
    return scores(
        record(
            PolicyController(policy, validation.episodes, exact=False),
            aircraft,
            TASKS[validation.task](),
            episodes=validation.episodes,
            seed=validation.seed,
            control_rate_hz=policy.control_rate_hz,
            throttle=validation.throttle,
            idle=trial.config.idle,
        )
    )


def _counted(path: Path) -> tuple[int | None, float | None, str | None]:
    """Greatest instructions and predicted cycles of a step, and why one is unknown."""
    compiled = compile_policy(read_policy(path))
    observations = mixed_observations(TIMED_OBSERVATIONS, compiled.network.inputs)
    try:
        with tempfile.TemporaryDirectory(prefix="neuroflight-") as folder:
            cost = time_policy(compiled, Path(folder), observations).cost
    except BuildError as error:
        return None, None, str(error)
    return cost.instructions[1], cost.cycles[1] if cost.cycles else None, cost.no_cycles_reason
