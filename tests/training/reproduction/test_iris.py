"""Chapter 3's aircraft: its PID has the figures that the dissertation prints."""

from __future__ import annotations

from pathlib import Path

import pytest

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.training.dissertation.quotes import quotes
from neuroflight.training.evaluation.controllers import Conditions, load_controller
from neuroflight.training.evaluation.evaluation import scores, summary
from neuroflight.training.tasks.task import EpisodicTask

AIRCRAFT = Path(__file__).parents[3] / "training" / "reproduction" / "iris-3.toml"
TABLES = {"3.9": "rise_ms", "3.10": "peak", "3.11": "error"}


def test_the_pid_has_the_nine_printed_figures_of_the_best_agents_tables() -> None:
    aircraft = load_aircraft(AIRCRAFT)
    pid = load_controller("pid:published", aircraft)
    conditions = Conditions(aircraft, EpisodicTask(limit_deg_s=300.0), 400, 11)
    response = summary(scores(conditions.fly(pid, 0.0))).response
    assert response is not None
    for table, name in TABLES.items():
        printed = quotes().axes(f"{table}/pid")
        found = getattr(response, name).value
        assert found == pytest.approx(printed, rel=0.18), name  # thrust alone is fitted to them
