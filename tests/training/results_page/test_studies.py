"""Sections of stored studies, and the plot of sizes."""

import hashlib
import json
from pathlib import Path
from typing import Any

import pytest

from neuroflight.cli.main import main
from neuroflight.sim.plotting import png
from neuroflight.training.results_page.page import render
from neuroflight.training.results_page.stored_results import ResultsError, Stored
from neuroflight.training.results_page.studies import drawn_points
from neuroflight.training.results_page.studies_plot import draw_sizes

Document = dict[str, Any]
ROOT = Path(__file__).parents[3]
RESULTS = ROOT / "docs" / "results"
SHIPPED = ROOT / "training" / "policies" / "nf1" / "policy.onnx"


def run(number: int, name: str, mae: float, instructions: int | None, **more: Any) -> Document:
    """A run of a study, as `sweep --json` prints it."""

    def figures(factor: float) -> Document:
        return {
            "mae": {"mean": factor * mae, "margin": 0.04},
            "mse": {"mean": 60 * factor * mae, "margin": 2.0},
            "change": {"mean": 0.003, "margin": 0.0001},
        }

    outcome = {
        **figures(1.0),
        "output": {"mean": 0.3, "margin": 0.01},
        "thrusts": [
            {"asked": None, "throttle": 0.0, "thrust": 0.07, **figures(2.0)},
            {"asked": 0.35, "throttle": 0.1, "thrust": 0.41, **figures(1.5)},
            {"asked": 1.0, "throttle": 0.3, "thrust": 1.001, **figures(1.0)},
        ],
        "instructions": instructions,
        "predicted_cycles": None if instructions is None else 1.6 * instructions,
        "weights": 5000,
        "steps": 8_000_000,
        "training_seconds": 20.0,
        "policy_sha256": "cd" * 32,
    }
    return {"number": number, "varied": {"variant": name}, "unfit": None, "outcome": outcome} | more


def study(*runs: Document, **more: Any) -> Stored:
    return Stored(
        "study-sizes.json",
        {
            "command": "neuroflight sweep training/sweeps/studies/sizes.toml --out runs/sizes",
            "sweep": "sizes",
            "aircraft": {"name": "nf1", "sha256": "ab" * 32},
            "validation": {"task": "pulse", "episodes": 60, "seed": 3, "throttle": 0.0, "thrust": [0.35, 1]},
            "baseline": "64-64",
            "board": {"control_task_cycles": 22000, "other_cycles": 8000},
            "complete": True,
            "runs": list(runs),
            "configurations": [],
        }
        | more,
    )


FOUND = study(
    run(1, "64-64", 1.2, 9000),
    run(2, "8-8", 1.5, 1000),
    run(3, "96-96", 1.2, 19000, unfit="38,400 cycles of 22,000"),
    run(4, "unknown", 1.2, None),
)


def test_a_study_has_a_row_for_each_variant_with_what_it_differs_by() -> None:
    page = render([FOUND])
    assert "## What a policy costs and gives by size, nf1" in page
    assert "| 64-64 | 1.20 ± 0.04 |  | 72.0 |  | 0.0030 | 9,000 |  | 14,400 | 5,000 | 8.0 | 20 |" in page
    assert "| 8-8 | 1.50 ± 0.04 | +25.0 | 90.0 | +25.0 | 0.0030 | 1,000 | -8,000 |" in page
    assert "| unknown | 1.20 ± 0.04 | +0.0 | 72.0 | +0.0 | 0.0030 |  |  |  | 5,000 |" in page
    assert "Too large for the board: 96-96: 38,400 cycles of 22,000." in page
    assert "may take 22,000 predicted cycles, 8,000 of them beside" in page
    assert "](results/sizes.png)" in page
    assert "nf1 `abababababab`" in page


def test_figures_stand_by_thrust_with_what_was_reached_where_it_is_another() -> None:
    page = render([FOUND])
    assert "| MAE / MSE / abs Δu | closed | 0.35 | 1 |" in page
    closed, least, hover = (
        "2.40 / 144 / 0.0030 (at 0.07)",
        "1.80 / 108 / 0.0030 (at 0.41)",
        "1.20 / 72 / 0.0030",
    )
    assert f"| 64-64 | {closed} | {least} | {hover} |" in page


@pytest.mark.parametrize(
    ("broken", "message"),
    [
        (study(run(1, "64-64", 1.2, 9000), complete=False), "study-sizes.json: complete: got 'False'"),
        (study(run(1, "8-8", 1.2, 9000)), "study-sizes.json: baseline: got '64-64', expected one of its"),
        (study(run(1, "64-64", 1.2, 9000, outcome={})), r"runs\[0\]: outcome.steps: got 'nothing'"),
    ],
)
def test_a_damaged_study_is_rejected_in_one_line(broken: Stored, message: str) -> None:
    with pytest.raises(ResultsError, match=message) as caught:
        render([broken])
    assert "\n" not in str(caught.value)


def test_sizes_are_drawn_by_instructions_and_the_same_each_time() -> None:
    drawn = drawn_points(FOUND)
    assert [point.name for point in drawn] == ["8-8", "64-64", "96-96"]
    assert [point.fits for point in drawn] == [True, True, False]
    assert png(draw_sizes(drawn, "sizes")) == png(draw_sizes(drawn, "sizes"))


def test_results_draws_the_sizes_beside_their_file(tmp_path: Path) -> None:
    (tmp_path / "study-sizes.json").write_text(json.dumps(dict(FOUND.document)))
    words = ["report", "--folder", str(tmp_path), "--out", str(tmp_path / "page.md")]
    assert main(words) == 0
    assert (tmp_path / "sizes.png").read_bytes().startswith(b"\x89PNG")
    assert main([*words, "--check"]) == 0


def test_the_stored_seeds_are_of_the_shipped_recipe_and_near_one_another() -> None:
    """Squared errors within 5 %; absolute ones are not, as docs/results.md shows: they stay within 15 %."""
    stored = json.loads((RESULTS / "study-seeds.json").read_text())
    runs = {each["varied"]["variant"]: each["outcome"] for each in stored["runs"]}
    assert sorted(runs) == [f"seed {seed}" for seed in range(1, 6)]
    shipped = runs["seed 1"]
    assert shipped["policy_sha256"] == hashlib.sha256(SHIPPED.read_bytes()).hexdigest()
    for name, apart in (("mse", 0.05), ("mae", 0.15)):
        ratios = [each[name]["mean"] / shipped[name]["mean"] for each in runs.values()]
        assert max(abs(ratio - 1.0) for ratio in ratios) < apart, (name, ratios)
