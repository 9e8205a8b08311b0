"""Figures found by their paths, and the verdicts on them."""

from __future__ import annotations

import pytest

from training.reproduction.experiments import Figure, ReproduceError, Source
from training.reproduction.lookup import Value, find, ours
from training.reproduction.quoted import Quoted, quoted
from training.reproduction.verdict import Verdict, judge


def flown(error: list[float], rise: list[float]) -> dict[str, object]:
    """An entry of `compare --json`."""
    return {"response": {"error": {"value": error}, "rise_ms": {"value": rise}}}


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
    ],
)
def test_paths_lead_to_numbers(path: str, expected: Value) -> None:
    assert find(COMPARED, path) == expected


@pytest.mark.parametrize(
    ("path", "named"),
    [
        ("comparison[0].response.peak.value", "peak: not in the command's output"),
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


def figure(aim: str, quote: Quoted | None, within: float = 0.1) -> Figure:
    """A figure of ours beside `quote`."""
    return Figure("it", quote, "", Source("step", "path"), None, None, 1.0, aim, within)


THREE = Quoted("3.9/ppo-1", (66.6, 70.8, 72.9), (3.2, 3.6, 3.7))


@pytest.mark.parametrize(
    ("aim", "value", "verdict", "axes"),
    [
        ("lower", (60.0, 70.0, 72.0), Verdict.SURPASSED, ()),
        ("lower", (60.0, 70.0, 76.6), Verdict.REACHED, ()),
        ("lower", (60.0, 74.5, 76.6), Verdict.NOT_REACHED, ("pitch",)),
        ("lower", (90.0, 90.0, 90.0), Verdict.NOT_REACHED, ()),
        ("higher", (90.0, 90.0, 90.0), Verdict.SURPASSED, ()),
        ("to 70", (66.6, 70.2, 70.0), Verdict.REACHED, ()),
        ("to 70", (69.0, 70.2, 70.0), Verdict.SURPASSED, ()),
        ("to 70", (50.0, 70.2, 70.0), Verdict.NOT_REACHED, ("roll",)),
        ("near", (60.5, 70.0, 80.0), Verdict.REACHED, ()),
        ("near", (10.0, 70.0, 80.0), Verdict.NOT_REACHED, ("roll",)),
        ("told", (900.0, 900.0, 900.0), Verdict.TOLD, ()),
    ],
)
def test_verdicts_by_axis(aim: str, value: Value, verdict: Verdict, axes: tuple[str, ...]) -> None:
    judged = judge(figure(aim, THREE), value)
    assert (judged.verdict, judged.axes) == (verdict, axes)


@pytest.mark.parametrize(
    ("value", "verdict"),
    [
        (-50.0, Verdict.SURPASSED),
        (-30.0, Verdict.REACHED),
        (-20.0, Verdict.NOT_REACHED),
        (5.0, Verdict.NOT_REACHED),
    ],
)
def test_an_effect_needs_its_sign_and_half_its_size(value: float, verdict: Verdict) -> None:
    assert judge(figure("effect", Quoted("4/x", (-45.07,), None)), value).verdict is verdict


def test_what_is_rounded_away_does_not_count_against_ours() -> None:
    mae = Quoted("5.6/mae", (3.0, 2.0, 2.0), None)
    assert judge(figure("lower", mae), (3.4, 2.4, 1.0)).verdict is Verdict.REACHED
    assert judge(figure("lower", mae), (3.6, 2.4, 1.0)).axes == ("roll",)


def test_one_number_stands_against_the_mean_of_three() -> None:
    assert judge(figure("lower", THREE), 65.0).verdict is Verdict.SURPASSED


def test_a_change_is_in_percent_of_what_it_is_taken_against() -> None:
    compared = figure("effect", None)
    assert ours(compared, 55.0, 100.0) == pytest.approx(-45.0)
    assert ours(compared, (50.0, 110.0), (100.0, 100.0)) == pytest.approx((-50.0, 10.0))


def test_rows_of_a_table_are_three_numbers_with_their_confidence() -> None:
    assert quoted("3.9/ppo-1") == THREE
    assert quoted("5.6/mae").margin is None
    assert quoted("3/continuous_less_error").value == (22.0,)


@pytest.mark.parametrize(
    ("value", "digits"), [(22.0, 0), (0.02, 2), (0.0001, 4), (1e-5, 5), (9.37e-7, 6), (1e-9, 6)]
)
def test_a_figure_has_the_decimals_that_it_is_printed_with(value: float, digits: int) -> None:
    assert Quoted("x", (value,), None).digits == digits
