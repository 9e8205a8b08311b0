"""The table that a build ends with."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from toolchain.image.report import BuildReport, PolicyFacts, print_report

POLICY = PolicyFacts("p.onnx", "0" * 64, "6-4", "rate_error", 2000, 0.25, 28, "0" * 8, "nf1", "0" * 64, {})


def printed(instructions: int | None, cycles: int | None, reason: str | None) -> str:
    """The table of a build with such a step, as one line."""
    report = BuildReport("BOARD", (), POLICY, (), (), (), instructions, cycles, reason)
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


def test_step_is_left_out_when_it_was_not_counted() -> None:
    assert "a step" not in printed(None, None, "not on this machine")
