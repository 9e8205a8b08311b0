"""Observation terms: the grammar NAME[~fHz][@k] and its bounds."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from neuroflight.toolchain.contract import (
    OBSERVATION_BLOCKS,
    Width,
    check_cutoffs,
    check_observation,
    observation_blocks,
    observation_count,
    observation_memory,
)

PAGE = Path(__file__).resolve().parents[2] / "docs" / "guides" / "policies.md"


@pytest.mark.parametrize(
    "text",
    ["rate", "rate~15Hz", "rate_error@1", "rate~0.5Hz@16", "gravity@2,rotor_speed~250Hz,throttle~33.125Hz"],
)
def test_terms_read_as_they_are_written(text: str) -> None:
    assert ",".join(term.text for term in observation_blocks(text)) == text


def test_terms_have_one_text_when_a_number_is_written_in_two_ways() -> None:
    assert [term.text for term in observation_blocks("rate~15.00Hz@02,rate~0015Hz")] == [
        "rate~15Hz@2",
        "rate~15Hz",
    ]


def test_a_term_counts_what_it_observes_and_what_it_remembers() -> None:
    terms = observation_blocks("previous_action~15Hz@2,rate_error,throttle@3")
    assert [term.count(6) for term in terms] == [6, 3, 1]
    assert [term.memory(6) for term in terms] == [18, 0, 3]
    assert (observation_count(terms, 4), observation_memory(terms, 4)) == (8, 15)
    assert [(term.name, term.unit) for term in terms[1:]] == [("rate_error", "rad/s"), ("throttle", "1")]


def test_a_gain_is_a_float32_between_0_and_1_when_there_is_a_low_pass() -> None:
    none, slow, fast = observation_blocks("rate,rate~0.001Hz,rate~1999Hz")
    assert none.gain(4000) == 0.0
    assert 0.0 < slow.gain(4000) < fast.gain(4000) < 1.0
    assert fast.gain(4000) == float(np.float32(fast.gain(4000))) == pytest.approx(1 - np.exp(-np.pi * 0.9995))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("speed", "unknown observation block 'speed', known are rate, "),
        ("speed@1", "unknown observation block 'speed', known are rate, "),
        ("", "unknown observation block ''"),
        ("x" * 100_000, f"unknown observation block '{'x' * 57}...', known are rate, "),
        ("rate,", "unknown observation block ''"),
        ("rate@", "'rate@', expected NAME, NAME~fHz, NAME@k or NAME~fHz@k"),
        ("rate~15", "'rate~15', expected NAME"),
        ("rate@1~15Hz", "'rate@1~15Hz', expected NAME"),
        ("rate~-5Hz", "'rate~-5Hz', expected NAME"),
        ("rate~nanHz", "'rate~nanHz', expected NAME"),
        ("rate~0.000Hz", "'rate~0.000Hz': a low-pass at 0 Hz, expected more"),
        ("rate@0", "'rate@0': 0 steps old, expected 1 to 16"),
        ("rate@17", "'rate@17': 17 steps old, expected 1 to 16"),
        ("rate~15Hz@٣", "expected NAME"),
    ],
)
def test_a_term_is_refused_when_it_is_none(text: str, words: str) -> None:
    with pytest.raises(ValueError, match=re.escape(words)) as error:
        observation_blocks(text)
    assert "\n" not in str(error.value)


def test_a_low_pass_is_refused_when_it_is_not_below_half_the_control_rate() -> None:
    terms = observation_blocks("rate,rate~500Hz")
    check_cutoffs(terms, 2000)
    with pytest.raises(ValueError, match=r"'rate~500Hz': a low-pass at 500 Hz, expected below 500 Hz, half"):
        check_cutoffs(terms, 1000)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (",".join(["throttle"] * 33), "has 33 terms, expected at most 32"),
        (",".join(["rate"] * 22), "has 66 values, expected at most 64"),
        (",".join(["rate@16"] * 6), "remembers 288 values, expected at most 256"),
    ],
)
def test_an_observation_is_refused_when_it_is_too_large(text: str, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        check_observation(observation_blocks(text), 4)
    check_observation(observation_blocks(",".join(text.split(",")[1:-4])), 4)


def test_the_page_says_what_the_contract_does_when_read() -> None:
    rows = re.findall(r"^\| `(\w+)` \| (\d|a motor each) \| (\S+) \| (.*) \|$", PAGE.read_text(), re.M)
    assert rows == [
        (
            block.name,
            "a motor each" if block.width is Width.MOTORS else str(int(block.width)),
            block.unit,
            block.meaning,
        )
        for block in OBSERVATION_BLOCKS
    ]
