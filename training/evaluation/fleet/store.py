"""Figures that are kept aircraft by aircraft, so that a run of hours goes on where it ended."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

from neuroflight.toolchain.errors import TrainingError
from neuroflight.toolchain.files import read_limited, write_bytes
from neuroflight.training.evaluation.fleet.arena import Figures, Plan
from neuroflight.training.evaluation.fleet.unseen import Unseen

BYTES_MAX = 1 << 20
VERSION = 3  # of what is flown: another one flies anew


def place(folder: Path, aircraft: Unseen, name: str, facts: dict[str, str], plan: Plan) -> Path:
    """Return the file of a controller's figures on an aircraft: a digest of all that they depend on.

    Kinds of flights are flown apart, so that a plan with more of them adds to the file.
    """
    known: dict[str, Any] = {
        "version": VERSION,
        "aircraft": aircraft.text,
        "shares": aircraft.shares,
        "charge": aircraft.charge,
        "controller": name,
        "facts": facts,
        "plan": [plan.pulses, plan.seed],
    }
    digest = hashlib.sha256(json.dumps(known, sort_keys=True).encode()).hexdigest()
    return folder / f"{aircraft.name}.{digest[:16]}.json"


def kept(file: Path) -> dict[str, Figures]:
    """Return kept figures by kind of flight. Raises TrainingError on a file that holds none."""
    if not file.is_file():
        return {}
    try:
        data = json.loads(read_limited(file, f"{file}", BYTES_MAX, TrainingError))
        return {kind: Figures.of(figures) for kind, figures in data.items()}
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise TrainingError(f"{file}: holds no figures of a flight ({error}); delete it") from error


def keep(file: Path, found: dict[str, Figures]) -> None:
    """Write figures, whole or not at all."""
    write_bytes(file, json.dumps({kind: each.document() for kind, each in found.items()}).encode())
