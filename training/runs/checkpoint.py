"""Checkpoint files: plain containers and tensors, enough to freeze the policy and to resume the run.

The layout is shared with `toolchain.policy.freeze` (contract CHECKPOINT_*), which takes the policy in
"state_dict": the chosen one, while "learner" is the run's latest state. Loading executes no code. A file
holds no time and no path: equal runs give equal bytes.
"""

from __future__ import annotations

import io
import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import torch

from neuroflight.toolchain.contract import CHECKPOINT_FILE_BYTES_MAX, CHECKPOINT_FORMAT, CHECKPOINT_VERSION
from neuroflight.toolchain.errors import PolicyError, TrainingError
from neuroflight.toolchain.files import write_bytes
from neuroflight.toolchain.policy.plain_checkpoint import load_plain
from neuroflight.training.checkpoints.metrics import CheckpointMetrics
from neuroflight.training.checkpoints.selection import better, rank
from neuroflight.training.config.selection import SelectionLimits
from neuroflight.training.plugins import check_recorded
from neuroflight.training.runs.rewards import Rewards

KEPT_MAX = 7  # policies of other checkpoints than the chosen one, where that may prove unfit to fly

Policy = dict[str, torch.Tensor]  # weights by the names that `toolchain.policy.freeze` knows


@dataclass(frozen=True, eq=False)
class MonitorState:
    """The monitor's results of a run, and the policies it still has to fly."""

    history: tuple[CheckpointMetrics, ...] = ()  # by steps
    pending: tuple[tuple[int, Policy], ...] = ()  # by steps: submitted policies without metrics
    chosen: tuple[CheckpointMetrics, Policy] | None = None  # the best so far
    others: tuple[tuple[CheckpointMetrics, Policy], ...] = ()  # the best of the others; see KEPT_MAX

    @property
    def steps(self) -> int:
        """Steps of the last policy that was submitted to the monitor; 0 before the first."""
        submitted = (*(metrics.steps for metrics in self.history), *(steps for steps, _ in self.pending))
        return max(submitted, default=0)

    @property
    def best(self) -> CheckpointMetrics | None:
        """The metrics of the chosen policy."""
        return self.chosen[0] if self.chosen else None

    def submitted(self, steps: int, policy: Policy) -> MonitorState:
        """Add one more policy that waits for its metrics."""
        return replace(self, pending=(*self.pending, (steps, policy)))

    def collected(self, metrics: CheckpointMetrics, limits: SelectionLimits) -> MonitorState:
        """Add the metrics of the policy that has waited longest."""
        (steps, policy), *others = self.pending
        assert steps == metrics.steps
        this = (metrics, policy)
        chosen = this if self.chosen is None or better(metrics, self.chosen[0], limits) else self.chosen
        known = (*self.others, *(() if self.chosen is None else (self.chosen,)), this)
        rest = sorted((each for each in known if each is not chosen), key=lambda each: rank(each[0], limits))
        return MonitorState(
            history=(*self.history, metrics),
            pending=tuple(others),
            chosen=chosen,
            others=tuple(rest[:KEPT_MAX]) if limits.fit else (),
        )

    def going_back(self, steps: int) -> MonitorState:
        """Choose the kept checkpoint of that many steps. Raises KeyError if none is kept."""
        known = {each[0].steps: each for each in (*([self.chosen] if self.chosen else []), *self.others)}
        chosen = known.pop(steps)
        return replace(self, chosen=chosen, others=tuple(known.values()))


@dataclass(frozen=True, eq=False)
class Run:
    """A run at the end of a segment."""

    segment: int  # segments done
    steps: int  # control steps done
    policy: Policy  # the latest
    learner: dict[str, Any]  # Learner.state
    rewards: Rewards = field(default_factory=Rewards)  # of training, from the first step on


def save_checkpoint(path: Path, document: dict[str, Any], run: Run, monitor_state: MonitorState) -> None:
    """Write a checkpoint in one step. document: `TrainingConfig.document`."""
    metrics, chosen = monitor_state.chosen or (None, run.policy)
    content = {
        "format": CHECKPOINT_FORMAT,
        "version": CHECKPOINT_VERSION,
        "config": json.dumps(document, sort_keys=True),
        "state_dict": chosen,
        "learner": run.learner,
        "latest": run.policy,
        "progress": {
            "steps": run.steps,
            "leg": run.segment,
            "chosen_steps": run.steps if metrics is None else metrics.steps,
        },
        "readings": json.dumps([r.document() for r in monitor_state.history]),
        "pending": [[steps, waiting] for steps, waiting in monitor_state.pending],
        "others": [[metrics.steps, policy] for metrics, policy in monitor_state.others],
        "rewards": json.dumps(run.rewards.points),
    }
    # Through memory: given a path, torch would store the file's name.
    buffer = io.BytesIO()
    torch.save(snapshot(content), buffer)
    if buffer.tell() > CHECKPOINT_FILE_BYTES_MAX:
        raise TrainingError(
            f"{path} would be {buffer.tell()} bytes, expected at most {CHECKPOINT_FILE_BYTES_MAX}; choose a "
            f"smaller network or replay buffer"
        )
    write_bytes(path, buffer.getvalue())


