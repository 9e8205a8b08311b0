"""Confidence intervals against printed tables and against random draws."""

from __future__ import annotations

import numpy as np
import pytest

from neuroflight.sim.analysis.confidence import mean_of, paired, share_of, student


@pytest.mark.parametrize(
    ("freedom", "printed"), [(1, 12.706), (6, 2.447), (10, 2.228), (11, 2.201), (30, 2.042), (1000, 1.962)]
)
def test_quantile_is_the_printed_one_when_looked_up(freedom: int, printed: float) -> None:
    assert student(np.array([freedom]))[0] == pytest.approx(printed, abs=6e-4)


def test_interval_holds_the_true_mean_when_drawn_again_and_again() -> None:
    rng = np.random.default_rng(1)
    draws = rng.normal(3.0, 2.0, (12, 30_000))
    hits = []
    for start in range(0, draws.shape[1], 3):
        mean = mean_of(draws[:, start : start + 3], np.ones((12, 3), bool))
        hits.append((mean.low < 3.0) & (mean.high > 3.0))
    assert np.mean(hits) == pytest.approx(0.95, abs=0.005)


def test_mean_is_of_the_valid_ones_when_some_are_not() -> None:
    values = np.array([[1.0, 5.0, 7.0], [3.0, 6.0, 8.0], [1e9, 7.0, 9.0]])
    mean = mean_of(values, np.array([[True, False, False], [True, True, False], [False, False, False]]))
    assert mean.value.tolist() == [2.0, 6.0, 0.0]
    assert mean.count.tolist() == [2, 1, 0]
    assert mean.high[0] - 2.0 == pytest.approx(12.706)  # the deviation is sqrt 2, over sqrt 2
    assert (mean.low[1:] == mean.value[1:]).all()
    assert (mean.high[1:] == mean.value[1:]).all()


def test_share_has_a_width_when_all_succeed() -> None:
    share = share_of(np.column_stack([np.ones(100, bool), np.zeros(100, bool), np.arange(100) < 50]))
    assert share.value.tolist() == [1.0, 0.0, 0.5]
    assert share.low[0] == pytest.approx(0.963, abs=5e-4)  # Wilson: n / (n + z^2)
    assert share.high[0] == 1.0
    assert share.high[1] == pytest.approx(1 - share.low[0])
    assert (share.low[2], share.high[2]) == pytest.approx((0.404, 0.596), abs=5e-4)


def test_paired_difference_is_of_whole_pairs_when_one_lacks_a_number() -> None:
    difference = paired(np.array([1.0, np.nan, 5.0, 7.0]), np.array([2.0, 9.0, np.nan, 10.0]))
    assert (float(difference.value), int(difference.count)) == (2.0, 2)
    assert difference.high - 2.0 == pytest.approx(12.706)


def test_paired_difference_is_of_episodes_when_each_has_several() -> None:
    first = np.zeros((4, 3))
    second = np.array([[1.0, 2.0, 3.0], [np.nan, 4.0, 6.0], [np.nan] * 3, [5.0, 5.0, 5.0]])
    difference = paired(first, second)
    assert (float(difference.value), int(difference.count)) == (4.0, 3)
    assert difference.high - 4.0 == pytest.approx(4.303 * np.std([2, 5, 5], ddof=1) / np.sqrt(3))


def test_a_single_flight_of_many_commands_has_no_width_at_all() -> None:
    values = np.random.default_rng(4).normal(1.0, 0.3, 10)
    alone = mean_of(values, np.full(10, fill_value=True), each=10)
    assert alone.low == alone.value == alone.high  # not what rounding leaves
    assert alone.count == 10
    two = mean_of(np.tile(values, 2) + np.repeat([0.0, 0.1], 10), np.full(20, fill_value=True), each=10)
    assert two.low < two.value < two.high
