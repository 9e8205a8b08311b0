"""Blades that pass, to rotor speed."""

from __future__ import annotations

import math

import numpy as np
import pytest

from neuroflight.sim.identification.bench.pulses import speed_of_pulses, unwrapped
from neuroflight.toolchain.errors import DynoError

TURN = 2 * math.pi


def passing(speed: float, blades: int, seconds: float) -> np.ndarray:
    """Times of blades of an even rotor [s]."""
    return np.arange(1, int(speed / TURN * blades * seconds)) / (speed / TURN * blades)


@pytest.mark.parametrize("blades", [1, 2, 3, 5])
@pytest.mark.parametrize("rpm", [1_500.0, 9_000.0, 25_000.0])
def test_an_even_speed_is_exact_when_pulses_have_stamps(blades: int, rpm: float) -> None:
    speed = rpm * math.pi / 30
    edges = passing(speed, blades, 1.0)
    rows = np.arange(0.2, 0.8, 0.004)
    latest = np.searchsorted(edges, rows, side="right") - 1
    found = speed_of_pulses(rows, edges[latest], latest.astype(float), blades, 0.02)
    assert found[20:-20] == pytest.approx(speed, rel=1e-6)


def test_a_speed_is_known_to_a_count_in_the_window_when_pulses_have_no_stamps() -> None:
    speed, blades, window = 2000.0, 3, 0.04
    edges = passing(speed, blades, 1.0)
    rows = np.arange(0.1, 0.9, 0.002)
    counts = np.searchsorted(edges, rows, side="right").astype(float)
    found = speed_of_pulses(rows, rows, counts, blades, window)[30:-30]
    assert np.abs(found - speed).max() <= TURN / blades / window
    assert found.mean() == pytest.approx(speed, rel=2e-3)


def test_every_third_pulse_is_a_turn_when_an_oscilloscope_recorded_uneven_blades() -> None:
    speed = 1000.0
    turns = np.arange(0, 100) * TURN / speed
    edges = np.sort(np.concatenate([turns, turns + 0.31 * TURN / speed, turns + 0.69 * TURN / speed]))
    middle = np.linspace(0.2, 0.4, 50)
    found = speed_of_pulses(middle, edges, np.arange(300.0), 3, TURN / speed)
    assert found == pytest.approx(speed, rel=1e-9), "a whole turn in the window: the blades cancel"


def test_a_speed_falls_to_zero_when_no_blade_passes_any_more() -> None:
    edges = passing(1000.0, 2, 0.5)
    rows = np.arange(0.0, 1.0, 0.01)
    found = speed_of_pulses(rows, edges, np.arange(float(len(edges))), 2, 0.04)
    assert (found[rows > 0.53] == 0.0).all() and (found >= 0.0).all()


def test_a_change_of_speed_is_not_delayed_when_it_is_averaged() -> None:
    angle = np.linspace(0, 1, 200_001)
    speed = 500.0 + 1500.0 * angle
    turned = np.cumsum(speed) * (angle[1] - angle[0]) * 3 / TURN
    edges = np.interp(np.arange(1, int(turned[-1])), turned, angle)
    rows = np.arange(0.1, 0.9, 0.004)
    found = speed_of_pulses(rows, edges, np.arange(float(len(edges))), 3, 0.02)
    assert found == pytest.approx(500.0 + 1500.0 * rows, rel=2e-3)


@pytest.mark.parametrize("modulus", [2.0**16, 2.0**32])
def test_a_counter_goes_on_when_it_began_anew(modulus: float) -> None:
    counts = np.array([modulus - 3, modulus - 1, 2, 2, 7])
    assert np.diff(unwrapped(counts, modulus)).tolist() == [2, 3, 0, 5]


@pytest.mark.parametrize("counts", [[100.0, 200.0, 150.0], [0.0, 50.0, 45_000.0]])
def test_a_counter_is_refused_when_it_was_set_anew(counts: list[float]) -> None:
    with pytest.raises(DynoError, match="did the sensor start anew"):
        unwrapped(np.array(counts), 2.0**16)
