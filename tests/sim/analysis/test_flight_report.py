from __future__ import annotations

import base64
import dataclasses
import io
import re
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

from neuroflight.sim.analysis.flight_report import Flight, draw_flights, save_report, table
from neuroflight.sim.analysis.metrics import figures
from tests.sim.flight.traces import trace_of


def make_flight(name: str, steps: int = 3000, error_deg_s: float = 2.0) -> Flight:
    t = np.arange(steps) / 1000
    setpoint = np.where((t > 0.5)[:, None], np.deg2rad([100.0, -40.0, 0.0]), 0.0).astype(np.float32)
    trace = trace_of(setpoint, setpoint - np.deg2rad(error_deg_s), setpoint)
    return Flight(name, trace, figures(trace))


def test_table_stands_the_flights_side_by_side_when_there_are_two() -> None:
    rows = {row[0].strip(): row[1:] for row in table([make_flight("firmware"), make_flight("PID", 500, 3.0)])}
    assert rows[""] == ("firmware", "PID")
    assert rows["MAE, deg/s"] == ("2.00 / 2.00 / 2.00", "3.00 / 3.00 / 3.00")
    assert rows["mean of the axes"] == ("2.00", "3.00")
    assert rows["against the gyro"] == ("0.00 / 0.00 / 0.00", "0.00 / 0.00 / 0.00")
    assert rows["IAE"][0] == "2,000 / 2,000 / 2,000"
    assert rows["mean output ū"] == ("0.250", "0.250")
    assert rows["armed"] == ("100.0 %", "100.0 %")


def test_table_has_the_response_figures_when_commands_are_held() -> None:
    held, brief = make_flight("firmware"), make_flight("PID", 1200)
    rows = {row[0].strip(): row[1:] for row in table([held, brief])}
    # Off by 2 deg/s from the first sample on: in the band, and none of it is risen.
    assert rows["success, %"] == ("100.0 / 100.0 / 100.0", "-")
    assert rows["rise, ms"] == ("0.0 / 0.0 / 0.0", "-")
    assert "success, %" not in {row[0] for row in table([brief])}


def test_armed_is_the_part_before_the_motors_stopped_when_the_receiver_was_lost() -> None:
    flight = make_flight("firmware", 1000)
    dshot = flight.trace.dshot.copy()
    dshot[600:] = 0
    stopped = dataclasses.replace(flight, trace=dataclasses.replace(flight.trace, dshot=dshot))
    assert stopped.armed == 0.6


def test_plot_shows_setpoint_and_rates_of_each_flight_when_drawn() -> None:
    picture = draw_flights([make_flight("firmware"), make_flight("PID")], "title")
    roll, pitch, yaw, error, motors = picture.axes
    assert [line.get_label() for line in roll.lines] == ["setpoint", "firmware", "PID"]
    assert np.asarray(roll.lines[1].get_ydata())[-1] == pytest.approx(98)
    assert np.asarray(pitch.lines[0].get_ydata())[-1] == pytest.approx(-40)
    assert np.asarray(yaw.lines[2].get_ydata())[-1] == pytest.approx(-2)
    assert [line.get_label() for line in error.lines] == ["roll", "pitch", "yaw"]
    assert error.lines[0].get_ydata() == pytest.approx(np.full(3000, 2.0))
    names = ["1 rear right", "2 front right", "3 rear left", "4 front left"]
    assert [line.get_label() for line in motors.lines[1::2]] == names
    assert motors.lines[1].get_ydata() == pytest.approx(np.full(3000, 25.0))


def test_plot_shows_all_of_an_oscillation_that_nobody_commands() -> None:
    yaw = draw_flights([make_flight("firmware", error_deg_s=100.0)], "title").axes[2]
    low, high = yaw.get_ylim()
    assert low < -100.0 and high > 0.0  # of a setpoint of 0


def test_plot_shows_the_beginning_when_the_flight_is_long() -> None:
    picture = draw_flights([make_flight("firmware", 20_000)], "title")
    assert np.asarray(picture.axes[0].lines[0].get_xdata())[-1] == pytest.approx(13.5, abs=0.01)


def test_plot_draws_when_the_flight_is_a_single_step() -> None:
    draw_flights([make_flight("firmware", 1)], "title").draw_without_rendering()  # type: ignore[no-untyped-call]


def test_report_needs_no_other_file_when_written(tmp_path: Path) -> None:
    save_report(tmp_path / "a.html", [make_flight("firmware"), make_flight("PID")], "a <b> & c", "note")
    text = (tmp_path / "a.html").read_text()
    assert "a &lt;b&gt; &amp; c" in text
    assert "<td>MAE, deg/s</td><td>2.00 / 2.00 / 2.00</td>" in text
    sources = re.findall(r'(?:src|href)="([^"]*)"', text)
    assert len(sources) == 1
    head, data = sources[0].split(",", 1)
    assert head == "data:image/png;base64"
    picture = matplotlib.image.imread(io.BytesIO(base64.b64decode(data)))
    assert picture.std() > 0.05
