"""The engine of `neuroflight compare`: an evaluation that is a single class; tables that fit the screen."""

from __future__ import annotations

import json
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import pytest

from neuroflight.cli.compare import compare
from neuroflight.cli.compare.suite import Bar, Seed, Suite, SuiteResult
from neuroflight.cli.main import main
from neuroflight.cli.report import Table, print_table
from neuroflight.cli.requests import Option

Capture = pytest.CaptureFixture[str]


@dataclass(frozen=True, kw_only=True)
class Resting(Suite):
    """Rates without any command."""

    names = ("resting",)
    seconds: Annotated[float, Option("S", "of rest", low=0.1, high=1.0)] = 0.2
    seed: Seed = 3

    def fly(self, bar: Bar, ends: ExitStack) -> SuiteResult:
        """Let everybody rest, two aircraft each."""
        import numpy as np
        from matplotlib.figure import Figure

        from neuroflight.sim.aircraft.model import load_aircraft
        from neuroflight.training.evaluation.controllers import Conditions
        from neuroflight.training.tasks.task import EpisodicTask

        aircraft = load_aircraft(self.aircraft)
        still = EpisodicTask(distribution="normal", sigma_deg_s=0.0, hold_s=self.seconds)
        flown = Conditions(aircraft, still, 2, self.seed)
        rates = {
            each.label: float(np.abs(np.rad2deg(flown.fly(each, 0.3, bar(each.label)).rate)).mean())
            for each in self.opened(aircraft, ends)
        }
        rows = [("", "deg/s"), *((label, f"{rate:.3f}") for label, rate in rates.items())]
        return SuiteResult(
            request=self,
            aircraft=aircraft,
            document=lambda: {"rates": rates},
            tables=lambda: [Table("at rest", rows, "means of the axes")],
            pictures={"plot": Figure},
        )


@pytest.fixture(autouse=True)
def resting(monkeypatch: pytest.MonkeyPatch) -> None:
    """The suite, as a file of cli/compare/suites would bring it."""
    monkeypatch.setitem(compare.SUITES, "resting", Resting)


def test_an_evaluation_of_one_class_is_parsed_flown_told_and_drawn(tmp_path: Path, capsys: Capture) -> None:
    words = ["compare", "pid:flying", "pid:tuned", "--suite", "resting", "--seconds", "0.3"]
    assert main([*words, "--plot", str(tmp_path / "a.png"), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["command"] == (
        "neuroflight compare pid:flying pid:tuned --suite resting --aircraft nf1 --seconds 0.3 --seed 3"
    )
    assert list(told["rates"]) == ["PID flying", "PID tuned"]
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    assert main(told["command"].split()[1:]) == 0
    out = capsys.readouterr().out
    assert "at rest" in out and f"PID tuned   {told['rates']['PID tuned']:.3f}" in out


def test_its_options_are_checked_as_all_others_are(capsys: Capture) -> None:
    assert main(["compare", "pid", "--suite", "resting", "--seconds", "2"]) == 1
    assert "--seconds 2, expected 0.1 to 1" in capsys.readouterr().err
    with pytest.raises(SystemExit, match="2"):
        main(["compare", "pid", "--suite", "resting", "--draws", "2"])
    assert "unrecognized arguments: --draws 2" in capsys.readouterr().err
    with pytest.raises(SystemExit, match="2"):
        main(["compare", "pid", "--suite", "nothing"])
    assert "resting" in capsys.readouterr().err  # among those that there are


@pytest.mark.parametrize(("suite", "option"), [("resting", "--seconds"), ("robustness", "--draws")])
def test_help_is_of_the_suite_that_is_asked_for(suite: str, option: str, capsys: Capture) -> None:
    with pytest.raises(SystemExit, match="0"):
        main(["compare", "--suite", suite, "--help"])
    told = capsys.readouterr().out
    assert option in told and "--thrust" not in told


def test_a_table_wider_than_the_screen_is_printed_in_parts_with_every_digit(
    monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.setenv("COLUMNS", "40")
    cells = [f"{number}1234.5678 ± 0.0001" for number in range(4)]
    print_table("title", [("", *"abcd"), ("a figure", *cells)], "a note")
    out = capsys.readouterr().out
    assert all(cell in out for cell in cells)
    assert max(map(len, out.splitlines())) <= 40
    assert out.count("a figure") == 4 and out.count("title") == 1
