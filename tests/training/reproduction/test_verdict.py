"""One rule for all figures, with the decimals that the dissertation prints."""

from __future__ import annotations

import pytest

from neuroflight.training.dissertation.quotes import Printed
from neuroflight.training.reproduction.experiments import Figure, Source
from neuroflight.training.reproduction.lookup import Value
from neuroflight.training.reproduction.quoted import Quoted, printed, quoted
from neuroflight.training.reproduction.verdict import Verdict, bar, judge


def figure(aim: str, quote: Quoted | None, *, given: bool = False, unlike: str = "") -> Figure:
    """A figure of ours beside `quote`."""
    ours = Source("step", "path")
    return Figure("it", quote, "", ours, None, None, None, None, 1.0, False, aim, given, unlike, "")


def of(*numbers: str) -> Quoted:
    """A figure that is printed so, "3.2 ± 0.1" each, or "3.2" where no confidence is."""
    pairs = [number.split(" ± ") for number in numbers]
    margins = [Printed(pair[1]) if len(pair) == 2 else None for pair in pairs]
    return printed("it", [Printed(pair[0]) for pair in pairs], margins)


RISE = of("66.6 ± 3.2", "70.8 ± 3.6", "72.9 ± 3.7")  # table 3.9, PPO with m = 1


@pytest.mark.parametrize(
    ("aim", "value", "verdict", "axes"),
    [
        ("lower", (60.0, 67.1, 69.1), Verdict.SURPASSED, ()),
        ("lower", (60.0, 67.1, 69.2), Verdict.REACHED, ()),  # 72.9 - 3.7 is as far as his may be, a tie
        ("lower", (60.0, 70.0, 76.6), Verdict.REACHED, ()),
        ("lower", (60.0, 74.5, 76.6), Verdict.NOT_REACHED, ("pitch",)),
        ("lower", (90.0, 90.0, 90.0), Verdict.NOT_REACHED, ()),
        ("higher", (90.0, 90.0, 90.0), Verdict.SURPASSED, ()),
        ("higher", (63.4, 90.0, 90.0), Verdict.REACHED, ()),
        ("higher", (63.3, 90.0, 90.0), Verdict.NOT_REACHED, ("roll",)),
        ("to 70", (66.6, 70.2, 70.0), Verdict.REACHED, ()),
        ("to 70", (69.9, 70.2, 70.0), Verdict.REACHED, ()),
        ("to 60", (60.0, 60.0, 60.0), Verdict.SURPASSED, ()),
        ("to 70", (50.0, 70.2, 70.0), Verdict.NOT_REACHED, ("roll",)),
        ("near", (63.4, 74.4, 72.9), Verdict.REACHED, ()),
        ("near", (63.3, 74.4, 72.9), Verdict.NOT_REACHED, ("roll",)),
        ("near", (69.9, 74.4, 72.9), Verdict.NOT_REACHED, ("roll",)),
        ("near", (66.6, 70.8, 72.9), Verdict.REACHED, ()),
    ],
)
def test_verdicts_by_axis(aim: str, value: Value, verdict: Verdict, axes: tuple[str, ...]) -> None:
    judged = judge(figure(aim, RISE), value)
    assert (judged.verdict, judged.axes) == (verdict, axes)


@pytest.mark.parametrize(
    ("text", "aim", "reached", "missed"),
    [
        ("0.0 ± 0.0", "to 0", 0.05, 0.06),  # table 3.7: its last digit is a tenth
        ("100.0 ± 0.0", "higher", 99.95, 99.94),
        ("99.8 ± 0.3", "higher", 99.5, 99.4),
        ("0.9990", "lower", 0.99905, 0.99906),
        ("3.90", "lower", 3.905, 3.906),
        ("3", "lower", 3.5, 3.6),
        ("25_042", "lower", 25_042.5, 25_042.6),
        ("0.007 ± 1e-4", "lower", 0.0075, 0.0076),  # rounding took more than the confidence
        ("0.02 ± 0.01", "lower", 0.03, 0.04),
        ("1e6", "lower", 1.5e6, 1.500001e6),  # "around 1 million"
        ("45.07", "higher", 45.065, 45.064),  # an effect is a figure as any other
    ],
)
def test_the_margin_is_the_confidence_or_half_of_the_last_printed_digit(
    text: str, aim: str, reached: float, missed: float
) -> None:
    quote = of(text)
    assert judge(figure(aim, quote), reached).verdict is Verdict.REACHED
    assert judge(figure(aim, quote), missed).verdict is Verdict.NOT_REACHED


