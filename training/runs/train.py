"""A training run: learns in the twin; writes checkpoint.pt, policy.onnx, training.json and rewards.csv."""

from __future__ import annotations

import json
import platform
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from importlib.metadata import distributions
from pathlib import Path
from typing import Any

import torch

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.toolchain.errors import TrainingError
from neuroflight.toolchain.files import read_limited, write_text
from neuroflight.toolchain.policy.freeze import freeze
from neuroflight.training.checkpoints.metrics import CheckpointMetrics
from neuroflight.training.checkpoints.monitor import SEED, episodes, flown
from neuroflight.training.checkpoints.monitor_process import Monitor
from neuroflight.training.checkpoints.selection import rule
from neuroflight.training.config.training_config import TrainingConfig
from neuroflight.training.learners.pathwise.learner import PathwiseLearner
from neuroflight.training.learners.protocol import Report
from neuroflight.training.runs.checkpoint import (
    Learned,
    MonitorState,
    Policy,
    Run,
    load_run,
    save_checkpoint,
    snapshot,
)
from neuroflight.training.runs.make_learner import make_learner
from neuroflight.training.runs.rewards import Rewards

CHECKPOINT, POLICY, RECORD, MONITOR = "checkpoint.pt", "policy.onnx", "training.json", "monitor.json"
REWARDS = "rewards.csv"
RESULTS = (CHECKPOINT, POLICY, RECORD, MONITOR, REWARDS)
RECORD_BYTES_MAX = 4 << 20
CHECKPOINTS_MIN = 4  # of a run whose policy must be fit to fly: an earlier one may replace an unfit one
TOOLS = ("torch", "stable_baselines3", "sb3_contrib", "pybullet", "pybullet-arm64", "gymnasium", "numpy")


@dataclass(frozen=True)
class Progress:
    """Progress of a run, passed to callbacks after every update and returned at the end."""

    steps: int
    steps_wanted: int
    seconds: float  # including those before the run was resumed
    reward: float  # mean per control step since the last report
    figures: dict[str, float] = field(default_factory=dict)  # by TensorBoard's names
    note: str = ""  # a line for the user, of this update
    chosen: CheckpointMetrics | None = None  # metrics of the policy that would be chosen now


@dataclass(frozen=True, eq=False)
class Start:
    """Results of another run, that a run begins with."""

    learned: Learned
    folder: Path
    name: str  # of its folder or shipped policy, as the user gave it
    sha256: str  # of its checkpoint
    aircraft: str  # that it was trained on
    aircraft_sha256: str

    def document(self) -> dict[str, str]:
        """Return its name and digests as JSON data."""
        return {
            "name": self.name,
            "checkpoint_sha256": self.sha256,
            "aircraft": self.aircraft,
            "aircraft_sha256": self.aircraft_sha256,
        }


class Callback:
    """Called while a run goes on; a subclass overrides what it needs."""

    def progressed(self, progress: Progress) -> None:
        """Take the progress after an update."""

    def checkpointed(self, progress: Progress, policy: Policy) -> None:
        """Take a written checkpoint; `policy`: the latest weights, by the names that freeze knows."""

    def monitored(self, metrics: CheckpointMetrics) -> None:
        """Take the metrics after the monitor has flown the policy of a checkpoint."""


class Callbacks(Callback):
    """Several callbacks, called in turn."""

    def __init__(self, callbacks: Sequence[Callback]) -> None:
        self._callbacks = callbacks

    def progressed(self, progress: Progress) -> None:
        for callback in self._callbacks:
            callback.progressed(progress)

    def checkpointed(self, progress: Progress, policy: Policy) -> None:
        for callback in self._callbacks:
            callback.checkpointed(progress, policy)

    def monitored(self, metrics: CheckpointMetrics) -> None:
        for callback in self._callbacks:
            callback.monitored(metrics)


