"""Several runs that differ by their seed, and the best of them."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.toolchain.errors import TrainingError
from neuroflight.toolchain.files import write_bytes, write_text
from neuroflight.training.checkpoints.metrics import CheckpointMetrics
from neuroflight.training.checkpoints.selection import better
from neuroflight.training.config.selection import SelectionLimits
from neuroflight.training.config.training_config import SEED_MAX, TrainingConfig
from neuroflight.training.runs.checkpoint import load_run
from neuroflight.training.runs.train import CHECKPOINT, POLICY, RECORD, read_record

SEEDS_MAX = 100


@dataclass(frozen=True)
class Planned:
    """A run that has not started yet."""

    config: TrainingConfig
    out: Path
    done: int | None  # steps of the checkpoint to resume from; None: a new run

    @property
    def finished(self) -> bool:
        """True if all steps are done."""
        return self.done is not None and self.done >= self.config.steps


def plan(
    aircraft: Aircraft, config: TrainingConfig, out: Path, seeds: int, *, resume: bool, force: bool
) -> tuple[Planned, ...]:
    """Plan one run for each seed from the configuration's on, in `out` itself or, if several, in a folder
    each.

    Raises TrainingError if a folder holds results already, has none to resume, or those of another
    configuration. Nothing is written.
    """
    if not 1 <= seeds <= SEEDS_MAX:
        raise TrainingError(f"{seeds} seeds, expected 1 to {SEEDS_MAX}")
    if config.seed + seeds - 1 > SEED_MAX:
        raise TrainingError(
            f"{seeds} seeds from {config.seed} on, expected the last to be at most {SEED_MAX}"
        )
    numbers = range(config.seed, config.seed + seeds)
    folders = [out] if seeds == 1 else [out / f"seed-{number}" for number in numbers]
    kept = [folder for folder in (out, *folders) if (folder / CHECKPOINT).exists()]
    if kept and not resume and not force:
        raise TrainingError(
            f"{kept[0]} already holds a checkpoint; choose another --out, or add --resume to go on with it "
            f"or --force to replace it"
        )
    if resume and not any((folder / CHECKPOINT).exists() for folder in folders):
        raise TrainingError(
            f"nothing to resume: {folders[0] / CHECKPOINT} does not exist; start without --resume"
        )
    planned = []
    for number, folder in zip(numbers, folders, strict=True):
        own = replace(config, seed=number)
        done = None
        if resume and (folder / CHECKPOINT).exists():
            done = load_run(folder / CHECKPOINT, own.document(aircraft))[0].steps
        planned.append(Planned(own, folder, done))
    return tuple(planned)


def best_seed(chosen: Mapping[int, CheckpointMetrics], limits: SelectionLimits) -> int:
    """Return the seed with the best chosen checkpoint by the rule that chose it; of equals the first."""
    best = next(iter(chosen))
    for seed, metrics in chosen.items():
        if better(metrics, chosen[best], limits):
            best = seed
    return best


def keep(out: Path, best: int, seeds: Iterable[int], command: str | None) -> None:
    """Copy checkpoint, policy and record of the best seed from its folder into `out`."""
    for name in (CHECKPOINT, POLICY):
        write_bytes(out / name, (out / f"seed-{best}" / name).read_bytes())
    records = {seed: read_record(out / f"seed-{seed}") for seed in seeds}
    document = {
        **records[best],
        "command": command,
        "seed": best,
        "seeds": {
            str(seed): {key: record[key] for key in ("steps", "seconds", "command", "chosen")}
            for seed, record in records.items()
        },
    }
    write_text(out / RECORD, json.dumps(document, indent=2) + "\n")
