"""The plot of step responses agrees with the figures."""

from __future__ import annotations

import numpy as np
import pytest

from neuroflight.sim.analysis.response import Hold, hold, response_figures
from neuroflight.sim.analysis.response_plot import draw_response
from neuroflight.sim.analysis.spectrum import Spectrum
from neuroflight.sim.analysis.spectrum_plot import Line

LINE = Line("PID", Spectrum(np.array([1.0, 10.0, 100.0]), np.array([0.02, 0.01, 0.001])), 3.4e-5)


def lags(command: np.ndarray, tau: float = 0.05) -> Hold:
    t = np.arange(1500) / 1000
    rate = (1 - np.exp(-t / tau))[None, :, None] * np.deg2rad(command)[:, None]
    found = hold(np.broadcast_to(np.deg2rad(command)[:, None], rate.shape), rate, 0.001)
    assert found is not None
    return found


def test_plot_shows_median_and_figures_of_each_axis_when_drawn() -> None:
    held = lags(np.random.default_rng(1).uniform(20, 200, (50, 3)))
    figure = draw_response(held, response_figures(held), LINE, "title")
    *axes, band, spectrum = figure.axes
    assert [panel.get_title(loc="left") for panel in axes] == ["roll", "pitch", "yaw"]
    for panel in axes:
        median = next(line for line in panel.lines if line.get_label() == "median")
        assert np.asarray(median.get_xdata())[[50, -1]] == pytest.approx([50.0, 999.0])
        assert np.asarray(median.get_ydata())[50] == pytest.approx(63.2, abs=0.1)
        words = panel.texts[0].get_text()
        assert "success 100.0 %" in words
        assert f"rise {50 * np.log(9):.1f} ms" in words
        assert "n = 50" in words
    share = np.asarray(band.lines[0].get_ydata())
    assert (share[0], share[-1]) == (0.0, 100.0)
    assert np.asarray(spectrum.lines[0].get_ydata()) == pytest.approx([2.0, 1.0, 0.1])
    assert spectrum.lines[0].get_label() == "PID, Sm 34.0e-6"


def test_plot_says_so_when_no_command_is_above_the_floor() -> None:
    held = lags(np.array([[100.0, 50.0, 1.0]]))
    figure = draw_response(held, response_figures(held), LINE, "title")
    assert "no command above the floor" in figure.axes[2].texts[0].get_text()