def train(
    aircraft: Aircraft,
    config: TrainingConfig,
    out: Path,
    callback: Callback | None = None,
    *,
    resume: bool = False,
    monitor: Monitor | None = None,
    command: str | None = None,
    start: Start | None = None,
) -> Progress:
    """Train and write `out`/checkpoint.pt, policy.onnx, training.json and rewards.csv.

    A run is a sequence of segments. Each begins with new episodes and a random stream of its own, and needs
    only what is saved at the end of the one before: a resumed run gives the bytes of one that never stopped.
    An interruption (KeyboardInterrupt) saves the state of the last whole segment and is raised again; any
    other exception leaves the files of the last checkpoint.

    monitor: flies every checkpoint, and policy.onnx is the one that `training.checkpoints.selection` chooses;
    without it, the latest. `out`/monitor.json holds its metrics. command: repeats the run, for the record.
    start: what another run learned, that a pathwise run begins with instead of random weights.
    Raises TrainingError if there is nothing to resume, the configuration differs, or it names another start.
    """
    if config.start != (None if start is None else start.sha256):
        raise TrainingError(
            f"the configuration begins with checkpoint {config.start and config.start[:12]}, got "
            f"{start and start.sha256[:12]}; name the run that it was by --from"
        )
    # A second thread makes networks this small little faster, and twenty times slower on a busy machine.
    torch.set_num_threads(1)
    callback = callback or Callback()
    document = config.document(aircraft)
    run, monitor_state = load_run(out / CHECKPOINT, document) if resume else (None, MonitorState())
    told = None if start is None else start.document()
    results = _Results(out, config, document, command, monitor is not None, told)
    model = make_learner(aircraft, config)
    if start is not None:
        if not isinstance(model, PathwiseLearner):
            model.close()
            raise TrainingError(f"algorithm {config.algorithm.name}: only pathwise starts from another run")
        model.start_from(start.learned.policy, start.learned.learner)
    _tidy(out)
    began, before, segment, marked = time.monotonic(), 0.0, 0, 0
    if run is not None:
        model.restore(run.learner)
        segment, before = run.segment, _seconds(out)
        marked = monitor_state.steps if monitor else run.steps
    rewards = run.rewards if run is not None else Rewards()
    state = Progress(model.steps, config.steps, before, 0.0, chosen=monitor_state.best)

    def listen(*, wait: bool = False) -> None:
        nonlocal monitor_state
        for metrics in monitor.collect(wait=wait) if monitor else ():
            monitor_state = monitor_state.collected(metrics, config.selection)
            results.write_monitor(monitor_state)
            callback.monitored(metrics)

    def report(update: Report) -> None:
        nonlocal state, rewards
        listen()
        rewards = rewards.reported(update.steps, update.reward, config.steps)
        passed = before + time.monotonic() - began
        state = Progress(
            update.steps,
            config.steps,
            passed,
            update.reward,
            update.figures,
            update.note,
            monitor_state.best,
        )
        callback.progressed(state)

    try:
        if monitor is not None:
            for steps, policy in monitor_state.pending:
                monitor.submit(steps, policy)
        while True:
            if run is not None and _due(run.steps, marked, config):
                marked = run.steps
                if monitor is not None:
                    monitor_state = monitor_state.submitted(run.steps, run.policy)
                    monitor.submit(run.steps, run.policy)
                results.write(run, monitor_state, state.seconds)
                callback.checkpointed(state, run.policy)
            if model.steps >= config.steps:
                break
            model.learn(segment, report)
            segment += 1
            run = Run(segment, model.steps, snapshot(model.policy()), snapshot(model.state()), rewards)
        assert run is not None
        listen(wait=True)
        results.write(run, monitor_state, state.seconds)
    except KeyboardInterrupt:
        if run is not None:
            results.write(run, monitor_state, state.seconds)
        raise
    finally:
        model.close()
    return replace(state, steps=run.steps, chosen=monitor_state.best)


def go_back(aircraft: Aircraft, config: TrainingConfig, out: Path, steps: int) -> None:
    """Make a kept checkpoint of the finished run in `out` the chosen one: all files but rewards.csv.

    Raises TrainingError if there is no such run, KeyError if the checkpoint was not kept.
    """
    document = config.document(aircraft)
    run, monitor_state = load_run(out / CHECKPOINT, document)
    record = read_record(out)
    results = _Results(out, config, document, record["command"], monitored=True, start=record.get("from"))
    results.write(run, monitor_state.going_back(steps), _seconds(out))


