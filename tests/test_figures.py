"""Measured figures in the pages are those of this checkout's compiler, and of the stored times."""

from __future__ import annotations

import json
import re

import pytest

from neuroflight.toolchain.cortex_m7.arm_policy import compiler_version
from neuroflight.toolchain.cortex_m7.llvm_mca import find_pricer
from tests import figures
from tests.bench import emx
from tests.conftest import ROOT

QUOTED = [(page, name, text) for page in figures.PAGES for name, text in figures.figures(page)]
STORED = {figures.trained, figures.reproduced}
LONG = {figures.theirs, figures.flight}
COUNTED = [
    pytest.param(name, marks=pytest.mark.slow) if make in LONG else name
    for name, make in figures.FIGURES.items()
    if make not in STORED
]


@pytest.fixture
def counted_with() -> None:
    """Skip the test with another compiler or cycle counter than the pages' figures are from."""
    if not (compiler_version().startswith(figures.COMPILER) and find_pricer()):
        pytest.skip(f"the pages' counts are of {figures.COMPILER}, cycles of llvm-mca")


def check(name: str) -> None:
    told = figures.FIGURES[name](name)
    for page, quoted, text in QUOTED:
        assert quoted != name or text == told, f"{page}: run: python -m tests.figures"


def test_every_figure_is_quoted() -> None:
    assert {name for _, name, _ in QUOTED} == set(figures.FIGURES)


@pytest.mark.parametrize("name", [name for name, make in figures.FIGURES.items() if make in STORED])
def test_pages_quote_the_stored_times(name: str) -> None:
    check(name)


@pytest.mark.usefixtures("counted_with")
@pytest.mark.parametrize("name", COUNTED)
def test_pages_tell_the_counts_of_this_compiler(name: str) -> None:
    if figures.FIGURES[name] is figures.theirs and (reason := emx.fetch()):
        pytest.skip(reason)
    check(name)


@pytest.mark.usefixtures("counted_with")
def test_stored_results_have_the_counts_of_this_compiler() -> None:
    """Compare the data of docs/results.md; to renew: `neuroflight report --again board-timing.json`."""
    counts = re.findall(r"^instructions +(\S+)", figures.timing(""), re.MULTILINE)
    now = [int(count.replace(",", "")) for count in counts]
    stored = json.loads((ROOT / "docs/results/board-timing.json").read_text())["board_timing"][0]
    seeds = json.loads((ROOT / "docs/results/study-seeds.json").read_text())["runs"]
    assert [stored["instructions"]["worst"]] == now
    assert {run["outcome"]["instructions"] for run in seeds} == set(now)
