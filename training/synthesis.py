"""Synthesis: learning in the twin, from a configuration to checkpoint.pt, policy.onnx and training.json."""

from __future__ import annotations

import json
import platform
import time
from copy import deepcopy
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import torch

from sim.aircraft import Aircraft
from toolchain.files import write_text
from toolchain.freeze import freeze
from training.checkpoint import Run, load_run, save_checkpoint
from training.configuration import TrainingConfig
from training.learner import Report
from training.learners import learner

CHECKPOINT = "checkpoint.pt"


@dataclass(frozen=True)
class Progress:
    """Where a run stands; given to the caller after every update and at the end."""

    steps: int
    steps_wanted: int
    seconds: float  # of this run and those that it resumed
    reward: float  # mean of a control step since the last report
    figures: dict[str, float] = field(default_factory=dict)  # by TensorBoard's names


class Watcher:
    """Told what happens in a run; this one does not listen."""

    def progressed(self, progress: Progress) -> None:
        """After every update."""

    def checkpointed(self, progress: Progress, policy: dict[str, torch.Tensor]) -> None:
        """After a checkpoint was kept; `policy`: its weights, by the names that freeze knows."""


def train(
    aircraft: Aircraft,
    config: TrainingConfig,
    out: Path,
    watcher: Watcher | None = None,
    *,
    resume: bool = False,
) -> Progress:
    """Train and write `out`/checkpoint.pt, policy.onnx and training.json.

    A run is a row of legs. Each begins with new episodes and chance of its own, so that what is kept at a
    leg's end is all that the next builds on: a resumed run gives the bytes of one that never stopped. An
    interruption (KeyboardInterrupt) keeps the state of the last whole leg, then goes on its way.
    Raises TrainingError if there is nothing to resume, or the configuration is another.
    """
    # Networks this small gain little from a second thread and lose twenty times as much to a busy neighbour.
    torch.set_num_threads(1)
    watcher = watcher or Watcher()
    document = config.document(aircraft)
    path = out / CHECKPOINT
    run = load_run(path, document) if resume else None
    model = learner(aircraft, config)
    began, before, leg, kept = time.monotonic(), 0.0, 0, 0
    if run is not None:
        model.restore(run.learner)
        leg, kept, before = run.leg, run.steps, _seconds(out)
    state = Progress(model.steps, config.steps, before, 0.0)

    def report(update: Report) -> None:
        nonlocal state
        passed = before + time.monotonic() - began
        state = Progress(update.steps, config.steps, passed, update.reward, update.figures)
        watcher.progressed(state)

    try:
        while model.steps < config.steps:
            model.learn(leg, report)
            leg += 1
            run = Run(leg, model.steps, deepcopy(model.policy()), deepcopy(model.state()))
            if run.steps // config.checkpoint_steps > kept // config.checkpoint_steps:
                save_checkpoint(path, document, run)
                kept = run.steps
                watcher.checkpointed(state, run.policy)
    finally:
        model.close()
        if run is not None:
            state = replace(state, steps=run.steps)
            save_checkpoint(path, document, run)
            freeze(path, out / "policy.onnx")
            write_text(out / "training.json", _record(document, state))
    return state


def _seconds(out: Path) -> float:
    """How long a run has taken so far, by its training.json; 0 where that cannot be told."""
    try:
        return float(json.loads((out / "training.json").read_text())["seconds"])
    except (OSError, ValueError, KeyError, TypeError):
        return 0.0


def _record(document: dict[str, Any], state: Progress) -> str:
    """training.json: what was asked for, what was done, with which tools."""
    tools = ("torch", "stable_baselines3", "pybullet", "gymnasium", "numpy")
    record = {
        "config": document,
        "steps": state.steps,
        "complete": state.steps >= state.steps_wanted,
        "seconds": round(state.seconds, 1),
        "steps_per_second": round(state.steps / state.seconds),
        "command": (
            f"neuroflight train --aircraft {document['aircraft']['name']} "
            f"--steps {state.steps_wanted} --seed {document['seed']}"
        ),
        "python": platform.python_version(),
        "tools": {tool: version(tool) for tool in tools},
    }
    return json.dumps(record, indent=2) + "\n"
