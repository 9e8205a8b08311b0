"""Checkpoints: plain containers and tensors, enough to freeze the policy and to go on with the run.

The layout is shared with `toolchain.freeze` (contract CHECKPOINT_*). Loading executes nothing. No time and
no path is in it: an equal run gives equal bytes.
"""

from __future__ import annotations

import io
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from toolchain.contract import CHECKPOINT_FILE_BYTES_MAX, CHECKPOINT_FORMAT, CHECKPOINT_VERSION
from toolchain.errors import TrainingError
from toolchain.files import write_bytes


@dataclass(frozen=True, eq=False)
class Run:
    """A run at the end of a leg."""

    leg: int  # legs done
    steps: int  # control steps done
    policy: dict[str, torch.Tensor]  # what freeze makes policy.onnx of
    learner: dict[str, Any]  # Learner.state


def save_checkpoint(path: Path, document: dict[str, Any], run: Run) -> None:
    """Write a checkpoint in one step. document: `TrainingConfig.document`."""
    # Through memory: torch writes a file's own name into it.
    buffer = io.BytesIO()
    torch.save(
        {
            "format": CHECKPOINT_FORMAT,
            "version": CHECKPOINT_VERSION,
            "config": json.dumps(document, sort_keys=True),
            "state_dict": run.policy,
            "learner": run.learner,
            "progress": {"steps": run.steps, "leg": run.leg},
        },
        buffer,
    )
    write_bytes(path, buffer.getvalue())


def load_run(path: Path, document: dict[str, Any]) -> Run:
    """The run to go on with. Raises TrainingError if there is none, or it is of another configuration."""
    if not path.is_file():
        raise TrainingError(f"nothing to resume: {path} does not exist; start without --resume")
    if (size := path.stat().st_size) > CHECKPOINT_FILE_BYTES_MAX:
        raise TrainingError(f"{path} is {size} bytes, expected at most {CHECKPOINT_FILE_BYTES_MAX}")
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
        form = content["format"], content["version"]
        config = json.loads(content["config"])
        progress = content["progress"]
        run = Run(int(progress["leg"]), int(progress["steps"]), content["state_dict"], content["learner"])
    except Exception as error:  # torch documents no set of errors for a file that is not its own
        raise TrainingError(f"{path} is no checkpoint that a run can go on from; train anew") from error
    if form != (CHECKPOINT_FORMAT, CHECKPOINT_VERSION):
        raise TrainingError(f"{path} is of version {form[1]}, expected {CHECKPOINT_VERSION}; train anew")
    same = json.loads(json.dumps(document))
    different = sorted(key for key in {*config, *same} if config.get(key) != same.get(key))
    if different:
        key = different[0]
        raise TrainingError(
            f"{path} was trained with {key} {config.get(key)}, got {same.get(key)}; resume with the same "
            f"configuration, or train anew into another folder"
        )
    return run
