"""Comparisons of controllers whose differences are known, and `neuroflight compare` as a user types it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from neuroflight.cli.compare.figures import means_document
from neuroflight.cli.main import main
from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.analysis.metrics import Tracking
from neuroflight.sim.analysis.spectrum import Spectrum
from neuroflight.training.evaluation.comparison import (
    change_percent,
    curves,
    differences,
    enter,
    means,
    percent,
)
from neuroflight.training.evaluation.comparison_plot import draw_comparison
from neuroflight.training.evaluation.controllers import Conditions, ControllerSpec, load_controller
from neuroflight.training.evaluation.evaluation import Flights, Scores, scores
from neuroflight.training.tasks.task import EnvelopeTask, PulseTask
from tests.training.evaluation.constant import Constant

Capture = pytest.CaptureFixture[str]
NF1 = load_aircraft("nf1")
STEP_S = 0.001
NO_SPECTRUM = Spectrum(np.empty(0), np.empty(0))


def constant(level: float) -> ControllerSpec:
    return ControllerSpec("constant", lambda count: Constant(count, level), 1000, 0.0, {})


def off_by(error_deg_s: NDArray[np.float64]) -> Flights:
    """Commands of 100 deg/s with constant errors (E,) after a first sample at rest."""
    setpoint = np.full((len(error_deg_s), 2000, 3), np.deg2rad(100.0), np.float32)
    rate = setpoint - np.deg2rad(error_deg_s)[:, None, None].astype(np.float32)
    rate[:, 0] = 0.0
    return Flights(setpoint, rate, np.zeros((len(error_deg_s), 2000, 4), np.float32), STEP_S)


def figures(mae: NDArray[np.float64], change: NDArray[np.float64]) -> Scores:
    """Scores (E,) with those figures; the same on all axes."""
    each = np.repeat(mae[:, None], 3, axis=1)
    return Scores(Tracking(*(each for _ in range(6))), change, change, change, NO_SPECTRUM, None)


def test_difference_is_the_errors_when_these_stand_still() -> None:
    errors = np.random.default_rng(3).uniform(1.0, 4.0, 40)
    first, other = scores(off_by(errors)), scores(off_by(errors + 2.0))
    found = differences(first, other)
    assert float(found["mae"].value) == pytest.approx(2.0 * 1999 / 2000, rel=1e-5)
    assert float(found["mae"].high - found["mae"].low) < 1e-4  # where the means are sure to 0.5
    assert found["mae"].significant
    assert not found["output"].significant
    assert float(found["steady_bare"].value) == 0.0


def test_difference_of_shares_counts_the_commands_that_one_of_them_loses() -> None:
    errors = np.full(40, 1.0)
    worse = errors.copy()
    worse[:10] = 30.0
    found = differences(scores(off_by(errors)), scores(off_by(worse)))
    for name in ("success", "all_in_band_500", "steady", "steady_bare"):
        assert float(found[name].value) == pytest.approx(-0.25)
        assert found[name].significant


def test_percent_is_exact_and_sure_when_every_error_is_a_quarter_less() -> None:
    errors = np.random.default_rng(3).uniform(1.0, 40.0, 50)
    found = percent(figures(errors, np.zeros(50)), figures(0.75 * errors, np.zeros(50)))["mae"]
    assert [float(value) for value in (found.value, found.low, found.high)] == pytest.approx([-25.0] * 3)


def test_percent_covers_the_true_change_nineteen_times_in_twenty() -> None:
    rng = np.random.default_rng(6)
    hits = []
    for _ in range(2000):
        command = rng.gamma(4.0, 10.0, 60)
        first, other = command + rng.normal(0.0, 5.0, 60), 0.8 * command + rng.normal(0.0, 5.0, 60)
        found = change_percent(first, other)
        hits.append(float(found.low) <= -20.0 <= float(found.high))
    assert np.mean(hits) == pytest.approx(0.95, abs=0.015)


def test_there_is_no_percentage_of_no_error() -> None:
    assert not percent(figures(np.zeros(3), np.zeros(3)), figures(np.ones(3), np.zeros(3)))["mae"].count


def test_means_are_those_of_the_axes_when_they_differ() -> None:
    tracked = figures(np.array([1.0, 2.0, 3.0]), np.array([0.1, 0.2, 0.6]))
    tracked = replace(tracked, tracking=replace(tracked.tracking, mae=np.array([[0.0, 1.0, 2.0]] * 3)))
    found = means(tracked)
    assert (float(found["mae"].value), float(found["mae"].high)) == (1.0, 1.0)
    assert float(found["change"].value) == pytest.approx(0.3)
    assert "success" not in found


def test_document_has_a_difference_only_when_there_is_another_to_differ_from() -> None:
    flown = Conditions(NF1, EnvelopeTask(), episodes=3, seed=2)
    first, other = (enter(constant(level), flown, 0.0) for level in (0.1, 0.3))
    assert set(means_document(first, first)) == {"means"}
    told = means_document(other, first)
    difference = told["difference"]
    assert isinstance(difference, dict)
    assert difference["output"]["value"] == pytest.approx(0.2)
    assert difference["output"]["significant"] is True
    json.dumps(told, allow_nan=False)


def test_entries_fly_the_same_commands_and_noise_when_compared() -> None:
    flown = Conditions(NF1, PulseTask(idle_s=0.0, command_s=1.0, rest_s=0.0), episodes=3, seed=2)
    one, two = (flown.fly(load_controller("pid:tuned", NF1), 0.0) for _ in range(2))
    assert np.array_equal(one.rate, two.rate)
    found = differences(scores(one), scores(two))
    assert not any(mean.significant for mean in found.values())


def test_curves_are_percentiles_over_the_commands() -> None:
    drawn = curves(off_by(np.arange(101.0) / 10))
    assert drawn.error[:, 1] == pytest.approx([0.5, 5.0, 9.5], rel=1e-4)
    assert drawn.error[:, 0] == pytest.approx([100.0] * 3, rel=1e-4)
    assert drawn.step[:, 1, 5] == pytest.approx([90.5, 95.0, 99.5], rel=1e-4)
    assert drawn.step_t[-1] < 0.6


def test_plot_has_a_line_for_each_in_every_panel() -> None:
    flown = Conditions(NF1, EnvelopeTask(), episodes=3, seed=2)
    entries = [enter(load_controller(name, NF1), flown, 0.0) for name in ("pid:tuned", "pid:published")]
    panels = draw_comparison(entries, "title").axes
    assert [panel.get_title(loc="left").split(",")[0] for panel in panels] == [
        *("roll", "pitch", "yaw"),
        *("error", "spectrum of the motors"),
        *("PID tuned: first command [deg/s]", "PID published: first command [deg/s]", ""),
        *("PID tuned: motors", "PID published: motors", ""),
    ]
    for panel in panels[:5]:
        lines = [line for line in panel.lines if not str(line.get_label()).startswith("_")]
        assert [str(line.get_label()).split(",")[0] for line in lines] == ["PID tuned", "PID published"]
    drawn = np.asarray(panels[3].lines[0].get_ydata())
    assert drawn == pytest.approx(np.maximum(entries[0].curves.error[1], 0.1))
    spectrum = np.asarray(panels[4].lines[1].get_ydata())
    assert spectrum == pytest.approx(100 * entries[1].evaluation.spectrum.amplitude)
    for entry, rates, motors in zip(entries, panels[5:], panels[8:], strict=False):
        example = entry.curves.example
        assert example.motors is not None
        pitch = [line for line in rates.lines if line.get_label() == "pitch"]
        assert np.asarray(pitch[0].get_ydata()) == pytest.approx(example.rate[:, 1])
        assert np.asarray([line.get_ydata() for line in motors.lines]) == pytest.approx(example.motors.T)


def test_plot_has_no_responses_when_no_command_is_held() -> None:
    flown = Conditions(NF1, PulseTask(idle_s=0.0, command_s=0.1, rest_s=0.0), episodes=2, seed=2)
    panels = draw_comparison([enter(constant(0.1), flown, 0.0)], "title").axes
    assert len(panels) == 2 + 6  # error, spectrum, and the first command of up to three


def test_idle_is_the_controllers_own_unless_given(shipped_policy: Path) -> None:
    assert load_controller("pid:tuned", NF1).idle == dict(NF1.pids)["tuned"].idle > 0.0
    assert load_controller("pid:tuned", NF1, idle=0.1).idle == 0.1
    assert load_controller(str(shipped_policy), NF1, idle=0.25).idle == 0.25


def test_compare_prints_figures_differences_and_json(
    tmp_path: Path, shipped_policy: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "140")
    plot = tmp_path / "plot.png"
    words = ["compare", "pid:tuned", str(shipped_policy), "--task", "episodic", "--episodes", "4"]
    assert main([*words, "--throttle", "0", "0.3", "--plot", str(plot), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["command"] == (
        "neuroflight compare pid:tuned policy.onnx --aircraft nf1 --task episodic --episodes 4 --seed 0 "
        "--throttle 0 0.3"
    )
    assert [(entry["controller"], entry["throttle"]) for entry in told["comparison"]] == [
        ("pid:tuned", 0.0),
        (str(shipped_policy), 0.0),
        ("pid:tuned", 0.3),
        (str(shipped_policy), 0.3),
    ]
    pid, policy = told["comparison"][:2]
    assert "difference" not in pid
    assert policy["difference"]["mae"]["value"] == pytest.approx(
        policy["means"]["mae"]["value"] - pid["means"]["mae"]["value"]
    )
    assert np.mean(policy["mae"]) == pytest.approx(policy["means"]["mae"]["value"])
    assert len(pid["spectrum"]["amplitude"]) == len(pid["spectrum"]["frequency_hz"]) > 20
    assert plot.read_bytes().startswith(b"\x89PNG")
    assert main([*words, "--all"]) == 0
    table = capsys.readouterr().out
    assert f"{pid['means']['mae']['value']:.2f} ± " in table
    assert "less PID tuned" in table
    assert "every sample, %" in table
    least, above = (pid["means"][f"mae_{word}"]["value"] for word in ("least", "above"))
    assert pid["mae_least"] == pytest.approx(least)
    assert above > 0.0
    assert least + above == pytest.approx(np.mean(pid["mae"]))
    row = next(line for line in table.splitlines() if line.startswith("MAE, least possible"))
    assert f"{least:.2f} ± " in row


def test_compare_gives_the_figures_of_evaluate(capsys: Capture) -> None:
    words = ["pid:published", "--task", "envelope", "--episodes", "3", "--seed", "8", "--json"]
    assert main(["evaluate", *words]) == 0
    alone = json.loads(capsys.readouterr().out)
    assert main(["compare", *words]) == 0
    told = json.loads(capsys.readouterr().out)
    entry = told.pop("comparison")[0]
    entry.pop("means")
    entry.pop("envelope")
    assert alone.pop("command").replace(" --one", "") == told.pop("command")
    assert {**told, **entry} == alone
