"""Studies: listed variants, flown at equal thrust, in processes of this machine."""

import json
from pathlib import Path
from typing import Any

import pytest

from neuroflight.cli.main import main
from neuroflight.toolchain.errors import TrainingError
from neuroflight.training.sweeps.axes import VARIANT
from neuroflight.training.sweeps.config import Board, Sweep, load_sweep
from neuroflight.training.sweeps.jobs import SweepCallback, request_stop
from neuroflight.training.sweeps.run import run_sweep
from neuroflight.training.sweeps.summary import unfit
from neuroflight.training.sweeps.trial import Figure, Outcome

STUDIES = Path(__file__).parents[3] / "training" / "sweeps" / "studies"
VARIANTS = """
[[variant]]
name = "8"
[[variant]]
name = "16, noisy"
set = {hidden = [16], algorithm.change = 0.5, algorithm.change_limit = "none"}
"""
FILE = f"""
aircraft = "nf1"
[set]
steps = 1000
checkpoint_steps = 500
hidden = [8]
idle = 0.05
mix = "centred"
algorithm.name = "pathwise"
algorithm.aircraft = 2
algorithm.leg_steps = 400
task.idle_s = 0.05
task.command_s = 0.1
task.rest_s = 0.05
{VARIANTS}
[validation]
episodes = 3
thrust = [1, 2]
[board]
control_task_cycles = 9_000
other_cycles = 8_900
"""


def load(folder: Path, text: str) -> Sweep:
    path = folder / "study.toml"
    path.write_text('aircraft = "nf1"\n' + text)
    return load_sweep(path)


def test_runs_are_the_variants_with_their_overrides_when_they_are_listed(tmp_path: Path) -> None:
    sweep = load(tmp_path, f"[set]\nalgorithm.name = 'pathwise'\nhidden = [8]\n{VARIANTS}")
    assert [trial.folder for trial in sweep.trials] == ["1-8", "2-16-noisy"]
    assert [trial.config.hidden for trial in sweep.trials] == [(8,), (16,)]
    assert sweep.trials[1].varied == {VARIANT: "16, noisy"}
    assert sweep.baseline == "8"


def test_variants_are_repeated_with_each_point_of_the_grid_when_both_are_given(tmp_path: Path) -> None:
    text = "baseline = 'b'\n[[variant]]\nname = 'a'\n[[variant]]\nname = 'b'\n[vary]\nseed = [1, 2]\n"
    sweep = load(tmp_path, text)
    found = [(trial.varied[VARIANT], trial.config.seed) for trial in sweep.trials]
    assert found == [("a", 1), ("a", 2), ("b", 1), ("b", 2)]
    assert sweep.trials[0].configuration == sweep.trials[1].configuration
    assert sweep.baseline == "b"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("baseline = 'c'\n[[variant]]\nname = 'a'\n", "baseline: got 'c', expected one of: a"),
        ("baseline = 'a'\n[vary]\nseed = [1]\n", "baseline: unknown key"),
        ("[[variant]]\nname = 'a'\n[[variant]]\nname = 'a'\n", "variant.*name: 'a' for a second time"),
        ("[[variant]]\nset = {seed = 1}\n", "variant.*name: missing"),
        ("[[variant]]\nname = 'a'\nsets = {seed = 1}\n", "variant.*sets: unknown key"),
        ("[[variant]]\nname = 'a'\nset = 1\n", "variant.*set: got 1, expected a table"),
        ("[[variant]]\nname = 'a'\nset = {hiden = [8]}\n", r"run 1 \(variant a\): .*hiden"),
        (
            "[[variant]]\nname = 'a'\nset = {seed = 1}\n[vary]\nseed = [1]\n",
            r"variant 'a': set.seed: stands in \[vary\] too",
        ),
        ("[vary]\nseed = [1]\n[validation]\nthrust = [0.01]\n", "validation.thrust: got 0.01, expected 0.05"),
        (
            "[vary]\nseed = [1]\n[validation]\nthrust = [1]\nthrottle = 0.1\n",
            "throttle: stands beside thrust",
        ),
        ("[vary]\nseed = [1]\n[board]\nother_cycles = 3\n", "board.control_task_cycles: missing"),
    ],
)
def test_an_invalid_study_is_rejected_in_one_line(text: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(TrainingError, match=message) as caught:
        load(tmp_path, text)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["levers", "seeds", "sizes", "beta", "power", "recurrent"])
