"""Requirements on the shipped policy: error and motor work in the twin, in the firmware, with gyro noise."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from neuroflight.sim.analysis.metrics import FlightFigures, figures
from neuroflight.sim.flight.scenario import Scenario, Segment, load_scenario
from neuroflight.sim.flight.trace import Trace
from neuroflight.sim.ports.host import HostPort
from neuroflight.sim.ports.library import ReferencePort
from neuroflight.sim.ports.python_controller import ControllerPort
from neuroflight.toolchain.contract import RECEIVER_HOLD_MS, RECEIVER_LOST_MS
from neuroflight.toolchain.policy.model import read_policy
from tests.sampling import sampled

Flown = Callable[..., Trace]
MAE_MAX_DEG_S = 6.0  # average of the axes, against the true rate
CHANGE_MAX = 0.03  # mean |delta u| in 1 ms
SEED = 20_000  # commands that no training saw
CROSSED = (0, 2, 1, 3)  # motors 2 and 3 swapped


def passes(result: FlightFigures) -> bool:
    """Whether a flight meets the limits of error and motor work."""
    return float(result.tracking.mae.mean()) <= MAE_MAX_DEG_S and result.effort.change <= CHANGE_MAX


@pytest.fixture(scope="module")
def idle(shipped_policy: Path) -> float:
    """The idle that the shipped policy flies with."""
    return read_policy(shipped_policy).idle


@pytest.mark.parametrize("count", sampled((10, 100), 10))
def test_the_policy_meets_the_limits_when_it_flies_unseen_commands(
    reference_library: Path, flown: Flown, idle: float, count: int
) -> None:
    scenario = load_scenario("pulses", SEED, count=count)
    trace = flown(ReferencePort(reference_library, 1000), scenario)
    assert (trace.dshot > 0).all()
    assert passes(figures(trace, scenario.episodes(), idle))


def test_the_policy_meets_the_limits_when_flown_over_sockets_at_the_boards_gyro_rate(
    host_program: Path, flown: Flown, idle: float
) -> None:
    scenario = load_scenario("pulse", SEED + 1)
    assert passes(figures(flown(HostPort(host_program), scenario), scenario.episodes(), idle))


@pytest.mark.slow
def test_the_policy_meets_the_limits_when_a_hundred_commands_are_flown_over_sockets(
    host_program: Path, flown: Flown, idle: float
) -> None:
    scenario = load_scenario("pulses", SEED + 2, count=100)
    assert passes(figures(flown(HostPort(host_program), scenario), scenario.episodes(), idle))


def test_the_policy_exceeds_the_limits_when_motors_two_and_three_are_swapped(
    reference: ReferencePort, flown: Flown
) -> None:
    scenario = load_scenario("pulses", SEED, count=2)
    result = figures(flown(reference, scenario, motor_order=CROSSED), scenario.episodes())
    assert not passes(result)
    assert result.tracking.mae.mean() > 10 * MAE_MAX_DEG_S


def test_the_pid_tracks_when_it_flies_the_same_commands(pid: ControllerPort, flown: Flown) -> None:
    scenario = load_scenario("pulse", SEED)
    result = figures(flown(pid, scenario), scenario.episodes())
    assert result.tracking.mae.mean() < MAE_MAX_DEG_S
    assert result.gyro_mae.mean() < MAE_MAX_DEG_S


def test_the_pid_tumbles_when_motors_two_and_three_are_swapped(pid: ControllerPort, flown: Flown) -> None:
    scenario = load_scenario("pulse", SEED)
    assert figures(flown(pid, scenario, motor_order=CROSSED)).tracking.mae.mean() > 10 * MAE_MAX_DEG_S


def test_the_throttle_lifts_the_motors_and_leaves_the_tracking_when_raised(
    reference: ReferencePort, flown: Flown
) -> None:
    scenario = Scenario("lift", (Segment(0.5), Segment(1.0, (60.0, 60.0, 0.0), 0.4), Segment(1.0)))
    trace = flown(reference, scenario)
    assert trace.motors[1000:1500].mean() > 0.3
    assert np.rad2deg(trace.rate[1200:1500, :2]).mean(axis=0) == pytest.approx([60, 60], abs=10)


def test_the_firmware_centres_then_stays_stopped_when_the_receiver_falls_silent_in_flight(
    reference: ReferencePort, flown: Flown
) -> None:
    turning = Segment(0.3, (90.0, 0.0, 0.0))
    trace = flown(reference, Scenario("lost", (turning, Segment(1.2, receiver=False), turning)))
    armed = (trace.dshot > 0).all(axis=1)
    stopped = int(np.argmin(armed))
    centred = int(np.argmax(trace.setpoint[:, 0] == 0))
    # The last frame went out at most 10 ms before the silence began.
    assert 300 + RECEIVER_HOLD_MS - 10 <= centred <= 300 + RECEIVER_HOLD_MS
    assert 300 + RECEIVER_LOST_MS - 10 <= stopped <= 300 + RECEIVER_LOST_MS
    assert not trace.dshot[stopped:].any()  # the switch is still on when the frames return: locked
    assert not trace.motors[stopped:].any()