def load_run(path: Path, document: dict[str, Any]) -> tuple[Run, MonitorState]:
    """Load the run to resume. Raises TrainingError if there is none, or it has another configuration."""
    if not path.is_file():
        raise TrainingError(f"nothing to resume: {path} does not exist; start without --resume")
    with _reading(path, "go on from"):
        content = _content(path)
        config = json.loads(content["config"])
        progress = content["progress"]
        # A checkpoint of an older version has no rewards: the run's record then begins where it is resumed.
        points = json.loads(content.get("rewards", "[]"))
        run = Run(
            segment=int(progress["leg"]),
            steps=int(progress["steps"]),
            policy=dict(content["latest"]),
            learner=content["learner"],
            rewards=Rewards(tuple((int(steps), float(reward)) for steps, reward in points)),
        )
        history = tuple(CheckpointMetrics.of(item) for item in json.loads(content["readings"]))
        by_steps = {metrics.steps: metrics for metrics in history}
        chosen = [r for r in history if r.steps == progress["chosen_steps"]]
        monitor_state = MonitorState(
            history,
            tuple((int(steps), dict(policy)) for steps, policy in content["pending"]),
            (chosen[0], dict(content["state_dict"])) if chosen else None,
            # Not in a checkpoint of an older version.
            tuple((by_steps[int(steps)], dict(policy)) for steps, policy in content.get("others", [])),
        )
    check_recorded(config.get("plugins", []), str(path))
    same = json.loads(json.dumps(document))
    different = sorted(key for key in {*config, *same} if config.get(key) != same.get(key))
    if different:
        key = different[0]
        raise TrainingError(
            f"{path} was trained with {key} {config.get(key)}, got {same.get(key)}; resume with the same "
            f"configuration, or train anew into another folder"
        )
    return run, monitor_state


def snapshot(value: Any) -> Any:  # noqa: ANN401 - plain containers, numbers, text and tensors
    """Copy `value` so that nothing is shared and the pickle depends on the values alone.

    Pickle stores which equal strings and containers are one object, and that changes when a run is resumed.
    Raises TypeError for objects of other types.
    """
    match value:
        case torch.Tensor():
            return value.detach().cpu().clone()
        case dict():
            return {snapshot(key): snapshot(item) for key, item in value.items()}
        case list():
            return [snapshot(item) for item in value]
        case tuple():
            return tuple(snapshot(item) for item in value)
        case str():
            return sys.intern(str(value))
        case None | bool() | int():
            return value
        case float():
            return float(value)
    raise TypeError(f"a checkpoint holds plain data and tensors, got {type(value).__name__}")


@dataclass(frozen=True, eq=False)
class Learned:
    """The results of a run, from which another one can start."""

    policy: Policy  # the chosen one
    learner: dict[str, Any]  # Learner.state of the latest


def load_learned(path: Path) -> Learned:
    """Load the policy and the learner's state of a checkpoint. Raises TrainingError if it is none."""
    if not path.is_file():
        raise TrainingError(f"nothing to start from: {path} does not exist; give the folder of a run")
    with _reading(path, "start from"):
        content = _content(path)
        return Learned(dict(content["state_dict"]), dict(content["learner"]))


def _content(path: Path) -> dict[str, Any]:
    """Load a checkpoint of this version."""
    content: dict[str, Any] = load_plain(path)
    if (content["format"], content["version"]) != (CHECKPOINT_FORMAT, CHECKPOINT_VERSION):
        raise TrainingError(
            f"{path} is of version {content['version']}, expected {CHECKPOINT_VERSION}; train anew"
        )
    return content


@contextmanager
def _reading(path: Path, use: str) -> Iterator[None]:
    """Make anything that is wrong with a checkpoint a TrainingError; use: what a run wants it for."""
    try:
        yield
    except TrainingError:
        raise
    except PolicyError as error:
        raise TrainingError(str(error)) from error
    except Exception as error:  # of content that is another than ours, of any kind
        raise TrainingError(f"{path} is no checkpoint that a run can {use}; train anew") from error