def _tidy(out: Path) -> None:
    """Remove the temporary files of a run that was killed while writing."""
    for name in RESULTS:
        for aside in out.glob(f".{name}.*"):
            aside.unlink()


def _due(steps: int, marked: int, config: TrainingConfig) -> bool:
    """Return True if the end of a segment at `steps` is a checkpoint, after one at `marked`."""
    every = config.checkpoint_steps
    if config.selection.fit:
        every = min(every, -(-config.steps // CHECKPOINTS_MIN))
    passed = steps // every > marked // every
    return passed or marked < config.steps <= steps


@dataclass(frozen=True)
class _Results:
    """The files of a run, each replaced as a whole."""

    out: Path
    config: TrainingConfig
    document: dict[str, Any]
    command: str | None
    monitored: bool
    start: dict[str, str] | None = None  # `Start.document`

    def write(self, run: Run, monitor_state: MonitorState, seconds: float) -> None:
        """Write all files; the checkpoint first, because `--resume` can make the others from it."""
        save_checkpoint(self.out / CHECKPOINT, self.document, run, monitor_state)
        freeze(self.out / CHECKPOINT, self.out / POLICY)
        self.write_monitor(monitor_state)
        write_text(self.out / RECORD, _text(self._record(run, monitor_state, seconds)))
        run.rewards.write(self.out / REWARDS)

    def write_monitor(self, monitor_state: MonitorState) -> None:
        """Write monitor.json, if there is a monitor."""
        if self.monitored:
            write_text(self.out / MONITOR, _text(self._monitor(monitor_state)))

    def _monitor(self, monitor_state: MonitorState) -> dict[str, Any]:
        """Return the content of monitor.json."""
        limits = self.config.selection
        return {
            "aircraft": self.document["aircraft"],
            "seed": self.config.seed,
            "steps_wanted": self.config.steps,
            "task": flown(self.config).task.name,
            "episodes": episodes(self.config),
            "episodes_seed": SEED,
            "limits": {"output": limits.output, "change": limits.change},
            "rule": rule(limits),
            "chosen_steps": monitor_state.best and monitor_state.best.steps,
            "readings": [metrics.document() for metrics in monitor_state.history],
        }

    def _record(self, run: Run, monitor_state: MonitorState, seconds: float) -> dict[str, Any]:
        """Return the content of training.json: configuration, results and versions of the tools."""
        best, seconds = monitor_state.best, round(seconds, 1)
        return {
            "config": self.document,
            "steps": run.steps,
            "complete": run.steps >= self.config.steps and not monitor_state.pending,
            "seconds": seconds,
            "steps_per_second": round(run.steps / seconds) if seconds else None,
            "command": self.command,
            **({} if self.start is None else {"from": self.start}),
            "python": platform.python_version(),
            "tools": {tool: found.version for tool in TOOLS for found in distributions(name=tool)},
            "chosen": best and {"rule": rule(self.config.selection), **best.document()},
            "monitor": [metrics.document() for metrics in monitor_state.history],
            "setbacks": run.learner.get("setbacks", []),
        }


def _text(document: dict[str, Any]) -> str:
    return json.dumps(document, indent=2) + "\n"


def _seconds(out: Path) -> float:
    """Read the seconds that a run has taken so far from its training.json; 0 if it cannot be read."""
    try:
        return float(read_record(out)["seconds"])
    except (TrainingError, ValueError, KeyError, TypeError):
        return 0.0


def read_record(folder: Path) -> dict[str, Any]:
    """Read the training.json of a run. Raises TrainingError if there is none."""
    path = folder / RECORD
    data = read_limited(path, str(path), RECORD_BYTES_MAX, TrainingError)
    try:
        return dict(json.loads(data))
    except (ValueError, TypeError, RecursionError) as error:
        raise TrainingError(f"{path} cannot be read; --resume writes it anew") from error
