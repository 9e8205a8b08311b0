"""Figures of manoeuvres, of flights by eye and of descents, on motions that are known."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from neuroflight.sim.analysis.manoeuvre import manoeuvre_figures, overshoot, shake
from neuroflight.sim.analysis.stick_flight import descent_figures, stick_figures
from neuroflight.sim.flight.motion import Motion
from neuroflight.sim.flight.scenario import Scenario, Segment
from neuroflight.sim.flight.trace import Trace
from tests.sim.flight.traces import trace_of

HZ = 1000


def trace(setpoint: np.ndarray, rate: np.ndarray, motors: np.ndarray | None = None) -> Trace:
    """A flight of rates in deg/s."""
    return trace_of(np.deg2rad(setpoint), np.deg2rad(rate), motors=0.0 if motors is None else motors)


def motion(height: np.ndarray, **more: Any) -> Motion:
    """A motion up and down along a given height (N,) [m]."""
    count = len(height)
    position, velocity = np.zeros((count, 3)), np.zeros((count, 3))
    position[:, 2], velocity[:, 2] = height, np.gradient(height) * HZ
    made = {"position": position, "velocity": velocity, "tilt": np.zeros(count), **more}
    return cast(Motion, SimpleNamespace(**made))


def test_overshoot_is_the_most_past_any_jump_in_percent_of_it() -> None:
    setpoint = np.repeat([0.0, 100.0, 0.0, 5.0], 10)
    rate = setpoint.copy()
    rate[15], rate[25], rate[35] = 110.0, -30.0, 500.0  # 10 %, 30 %, behind a jump that is none
    assert overshoot(setpoint[:30], rate[:30]) == pytest.approx(30)
    assert overshoot(setpoint[:20], rate[:20]) == pytest.approx(10)
    assert overshoot(setpoint[:20], np.zeros(20)) == 0
    assert overshoot(np.repeat([0.0, 100.0, 50.0], 10), np.repeat([0.0, 104.0, 45.0], 10)) == pytest.approx(
        10
    )


@pytest.mark.parametrize(
    ("frequency", "seen"), [(10.0, 0.0), (20.0, 1.0), (40.0, 1.0), (80.0, 1.0), (90.0, 0.0)]
)
def test_shake_is_the_power_between_20_and_80_hz(frequency: float, seen: float) -> None:
    t = np.arange(1500) / HZ
    error = np.stack([4.0 * np.sin(2 * np.pi * frequency * t), 0 * t, 5.0 + 0 * t], axis=1)
    assert shake(error, 1 / HZ) == pytest.approx(seen * math.sqrt(4.0**2 / 2 / 3), abs=1e-9)


def test_figures_leave_out_the_hovers_and_tell_axes_apart() -> None:
    setpoint, rate = np.zeros((4000, 3)), np.zeros((4000, 3))
    rate[:1000] = 900.0  # before the figures
    setpoint[1500:2000, 0] = 100.0
    rate[1500:2000, 0] = 120.0
    rate[1000:2000, 1], rate[1700, 2] = 3.0, -50.0
    rate[2000:2500] = 300.0  # of the hover behind, while it settles
    rate[2500:, 0], rate[2500:, 2] = 6.0, np.tile([-3.0, 3.0], 750)
    thrust = np.repeat([5.0, 2.0, 1.0], [1000, 1000, 2000])
    motors = np.zeros((4000, 4))
    motors[1000:2000:2] = 0.25
    found = manoeuvre_figures(trace(setpoint, rate, motors), thrust, (True, False, False), 1.0, 2.0)
    assert found.mae == pytest.approx((10 + 3 + 0.05) / 3)
    assert found.mse == pytest.approx((200 + 9 + 2.5) / 3, rel=1e-4)
    assert found.overshoot == pytest.approx(20)
    assert found.stray == pytest.approx((3 + 0.05) / 2)
    assert found.stray_peak == pytest.approx(50)
    assert found.thrust == 2
    assert found.change == pytest.approx(0.25)
    assert found.rest == pytest.approx(3.0)
    assert found.rest_worst == pytest.approx(6.0)
    assert found.drift == pytest.approx(9.0)  # 6 deg/s for 1.5 s; the yaw turns to and fro
    for settle_s, hover_s in ((2.0, 2.0), (1.0, 0.5)):
        with pytest.raises(ValueError, match="4000 rows"):
            manoeuvre_figures(trace(setpoint, rate), thrust, (True, False, False), settle_s, hover_s)


def test_stick_figures_tell_height_touchdown_and_standing() -> None:
    scenario = Scenario("hop", (Segment(4.0, height_m=2.0), Segment(3.0, height_m=0.0), Segment(1.0)))
    height = np.concatenate(
        [np.linspace(0, 2.1, 1000), np.full(3000, 2.1), np.linspace(2.1, 0, 3000), np.zeros(1000)]
    )
    found = stick_figures(scenario, motion(height), HZ)
    assert found.height_error_m == pytest.approx(0.1)
    assert found.touchdown_m_s == pytest.approx(0.7, rel=0.01)
    assert found.touchdown_level_m_s == 0
    assert found.landed
    over = np.zeros(8000)
    over[-1] = np.deg2rad(90)
    assert not stick_figures(scenario, motion(height, tilt=over), HZ).landed
    aloft = stick_figures(scenario, motion(height + np.linspace(0, 3, 8000)), HZ)
    assert (aloft.landed, aloft.touchdown_m_s) == (False, None)


def test_descent_figures_take_the_last_second() -> None:
    height = np.concatenate([np.full(1000, 20.0), 20 - np.arange(1, 4001) * 0.005])
    found = descent_figures(motion(height), 1000, HZ)
    assert found.sink_m_s == pytest.approx(5)
    assert found.fallen_m == pytest.approx(20, abs=0.01)
