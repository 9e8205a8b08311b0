"""The table of robustness: its cases, its figures, its errors."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from neuroflight.cli.main import main
from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.training.config.randomization import Randomization
from neuroflight.training.evaluation.controllers import ControllerSpec, load_controller
from neuroflight.training.evaluation.evaluation import Flights
from neuroflight.training.evaluation.robustness import (
    RobustnessPlan,
    episode_figures,
    examine,
    quantile_of,
    ratio_of,
)
from neuroflight.training.tasks.flight import Course, FlightTask
from neuroflight.training.tasks.task import PulseTask

NF1 = load_aircraft("nf1")
SHORT = PulseTask(idle_s=0.05, command_s=0.15, rest_s=0.05)
TINY = PulseTask(idle_s=0.01, command_s=0.04, rest_s=0.01)
PLAN = RobustnessPlan(aircraft=NF1, task=SHORT, episodes=6, draws=0, seed=5, throttle_max=0.8)
Capture = pytest.CaptureFixture[str]


def pid(name: str = "pid") -> ControllerSpec:
    return load_controller(name, NF1)


def flights(rate: np.ndarray, output: np.ndarray | None = None) -> Flights:
    """One episode of 10 deg/s about roll."""
    steps = len(rate)
    setpoint = np.zeros((1, steps, 3), np.float32)
    setpoint[..., 0] = np.deg2rad(10.0)
    y = np.zeros((1, steps, 4), np.float32) if output is None else output[None].astype(np.float32)
    return Flights(setpoint, rate[None].astype(np.float32), y, 0.001)


def test_a_weaker_answer_shows_in_the_case_that_makes_it_and_nowhere_else() -> None:
    result = examine(pid(), PLAN)
    ratio = {each.case.name: float(each.ratio.value) for each in result.cases}
    assert result.joint is None
    assert ratio["nominal"] == 1.0
    assert ratio["mass x 1.2"] == 1.0  # held at its centre of mass
    assert ratio["inertia x 1.3"] > 1.02 > 0.98 > ratio["inertia x 0.7"]
    assert ratio["lag x 2"] > 1.1
    assert ratio["delay 6 ms"] > ratio["delay 0 ms"]
    assert ratio["battery full"] != pytest.approx(ratio["battery empty"], abs=0.02)
    assert result.cases[0].mae.value > 1.0


def test_the_same_seed_gives_the_same_table_and_each_controller_the_same_commands() -> None:
    plan = replace(PLAN, task=TINY, draws=4)
    first, again = examine(pid(), plan), examine(pid(), plan)
    other = examine(pid(), replace(plan, seed=6))
    assert first.joint is not None
    assert again.joint is not None
    assert other.joint is not None
    assert np.array_equal(first.joint.ratios, again.joint.ratios)
    assert not np.array_equal(first.joint.ratios, other.joint.ratios)
    assert len(first.joint.ratios) == 4
    assert first.joint.ratios.std() > 1e-3
    assert [each.change for each in first.cases] == [each.change for each in again.cases]


@pytest.mark.parametrize(
    ("rate_deg_s", "lost"),
    [
        (0.0, False),  # never turns: as bad as doing nothing, not worse
        (10.0, False),
        (-15.0, False),  # 8.3 deg/s over three axes: below the floor
        (-80.0, True),
        (2500.0, True),
        (np.nan, True),
    ],
)
def test_an_episode_diverges_as_defined(rate_deg_s: float, lost: bool) -> None:
    rate = np.zeros((100, 3))
    rate[:, 0] = np.deg2rad(rate_deg_s)
    assert episode_figures(flights(rate)).diverged.tolist() == [lost]


def test_one_sample_beyond_the_gyro_is_divergence() -> None:
    rate = np.zeros((1000, 3))
    rate[500, 2] = np.deg2rad(-2001.0)
    assert episode_figures(flights(rate)).diverged.tolist() == [True]


def test_figures_of_an_episode_are_those_of_its_samples() -> None:
    output = np.zeros((5, 4))
    output[1::2] = 0.4
    figures = episode_figures(flights(np.zeros((5, 3)), output))
    assert figures.mae == pytest.approx([10.0 / 3])
    assert figures.output == pytest.approx([0.16])
    assert figures.change == pytest.approx([0.4])


@pytest.mark.parametrize(("drift_deg_s", "lost"), [(8.9, False), (-9.1, True), (np.nan, True)])
def test_a_flight_diverges_when_it_drifts_farther_than_on_its_side(drift_deg_s: float, lost: bool) -> None:
    rate = np.zeros((15_000, 3))
    rate[:5000, 0] = np.deg2rad(4.0)  # of the five commands of 10 deg/s
    rate[5000:, 2] = np.deg2rad(drift_deg_s)
    flown = flights(rate)
    flown.setpoint[:, 5000:] = 0.0
    figures = episode_figures(replace(flown, course=Course(5, 10.0)))
    assert figures.mae == pytest.approx([2.0])
    assert figures.drift == pytest.approx([abs(drift_deg_s) * 10.0], nan_ok=True)
    assert figures.diverged.tolist() == [lost]


@pytest.mark.slow
def test_flights_are_flown_once_a_draw_and_tell_their_drift(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick = FlightTask(pulses=5, idle_s=0.0, command_s=0.1, rest_s=0.1, hover_s=10.0)
    monkeypatch.setattr("neuroflight.training.evaluation.robustness.FLIGHT", quick)
    monkeypatch.setattr("neuroflight.training.evaluation.robustness.EXTREMES", Randomization(lag=(1.0, 2.0)))
    words = ["robustness", "pid:tuned", "--episodes", "10", "--draws", "2", "--seed", "3"]
    assert main([*words, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert "--aircraft nf1 --task flight --episodes 10 --seed 3" in document["command"]
    told = document["robustness"]
    assert (told["task"], told["episodes"], told["draws"]) == ("flight", 10, 2)
    assert "a drift of more than 90 deg in 10 s of hover" in told["divergence"]
    (tuned,) = told["controllers"]
    assert set(tuned["cases"]) == {"nominal", "lag x 2", "vibration 25 deg/s"}
    assert 0.0 < tuned["cases"]["nominal"]["drift"] < 30.0  # [deg], a gyro's bias in ten seconds
    assert len(tuned["joint"]["ratios"]) == 2
    assert main([*words, "--draws", "0"]) == 0
    printed = capsys.readouterr().out
    assert "2 flights of 5 commands and a hover a case" in printed
    assert "drift, °" in printed


def test_a_ratios_interval_holds_the_true_ratio() -> None:
    """The interval holds the true ratio in 95 of 100 cases."""
    rng = np.random.default_rng(0)
    held = 0
    for _ in range(400):
        whole = rng.gamma(4.0, 1.0, 60)
        part = 1.5 * whole * np.exp(rng.normal(-0.02, 0.2, 60))
        ratio = ratio_of(part, whole)
        held += bool(ratio.low <= 1.5 <= ratio.high)
    assert 0.92 < held / 400 < 0.98


@pytest.mark.parametrize(("q", "true"), [(0.5, np.log(2.0)), (0.95, np.log(20.0))])
def test_a_quantiles_interval_holds_the_true_quantile(q: float, true: float) -> None:
    rng = np.random.default_rng(1)
    intervals = [quantile_of(rng.exponential(1.0, 200), q) for _ in range(400)]
    held = np.mean([each.low <= true <= each.high for each in intervals])
    assert 0.93 < held < 0.99
    assert np.mean([each.value for each in intervals]) == pytest.approx(true, rel=0.05)
    assert all(each.low <= each.value <= each.high for each in intervals)
    few = quantile_of(np.array([3.0, 1.0, 2.0]), q)
    assert float(few.high) == 3.0


def test_prints_a_table_and_the_same_as_json(
    tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("neuroflight.training.tasks.task.PulseTask", lambda: TINY)
    plot = tmp_path / "plot.png"
    words = ["robustness", "pid:tuned", "pid:published", "--task", "pulse", "--episodes", "4", "--draws", "5"]
    words += ["--seed", "3"]
    assert main([*words, "--json", "--plot", str(plot)]) == 0
    document = json.loads(capsys.readouterr().out)
    assert plot.read_bytes().startswith(b"\x89PNG")
    assert document["command"] == (
        "neuroflight compare pid:tuned pid:published --suite robustness --aircraft nf1 --task pulse "
        "--episodes 4 --seed 3 --throttle-max 0.8 --draws 5"
    )
    assert document["aircraft_sha256"] == NF1.sha256
    told = document["robustness"]
    assert told["bars"] == {"case": 2.0, "median": 1.5, "high": 2.5}
    tuned, published = told["controllers"]
    assert (tuned["label"], tuned["idle"], published["idle"]) == ("PID tuned", 0.23, 0.0)
    assert set(tuned["cases"]) == set(published["cases"])
    assert len(tuned["joint"]["ratios"]) == 5
    case = tuned["cases"]["lag x 2"]
    assert case["ratio"]["low"] < case["ratio"]["value"] < case["ratio"]["high"]
    assert main(["robustness", "pid:tuned", *words[3:]]) == 0
    table = capsys.readouterr().out
    line = next(line for line in table.splitlines() if line.startswith("lag x 2"))
    assert f"{case['ratio']['value']:.2f}" in line
    assert "diverged of the draws" in table
