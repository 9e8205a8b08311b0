"""Envelope of commands whose errors are known, and its drawing as a user asks for it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from neuroflight.cli.compare.figures import envelope_document
from neuroflight.cli.main import main
from neuroflight.training.evaluation.envelope import Envelope, by_magnitude

COMMANDS = np.array([[100.0, 0, 0], [0, -300.0, 0], [0, 300.0, 400.0], [0, 0, 1900.0]])


def made(mae: list[float], held: list[bool]) -> Envelope:
    return Envelope(COMMANDS, np.array(mae), np.array(held), np.array(held) & (COMMANDS[:, 0] == 0))


def test_figures_are_taken_by_magnitude() -> None:
    count, error, held = by_magnitude(made([1.0, 2.0, 3.0, 4.0], [True, True, False, False]))
    assert count.tolist() == [1, 1, 1, 0, 0, 1]
    assert error[[0, 1, 2, 5]].tolist() == [1.0, 2.0, 3.0, 4.0]
    assert held[[0, 1, 2, 5]].tolist() == [1.0, 1.0, 0.0, 0.0]
    assert np.isnan([*error[3:5], *held[3:5]]).all()


def test_document_has_the_largest_held_and_the_ratio_to_the_first() -> None:
    first, other = made([4.0] * 4, [False] * 4), made([1.0] * 4, [True, False, True, False])
    found = envelope_document(other, first)
    assert found["mae_ratio_to_first"] == 0.25
    assert (found["held_to_deg_s"], found["largest_command_deg_s"]) == (500.0, 1900.0)
    assert envelope_document(first, first)["held_to_deg_s"] is None
    json.dumps(found, allow_nan=False)


def test_command_draws_and_tells_the_envelope(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture = tmp_path / "envelope.png"
    words = ["pid:published", "pid:tuned", "--task", "envelope", "--episodes", "6"]
    assert main(["compare", *words, "--envelope", str(picture), "--json"]) == 0
    first, other = json.loads(capsys.readouterr().out)["comparison"]
    assert first["envelope"]["mae_ratio_to_first"] == 1.0
    assert first["envelope"]["mae"] == pytest.approx(np.mean(first["mae"]))
    assert sum(other["envelope"]["magnitude_commands"]) == 6
    assert picture.read_bytes().startswith(b"\x89PNG")
