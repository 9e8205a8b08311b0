"""Stored figures are what their commands print: steps that need no training are run again."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest

from neuroflight.training.reproduction.experiments import Experiments, Step, command, experiments
from neuroflight.training.reproduction.steps import StepOutputs, run_steps
from neuroflight.training.reproduction.stored import keep, read_stored
from tests.sampling import PROVES

ROOT = Path(__file__).resolve().parents[3]
STORED = ROOT / "docs" / "results" / "dissertation"
DIGITS = 1e-6  # seven digits are stored
CHEAP = ("propeller",)


def untrained(known: Experiments) -> list[str]:
    """Steps behind which no training stands."""

    def trains(name: str) -> bool:
        step = known.steps[name]
        return command(step.words("full"))[0] == "policy train" or any(map(trains, step.needs))

    return [name for name in known.steps if not trains(name)]


def plan(known: Experiments, names: Sequence[str]) -> list[Step]:
    """Steps, each after those that it needs."""
    found: dict[str, Step] = {}
    for name in names:
        found |= {step.name: step for step in plan(known, known.steps[name].needs)}
        found[name] = known.steps[name]
    return list(found.values())


def check_again(names: Sequence[str], out: Path) -> int:
    """Run steps and those that they need; how many figures are the stored ones."""
    known, stored = experiments(), read_stored(STORED)
    steps = plan(known, names)
    done = run_steps(steps, StepOutputs(ROOT, out, "full"), jobs=2)
    assert len(done) == len(steps)
    pairs = {
        f"{name} {path}": (value, keep(done[name], known.rows).figures[path])
        for name in names
        for path, value in stored[name].figures.items()
    }
    other = {
        name: pair for name, pair in pairs.items() if pair[1] != pytest.approx(pair[0], rel=DIGITS, abs=1e-12)
    }
    assert other == {}
    return len(pairs)


@pytest.mark.slow
def test_steps_without_a_training_give_the_stored_figures_again(tmp_path: Path) -> None:
    stored = [name for name in untrained(experiments()) if name in read_stored(STORED)]
    assert len(stored) >= 20
    assert check_again(stored if PROVES else CHEAP, tmp_path) >= (60 if PROVES else 3)
