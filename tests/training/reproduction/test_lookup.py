"""Figures found by their paths, and what is made of them."""

from __future__ import annotations

import math

import pytest

from neuroflight.training.reproduction.experiments import Experiments, ReproduceError, parse
from neuroflight.training.reproduction.lookup import Value, find
from neuroflight.training.reproduction.steps import Done
from neuroflight.training.reproduction.stored import Kept, keep, row_result


def flown(error: list[float], rise: list[float]) -> dict[str, object]:
    """An entry of `compare --json`."""
    interval = {"low": [each - 3 for each in rise], "high": [each + 5 for each in rise]}
    return {"response": {"error": {"value": error}, "rise_ms": {"value": rise, **interval}}}


COMPARED = {
    "comparison": [
        flown([1, 1, 1], [70, 70, 70]),
        flown([300, 300, 300], [10, 20, 30]),
        flown([200, 200, 200], [30, 40, 50]),
        flown([400, 100, 300], [50, 60, 10]),
    ],
    "seconds": 7200,
}


@pytest.mark.parametrize(
    ("path", "expected"),
    [
        ("seconds", 7200.0),
        ("comparison[0].response.rise_ms.value", (70.0, 70.0, 70.0)),
        ("comparison[-1].response.rise_ms.value", (50.0, 60.0, 10.0)),
        ("comparison[1:].response.rise_ms.value", (30.0, 40.0, 30.0)),
        ("comparison[1:3].response.rise_ms.value", (20.0, 30.0, 40.0)),
        ("comparison[best 1:].response.rise_ms.value", (30.0, 40.0, 50.0)),
        ("comparison[0].response.rise_ms.value[1]", 70.0),
        ("comparison[0].response.rise_ms.margin", (4.0, 4.0, 4.0)),
        ("comparison[best 1:].response.rise_ms.margin", (4.0, 4.0, 4.0)),
        ("comparison[1:].response.rise_ms.margin", (4.0 / math.sqrt(3.0),) * 3),
    ],
)
def test_paths_lead_to_numbers(path: str, expected: Value) -> None:
    assert find(COMPARED, path) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("path", "named"),
    [
        ("comparison[0].response.peak.value", "peak: not in the command's output"),
        ("comparison[0].response.error.margin", "margin: not in the command's output"),
        ("comparison[4].response", "4 entries"),
        ("comparison[9:].response", "4 entries"),
        ("seconds[0]", "no list"),
        ("comparison[0]", "expected a number"),
        ("comparison[x]", "not understood"),
    ],
)
def test_a_path_that_leads_nowhere_is_named(path: str, named: str) -> None:
    with pytest.raises(ReproduceError, match=named.replace("[", r"\[")):
        find(COMPARED, path)


MADE = """
[steps]
a = "dyno run --out {out}"
b = "dyno fit {a}"
[rows."3.9-made"]
title = "Table 3.9: What is made of the numbers of two steps"
"change, %" = { ours = "a of", against = "b of" }
"less, %" = { ours = "a of", against = "b of", scale = -1 }
"product over" = { ours = "a of", times = "b count", per = "b episodes" }
"mean ratio" = { ours = "a of", per = "b of", mean = "yes" }
"ratio of one" = { ours = "a one", per = "b episodes", scale = 10 }
"margin" = { ours = "a one", margin = "yes", scale = -2 }
"margin of a mean" = { ours = "b times.mean", margin = "yes" }
"""


def test_a_figure_is_made_of_the_numbers_that_it_names() -> None:
    known: Experiments = parse(MADE, "test")
    outputs = {
        "a": {"of": [50.0, 110.0, 30.0], "one": 8.0, "margin_95": {"one": 3.0}},
        "b": {
            "of": [100.0, 100.0, 200.0],
            "count": [4, 1, 0],
            "episodes": 10,
            "times": {"mean": 5.0, "margin": 0.5},
        },
    }
    kept: dict[str, Kept] = {}
    for name, output in outputs.items():
        kept[name] = keep(Done(known.steps[name], "full", "", 1.0, output, None), known.rows)
    results = row_result(known.rows[0], kept).results
    expected: list[Value] = [
        (-50.0, 10.0, -85.0),
        (50.0, -10.0, 85.0),
        (20.0, 11.0, 0.0),
        190 / 400,
        8.0,
        -16.0,
        5.0,
    ]
    assert [each.value for each in results] == [pytest.approx(value) for value in expected]
    assert [each.margin for each in results[-2:]] == pytest.approx([6.0, 0.5])