def test_shipped_studies_vary_the_recipe_or_are_short(name: str) -> None:
    sweep = load_sweep(STUDIES / f"{name}.toml")
    configs = [trial.config for trial in sweep.trials]
    short = all(config.steps <= 4_000_000 for config in configs)
    assert short == (name in ("beta", "power", "recurrent"))
    assert short or sweep.validation.thrust == (0.35, 1.0, 2.0, 4.0)
    assert sweep.trials[0].varied[VARIANT] == sweep.baseline
    assert len(set(configs)) == len(configs)
    if name == "sizes":
        widths = {config.hidden[0] for config in configs if config.recurrent == "none"}
        assert {8, 96} <= widths
        assert len(configs) >= 8
        assert any(config.recurrent == "gru" for config in configs)
    if name == "seeds":
        assert [config.seed for config in configs] == [1, 2, 3, 4, 5]


@pytest.mark.parametrize(
    ("weights", "cycles", "reason"),
    [
        (12_288, 13_000.0, None),
        (12_288, None, None),
        (12_289, None, "12,289 weights of 12,288"),
        (5_000, 14_001.0, "22,001 cycles of 22,000"),
    ],
)
def test_a_policy_says_why_the_board_cannot_fly_it(
    weights: int, cycles: float | None, reason: str | None
) -> None:
    figure = Figure(1.0, 0.1)
    outcome = Outcome(
        *(figure, figure, figure, figure),
        thrusts=(),
        instructions=None,
        predicted_cycles=cycles,
        no_cycles_reason=None,
        weights=weights,
        training_seconds=1.0,
        steps=1,
        policy_sha256="",
    )
    assert unfit(outcome, Board(22_000, 8_000)) == reason


class Stopping(SweepCallback):
    """Stops the sweep when its first run is done."""

    def __init__(self, out: Path) -> None:
        self._out = out
        self.done: list[int] = []

    def finished(self, number: int) -> None:
        self.done.append(number)
        request_stop(self._out)


@pytest.mark.slow
def test_a_study_that_was_stopped_goes_on_where_it_was(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, out = tmp_path / "study.toml", tmp_path / "out"
    path.write_text(FILE)
    stopping = Stopping(out)
    with pytest.raises(KeyboardInterrupt):
        run_sweep(load_sweep(path), out, cpus=1, callback=stopping)
    before = json.loads((out / "sweep.json").read_text())
    assert stopping.done == [1]
    assert [run["state"] for run in before["runs"]] == ["done", "open"]
    words = ["policy", "sweep", str(path), "--out", str(out), "--cpus", "1", "--resume"]
    assert main([*words, "--json"]) == 0
    record: dict[str, Any] = json.loads(capsys.readouterr().out)
    assert record["complete"] is True
    assert record["runs"][0] == before["runs"][0]
    for run in record["runs"]:
        outcome = run["outcome"]
        assert [each["asked"] for each in outcome["thrusts"]] == [None, 1.0, 2.0]
        closed, hover, twice = outcome["thrusts"]
        assert 0.4 < closed["current"]["mean"] < hover["current"]["mean"] < twice["current"]["mean"]
        assert hover["power"]["mean"] == pytest.approx(16.0 * hover["current"]["mean"], rel=1e-5)
        assert outcome["mae"]["mean"] == pytest.approx((hover["mae"]["mean"] + twice["mae"]["mean"]) / 2)
        assert hover["throttle"] < twice["throttle"]
    assert (out / "power.png").read_bytes().startswith(b"\x89PNG")
    assert main(words) == 0
    table = capsys.readouterr().out
    assert "16, noisy" in table
    assert "by thrust at rest" in table
    assert "Mean current and electric power" in table
