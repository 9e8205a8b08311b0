"""Plots of a recording and of a fit show the right curves in the right units."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from neuroflight.sim.aircraft.model import RPM, load_aircraft
from neuroflight.sim.identification.dyno.bench import (
    RAMP,
    STEPS,
    Phase,
    disturbed,
    duration,
    run,
    sample_times,
)
from neuroflight.sim.identification.dyno.fit import fit
from neuroflight.sim.identification.dyno.plot import draw_fit, draw_recording
from neuroflight.sim.identification.dyno.recording import Recording

NF1 = load_aircraft("nf1").propulsion


def record(experiment: tuple[Phase, ...]) -> Recording:
    recording = run(NF1, experiment, sample_times(duration(experiment), 100))
    return disturbed(recording, np.random.default_rng(1), noise=0.01, outliers=0.01)


def test_recording_shows_each_channel_in_its_unit_when_drawn() -> None:
    recording = record(STEPS)
    throttle, speed, thrust, torque = draw_recording(recording, "title").axes
    assert np.asarray(throttle.lines[0].get_ydata()).max() == 100
    assert speed.lines[0].get_ydata() == pytest.approx(recording.speed / RPM)
    assert thrust.lines[0].get_ydata() == pytest.approx(recording.thrust)
    assert [axes.get_ylabel() for axes in (throttle, speed, thrust, torque)] == ["%", "rpm", "N", "N m"]


def test_fit_shows_model_residuals_curves_and_steps_when_drawn() -> None:
    found = fit(record(STEPS))
    panels = draw_fit(found, "title").axes
    assert len(panels) == 11
    speed, left = panels[0], panels[1]
    assert [line.get_label() for line in speed.lines] == ["data", "model", "outlier"]
    assert speed.lines[1].get_ydata() == pytest.approx(found.speed / RPM)
    kept = ~found.outliers[0]
    assert left.lines[0].get_ydata() == pytest.approx(((found.recording.speed - found.speed) / RPM)[kept])
    titles = [panel.get_title(loc="left") for panel in panels]
    assert f"K_T = {found.thrust_coefficient[0].value:.3g} N s²/rad²" in titles
    up = panels[titles.index("steps up: data and model")]
    assert [line.get_label() for line in up.lines[1::2]] == [f"0 to {part} %" for part in (25, 50, 75, 100)]
    assert len(draw_fit(replace(found, torque_ratio=()), "a stand without torque").axes) == 8


def test_fit_leaves_steps_out_when_there_are_none() -> None:
    titles = [panel.get_title(loc="left") for panel in draw_fit(fit(record(RAMP)), "title").axes]
    assert len(titles) == 9
    assert not any("steps" in title for title in titles)