def test_half_of_a_printed_effect_does_not_reach_it() -> None:
    less = quoted("4/oscillation_less")  # 87.95 %
    assert [judge(figure("higher", less), value).verdict for value in (87.9, 44.0, 88.0)] == [
        Verdict.NOT_REACHED,
        Verdict.NOT_REACHED,
        Verdict.SURPASSED,
    ]


@pytest.mark.parametrize(
    ("aim", "text"),
    [
        ("lower", "<= 69.8 / 74.4 / 76.6"),
        ("higher", ">= 63.4 / 67.2 / 69.2"),
        ("near", "within 3.2 / 3.6 / 3.7 of 66.6 / 70.8 / 72.9"),
        ("to 100", "within 36.6 / 32.8 / 30.8 of 100"),
    ],
)
def test_a_bar_is_printed_as_it_is_applied(aim: str, text: str) -> None:
    assert str(bar(figure(aim, RISE))) == text


def test_numbers_are_compared_as_they_are_shown() -> None:
    mae = quoted("5.6/mae")  # 3 / 2 / 2, half of the last digit to either side
    assert str(bar(figure("lower", mae))) == "<= 3.5 / 2.5 / 2.5"
    assert judge(figure("lower", mae), (3.54, 2.4, 1.0)).verdict is Verdict.REACHED
    assert judge(figure("lower", mae), (3.56, 2.4, 1.0)).axes == ("roll",)


def test_a_ratio_has_the_margin_that_follows_from_both() -> None:
    best, pid = quoted("3.11/ppo-1").mean, quoted("3.11/pid").mean
    ratio = best.over(pid)
    of_best = (317.0 + 326.3 + 217.5) / 3
    of_pid = (416.1 + 269.6 + 245.1) / 3
    assert ratio.value[0] == pytest.approx(of_best / of_pid, abs=5e-4)
    # Each mean has its three confidences in quadrature; so has the ratio, relative to each.
    wide = (
        (11.0**2 + 13.2**2 + 9.1**2) ** 0.5 / 3 / of_best,
        (20.4**2 + 11.9**2 + 11.5**2) ** 0.5 / 3 / of_pid,
    )
    assert ratio.allowed[0] == pytest.approx(
        of_best / of_pid * (wide[0] ** 2 + wide[1] ** 2) ** 0.5, abs=5e-4
    )
    assert ratio.text == "0.925 ± 0.033"


def test_nothing_is_divided_by_what_may_be_zero() -> None:
    with pytest.raises(ValueError, match="may be 0"):
        quoted("3.11/ppo-1").over(quoted("3.12/pid"))


def test_inputs_and_unlike_things_have_no_verdict() -> None:
    told = [
        judge(figure("", RISE, given=True), (1.0, 1.0, 1.0)),
        judge(figure("", RISE, unlike="a board"), (1.0, 1.0, 1.0)),
        judge(figure("", None), 5.0),
    ]
    assert [str(each) for each in told] == ["input", "not comparable: a board", ""]
    assert bar(figure("", RISE, unlike="a board")) is None


@pytest.mark.parametrize(
    ("printed_as", "ours", "reached", "missed"),
    [
        ("66.6 ± 3.2", 2.4, 70.6, 70.7),  # 66.6 + sqrt(3.2^2 + 2.4^2) = 70.6
        ("4773", 600.0, 5621.0, 5622.0),  # no confidence printed: 4773 + sqrt(2) 600 = 5621.5
        ("4773", 0.1, 4773.0, 4774.0),  # half of the last digit is more
    ],
)
def test_what_ours_may_be_off_by_counts_too(
    printed_as: str, ours: float, reached: float, missed: float
) -> None:
    made = figure("lower", of(printed_as))
    assert judge(made, reached, ours).verdict is Verdict.REACHED
    assert judge(made, missed, ours).verdict is Verdict.NOT_REACHED
