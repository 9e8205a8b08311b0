"""Checkpoints: plain containers and tensors, enough to rebuild the policy and to say how it came about.

The layout is shared with `toolchain.freeze` (contract CHECKPOINT_*). Loading executes nothing.
"""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import torch

from toolchain.contract import CHECKPOINT_FORMAT, CHECKPOINT_VERSION
from toolchain.files import write_bytes


def save_checkpoint(
    path: Path,
    document: dict[str, Any],
    state_dict: dict[str, torch.Tensor],
    optimizer: dict[str, Any],
    progress: dict[str, Any],
) -> None:
    """Write a checkpoint in one step.

    document: `TrainingConfig.document`; state_dict: of the Stable-Baselines3 policy; progress: numbers
    such as {"steps": 1000000}.
    """
    # Through memory: torch writes a file's own name into it, and an equal run shall give equal bytes.
    buffer = io.BytesIO()
    torch.save(
        {
            "format": CHECKPOINT_FORMAT,
            "version": CHECKPOINT_VERSION,
            "config": json.dumps(document, sort_keys=True),
            "state_dict": state_dict,
            "optimizer": optimizer,
            "progress": progress,
        },
        buffer,
    )
    write_bytes(path, buffer.getvalue())
