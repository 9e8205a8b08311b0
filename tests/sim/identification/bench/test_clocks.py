"""Two clocks: offset and drift from lines that come late by any time."""

from __future__ import annotations

import numpy as np
import pytest

from neuroflight.sim.identification.bench.clocks import fit_clock
from neuroflight.toolchain.errors import DynoError


@pytest.mark.parametrize("drift", [0.0, 0.005, -0.004, 5e-5])
@pytest.mark.parametrize("late_s", [0.001, 0.02])
def test_offset_and_drift_are_found_when_lines_are_late_at_random(drift: float, late_s: float) -> None:
    rng = np.random.default_rng(3)
    host = np.sort(rng.uniform(100.0, 140.0, 8000))
    own = 7.0 + (host - 100.0) / (1 + drift)
    clock = fit_clock(own, host + rng.exponential(late_s, len(host)))
    assert clock.rate == pytest.approx(1 + drift, abs=late_s / 400)
    assert clock.host(own) == pytest.approx(host, abs=late_s / 20)
    assert clock.late == pytest.approx(late_s, rel=0.1)


def test_lines_in_bursts_get_the_times_at_which_they_were_sent() -> None:
    """A USB adapter hands lines over every 16 ms."""
    sent = np.arange(0.0, 20.0, 0.002)
    arrival = np.ceil(sent / 0.016) * 0.016
    clock = fit_clock(sent * 1.002 + 5.0, arrival)
    assert clock.host(sent * 1.002 + 5.0) == pytest.approx(sent, abs=3e-4)


def test_nothing_arrives_before_it_was_sent_when_a_few_lines_are_seconds_late() -> None:
    sent = np.arange(0.0, 10.0, 0.01)
    arrival = sent + 0.003
    arrival[300:340] += np.linspace(1.0, 0.5, 40)
    clock = fit_clock(sent, arrival)
    assert clock.host(sent) == pytest.approx(sent + 0.003, abs=1e-9)
    assert (arrival - clock.host(sent) >= -1e-9).all()


def test_only_an_offset_is_fitted_when_the_log_is_short() -> None:
    sent = np.arange(0.0, 1.0, 0.01)
    assert fit_clock(sent * 1.5, sent).rate == 1.0


@pytest.mark.parametrize("unit", [1e-3, 1e3, 1.06])
def test_a_clock_is_refused_when_its_unit_is_wrong(unit: float) -> None:
    sent = np.arange(0.0, 5000.0, 1.0)
    with pytest.raises(DynoError, match="unit in its column's name"):
        fit_clock(sent, sent * unit)
