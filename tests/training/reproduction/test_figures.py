"""A figure of ours with its interval, and what the dissertation has in place of one."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from neuroflight.training.reproduction.experiments import Experiments, ReproduceError, parse
from neuroflight.training.reproduction.page import measured, quoted
from neuroflight.training.reproduction.steps import Done
from neuroflight.training.reproduction.stored import Kept, keep, read_stored, row_result, sources, store
from neuroflight.training.results_page.stored_results import ResultsError

TEXT = """
[steps]
bench = "dyno run --out {out}/a.csv"
other = "dyno run --out {out}/b.csv"
[rows."5.3-repeats"]
title = "Table 5.3: Repeats"
"T" = { quote = "5.3/thrust_max/value", ours = "bench mean", margin = "yes", aim = "near" }
"factor" = { beside = "not told", ours = "other mean", scale = 100.0, margin = "yes" }
"more, %" = { ours = "bench mean", against = "other mean" }
"""
OUTPUT = {"mean": 6.4, "margin": 0.25}


@pytest.fixture
def known() -> Experiments:
    """One row of two steps."""
    return parse(TEXT, "test")


def kept(known: Experiments, *names: str, budget: str = "full") -> dict[str, Kept]:
    """What is kept of steps that have run."""
    found = {}
    for name in names:
        done = Done(known.steps[name], "quick" if budget == "quick" else "full", "", 1.0, OUTPUT, None)
        found[name] = keep(done, known.rows)
    return found


def test_a_figure_is_shown_with_its_interval_when_one_is_told(known: Experiments) -> None:
    (row,) = known.rows
    assert {(source.step, source.path) for source in sources(row)} == {
        *(("bench", "mean"), ("bench", "margin"), ("other", "mean"), ("other", "margin"))
    }
    assert row.steps == ("bench", "other")
    results = row_result(row, kept(known, "bench", "other")).results
    assert [measured(result) for result in results] == ["6.40 ± 0.25", "640 ± 25", "0"]
    assert [quoted(result.figure) for result in results] == ["6.59 ± 0.09", "not told", "drawn"]


def test_a_figure_is_not_shown_until_all_of_it_is_measured(known: Experiments) -> None:
    results = row_result(known.rows[0], kept(known, "bench")).results
    assert [measured(result) for result in results] == ["6.40 ± 0.25", "not run", "not run"]


def test_a_figure_is_quick_when_a_part_of_it_is(known: Experiments) -> None:
    both = {**kept(known, "bench"), **kept(known, "other", budget="quick")}
    assert [each.budget for each in row_result(known.rows[0], both).results] == ["full", "quick", "quick"]


def test_words_beside_a_quote_are_refused() -> None:
    with pytest.raises(ReproduceError, match="beside: there is a quote as well"):
        parse(TEXT.replace('aim = "near"', 'aim = "near", beside = "none"'), "test")


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        ({"budget": "huge"}, "budget, step: got 'huge, bench'"),
        ({"step": "other"}, "budget, step: got 'full, other'"),
        ({"figures": [1]}, "figures: got '[1]', expected an object"),
        ({"figures": {"mean": [1, None]}}, "figures.mean: got '[1, None]', expected a list of numbers"),
        ({"figures": {"mean": True}}, "figures.mean: got 'True', expected a finite number"),
        ({"seconds": None}, "seconds: got 'None', expected a finite number"),
    ],
)
def test_damaged_stored_figures_are_refused_by_key(
    known: Experiments, tmp_path: Path, damage: dict[str, object], message: str
) -> None:
    store(kept(known, "bench")["bench"], tmp_path, None, tmp_path)
    assert read_stored(tmp_path) == kept(known, "bench")
    path = tmp_path / "bench.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | damage))
    with pytest.raises(ResultsError) as caught:
        read_stored(tmp_path)
    assert message in str(caught.value)
