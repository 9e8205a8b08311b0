"""The table that a build ends with."""

from __future__ import annotations

import io
from dataclasses import replace

import pytest
from rich.console import Console

from neuroflight.toolchain.image.report import BuildReport, PolicyFacts, print_report

POLICY = PolicyFacts(
    "p.onnx",
    "0" * 64,
    "6-4",
    "rate_error",
    2000,
    0.25,
    "centred",
    (["mean"],),
    28,
    "0" * 8,
    "nf1",
    "0" * 64,
    {},
)


def printed(
    instructions: int | None, cycles: int | None, reason: str | None, policy: PolicyFacts = POLICY
) -> str:
    """The table of a build with such a step, as one line."""
    report = BuildReport("BOARD", (), policy, (), (), (), instructions, cycles, reason)
    console = Console(file=io.StringIO(), width=200)
    print_report(report, console)
    assert isinstance(console.file, io.StringIO)
    return " ".join(console.file.getvalue().split())


@pytest.mark.parametrize(
    ("step", "words"),
    [
        (
            (1234, 21600, None),
            "1,234 instructions, 21,600 cycles predicted: 100 µs, 20.0 % of its period",
        ),
        ((1234, None, "no model is here"), "1,234 instructions; no predicted cycles: no model is here"),
    ],
)
def test_step_is_told_in_words_when_it_was_counted(
    step: tuple[int | None, int | None, str | None], words: str
) -> None:
    assert words in printed(*step)


def test_settings_are_told_that_the_board_needs_for_the_policy() -> None:
    behind = replace(POLICY, filters=(["rpm", 2, 90_500, 5000], ["mean"]))
    words = (
        "settings motor_telemetry=1 rpm_filter_harmonics=2 rpm_filter_min_hz=90.5 rpm_filter_q=5; with others"
    )
    assert words in printed(None, None, "none", behind)
    assert "rpm_filter" not in printed(None, None, "none")


@pytest.mark.parametrize(
    ("training", "words"),
    [
        ({}, "training nf1, 2000 Hz, not told"),
        (
            {
                "algorithm": {"name": "pathwise", "square": 0.03},
                "steps": 12_006_400,
                "seed": 1,
                "hidden": [64],
            },
            "training nf1, 2000 Hz, algorithm pathwise, steps 12,006,400, seed 1",
        ),
        ({"algorithm": "ppo", "seed": [1, 2]}, "training nf1, 2000 Hz, algorithm ppo"),
    ],
)
def test_training_is_told_in_words(training: dict[str, object], words: str) -> None:
    assert words in printed(None, None, "no model", replace(POLICY, training=training))


def test_step_is_left_out_when_it_was_not_counted() -> None:
    assert "a step" not in printed(None, None, "not on this machine")
