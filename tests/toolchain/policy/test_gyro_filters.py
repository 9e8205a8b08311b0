"""Chains of gyro filters: their text, their list, what the firmware allows."""

from __future__ import annotations

from typing import Any

import pytest

from neuroflight.toolchain.contract import FILTER_DELAY_MAX_MS
from neuroflight.toolchain.policy.gyro_filters import MEAN, UNFILTERED, GyroFilters, RpmFilter


@pytest.mark.parametrize(
    ("text", "chain", "filters"),
    [
        ("none", [], UNFILTERED),
        ("mean", [["mean"]], MEAN),
        ("rpm:3:100:5", [["rpm", 3, 100_000, 5000]], GyroFilters(RpmFilter())),
        (
            "rpm:2:90.5:3.25,mean",
            [["rpm", 2, 90_500, 3250], ["mean"]],
            GyroFilters(RpmFilter(2, 90.5, 3.25), True),
        ),
    ],
)
def test_text_and_list_say_the_same_chain(text: str, chain: list[Any], filters: GyroFilters) -> None:
    assert GyroFilters.parse(text) == filters == GyroFilters.of(chain)
    assert (filters.text, filters.chain) == (text, chain)


def test_what_a_text_leaves_out_is_usual() -> None:
    assert GyroFilters.parse("rpm,mean") == GyroFilters.parse("rpm:3:100:5,mean")
    assert GyroFilters.parse("rpm:1,mean").rpm == RpmFilter(1)


@pytest.mark.parametrize(
    "text",
    ["", "mean,rpm", "rpm,", "rpm,mean,mean", "none,mean", "rpm::100", "rpm:3:100:5:1", "rpm:x", "rpm:-1"],
)
def test_other_texts_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"^gyro filter '.*', expected none, mean, rpm or rpm,mean;"):
        GyroFilters.parse(text)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("rpm:4", "rpm_filter_harmonics is 4, expected 1 to 3"),
        ("rpm:0", "rpm_filter_harmonics is 0, expected 1 to 3"),
        ("rpm:3:29,mean", "rpm_filter_min_hz is 29, expected 30 to 200"),
        ("rpm:3:100:1.9", "rpm_filter_q is 1.9, expected 2 to 20"),
    ],
)
def test_numbers_that_the_settings_do_not_allow_are_refused(text: str, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        GyroFilters.parse(text)


@pytest.mark.parametrize(
    "chain", [[["mean"], ["mean"]], [["mean"], ["rpm", 3, 100_000, 5000]], [["rpm", 3]], [{}], [1]]
)
def test_other_lists_are_refused(chain: list[Any]) -> None:
    with pytest.raises(ValueError, match=r"gyro filters \[.*expected chains as \[\], "):
        GyroFilters.of(chain)


def test_a_chain_that_is_late_is_refused() -> None:
    GyroFilters.parse("rpm,mean").check(4, 1000)
    with pytest.raises(
        ValueError, match=rf"with 6 motors may be 3\.\d+ ms late, expected at most {FILTER_DELAY_MAX_MS}"
    ):
        GyroFilters.parse("rpm,mean").check(6, 1000)
    GyroFilters.parse("rpm:2,mean").check(6, 1000)
