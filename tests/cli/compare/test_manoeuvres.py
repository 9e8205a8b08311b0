"""`neuroflight manoeuvres` as a user types it; and who may fly by eye."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from neuroflight.cli.main import main
from neuroflight.sim.analysis.manoeuvre import ManoeuvreFigures
from neuroflight.sim.analysis.stick_flight import DescentFigures
from neuroflight.sim.flight.manoeuvres import MANOEUVRES, Manoeuvre, ThrustCurve
from neuroflight.training.evaluation import manoeuvres_plot
from neuroflight.training.evaluation.manoeuvres import Pilot
from neuroflight.training.results_page.page import render
from neuroflight.training.results_page.stored_results import Stored

Capture = pytest.CaptureFixture[str]
TUNED, PUBLISHED = "pid:tuned", "pid:published"


def flown(pilot: Pilot, manoeuvre: Manoeuvre, curve: ThrustCurve, seed: int, *_: Any) -> ManoeuvreFigures:
    """The tuned one has the smaller error but in the flip; in the roll it is chance."""
    better = (pilot.controller.name == TUNED) != (manoeuvre.name == "flip")
    error = 10.0 + seed + (0.0 if better else 1.0)
    if manoeuvre.name == "roll":
        error = 10.0 + (0.0 if better else 0.1) + (seed % 2 if better else 0)
    return ManoeuvreFigures(
        error, error**2, curve.throttle_of(1.0), pilot.air.gust, 4.0, 1.5, 0.004, 0.5, 0.9, 3.25, 2.5
    )


@pytest.fixture
def in_no_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Flights that are over at once."""
    curve = ThrustCurve((0.0, 0.15, 0.3, 0.6, 1.0), (0.25, 0.5, 1.0, 3.0, 6.0))
    monkeypatch.setattr(Pilot, "curve", lambda *_: curve)
    monkeypatch.setattr(Pilot, "manoeuvre", flown)
    monkeypatch.setattr(Pilot, "descent", lambda *_: DescentFigures(17.5, 100.0, 2.0))


@pytest.mark.usefixtures("in_no_time")
def test_it_tells_who_wins_each_manoeuvre_and_how_surely(capsys: Capture) -> None:
    assert main(["manoeuvres", PUBLISHED, TUNED, "--seeds", "4", "--seed", "2", "--gust", "5", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["command"] == (
        "neuroflight compare pid:published pid:tuned --suite manoeuvres --aircraft nf1 --seeds 4 --seed 2 "
        "--battery 0.9 --gust 5"
    )
    told = document["manoeuvres"]
    first, second = told["contenders"]
    assert (told["seeds"], told["descents"]) == (4, 3)
    assert list(first["figures"]) == [each.name for each in MANOEUVRES]
    assert first["figures"]["flip"]["wins"] == ["mae", "mse"] == first["figures"]["flip"]["clear_wins"]
    assert second["figures"]["punch-out"]["clear_wins"] == ["mae", "mse"]
    assert second["figures"]["punch-out"]["mae"]["value"] == 13.5  # of seeds 2 to 5
    assert second["figures"]["punch-out"]["difference"]["mae"]["value"] == -1.0
    assert first["figures"]["roll"]["wins"] == ["mae", "mse"]
    assert first["figures"]["roll"]["clear_wins"] == []
    assert first["figures"]["roll"]["overshoot"]["value"] == 0.3
    assert second["descent"]["sink_m_s"]["value"] == 17.5
    page = render([Stored("manoeuvres-1.json", document)])
    assert (
        "Won of 6: PID `published`: 2 in MAE, 2 in MSE; PID `tuned`, idle 0.23: 4 in MAE, 4 in MSE." in page
    )


@pytest.mark.usefixtures("in_no_time")
def test_the_table_marks_wins(capsys: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "120")
    assert main(["manoeuvres", TUNED, PUBLISHED, "--seeds", "3"]) == 0
    out = capsys.readouterr().out
    assert "** 12.00" in out
    assert "dive-recovery" in out
    assert "17.5" in out


@pytest.mark.usefixtures("in_no_time")
def test_the_plot_shows_the_first_flights_of_roll_and_split_s(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    drawn = []

    def traced(pilot: Pilot, *_: Any) -> SimpleNamespace:
        t = np.arange(0.0, 3.0, 0.01)
        setpoint = np.zeros((len(t), 3))
        setpoint[120:150, 0] = np.deg2rad(720.0)
        off = np.deg2rad(5.0 if pilot.controller.name == TUNED else 8.0)
        return SimpleNamespace(t=t, setpoint=setpoint, rate=setpoint + off)

    def drawing(flights: list[manoeuvres_plot.Shown], title: str) -> Figure:
        drawn.extend(flights)
        return draw(flights, title)

    draw = manoeuvres_plot.draw
    monkeypatch.setattr(Pilot, "trace", traced)
    monkeypatch.setattr(manoeuvres_plot, "draw", drawing)
    plot = tmp_path / "manoeuvres.png"
    assert main(["manoeuvres", TUNED, PUBLISHED, "--seeds", "1", "--plot", str(plot), "--json"]) == 0
    assert plot.read_bytes().startswith(b"\x89PNG")
    assert [(one.manoeuvre, one.label, round(one.mae, 6)) for one in drawn] == [
        ("roll", "PID tuned", 5.0),
        ("roll", "PID published", 8.0),
        ("split-s", "PID tuned", 5.0),
        ("split-s", "PID published", 8.0),
    ]


def test_a_flight_by_eye_is_refused_where_there_is_no_ground_or_no_twin(capsys: Capture) -> None:
    assert main(["fly", "--scenario", "sticks", "--on", "reference"]) == 1
    assert "takes off and lands; add --ground" in capsys.readouterr().err


@pytest.mark.slow
def test_both_pids_fly_all_manoeuvres(capsys: Capture) -> None:
    assert main(["manoeuvres", TUNED, PUBLISHED, "--seeds", "2", "--json"]) == 0
    tuned, published = json.loads(capsys.readouterr().out)["manoeuvres"]["contenders"]
    for one in (tuned, published):
        assert all(0 < each["mae"]["value"] < 60 for each in one["figures"].values())
        assert sorted(one["thrust_at_rest"]) == one["thrust_at_rest"]
    assert tuned["figures"]["roll"]["mae"]["value"] < published["figures"]["roll"]["mae"]["value"]
    assert published["descent"]["sink_m_s"]["value"] > tuned["descent"]["sink_m_s"]["value"] > 0
