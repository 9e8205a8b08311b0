"""Floors of commands: what changes, what it costs at least, and that no controller is below."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.training.evaluation.controllers import Conditions, load_controller
from neuroflight.training.evaluation.evaluation import scores
from neuroflight.training.evaluation.floor import changes, floors, floors_of
from neuroflight.training.tasks.task import EpisodicTask, PulseTask, Setpoints

NF1 = load_aircraft("nf1")
PULSES = PulseTask(idle_s=0.5, command_s=0.4, rest_s=0.4)
SETTLED = replace(PULSES, command_s=1.0)  # rotors hold the command, and do not only move towards it
POLICY = "training/policies/nf1/policy.onnx"


def pulses(count: int, rate_hz: int = 1000) -> Setpoints:
    return PULSES.episodes(count, np.random.default_rng(5), rate_hz)


def stepped(*commands: tuple[int, float]) -> NDArray[np.float64]:
    """One episode whose roll command holds for so many control steps each [deg/s]."""
    roll = np.concatenate([np.full(steps, np.deg2rad(value)) for steps, value in commands])
    return np.column_stack([roll, np.zeros((len(roll), 2))])[None]


def test_changes_are_found_with_what_holds_before_and_after() -> None:
    found = changes(np.concatenate([stepped((3, 0.0), (4, 10.0), (2, 0.0)), stepped((5, 7.0), (4, -7.0))]))
    assert found.episode.tolist() == [0, 0, 1, 1]
    assert found.step.tolist() == [3, 7, 0, 5]
    assert found.last.tolist() == [7, 9, 5, 9]
    assert np.rad2deg(found.held[:, 0]) == pytest.approx([0.0, 10.0, 0.0, 7.0])
    assert np.rad2deg(found.wanted[:, 0]) == pytest.approx([10.0, 0.0, 7.0, -7.0])


@pytest.mark.parametrize("name", ["pid:flying", POLICY])
def test_no_controller_is_below_the_floor(name: str) -> None:
    controller = load_controller(name, NF1)
    for throttle in (0.12, 0.4):
        flown = Conditions(NF1, SETTLED, 12, 3, gyro_rate_hz=4000, noise=False).fly(controller, throttle)
        least = floors_of(flown, NF1, idle=controller.idle)
        assert least is not None
        errors = scores(flown).tracking
        assert (errors.mae.mean(axis=1) > least.mae).all()
        assert (errors.mse.mean(axis=1) > least.mse).all()
        # Nor is the floor far below: these controllers are good ones.
        assert errors.mse.mean() < 1.3 * least.mse.mean()
        assert errors.mae.mean() < 2.0 * least.mae.mean()


def test_a_millisecond_more_of_delay_costs_the_change_for_a_millisecond() -> None:
    setpoint, later = pulses(4), replace(NF1.propulsion, delay=NF1.propulsion.delay + 0.001)
    slow = replace(NF1, propulsion=later)
    before, after = (floors(each, setpoint, 1e-3, thrust=1.0, idle=0.05) for each in (NF1, slow))
    assert before is not None and after is not None
    steps = np.rad2deg(np.abs(np.diff(setpoint, axis=1))).mean(axis=2)
    length = setpoint.shape[1]
    assert after.mae - before.mae == pytest.approx(steps.sum(axis=1) / length, rel=1e-4)
    assert (after.mse > before.mse).all()


def test_floors_fall_with_the_thrust_and_rise_with_the_idle() -> None:
    setpoint = pulses(4)
    found = [
        floors(NF1, setpoint, 1e-3, thrust=thrust, idle=idle)
        for thrust, idle in ((0.4, 0.2), (0.4, 0.05), (1.0, 0.05), (4.0, 0.05))
    ]
    for figure in ("mae", "mse"):
        columns = np.array([getattr(each, figure) for each in found])
        assert (np.diff(columns, axis=0) < 0.0).all()


def test_the_floor_of_quicker_control_is_near() -> None:
    coarse, fine = (
        floors(NF1, pulses(4, rate_hz), 1.0 / rate_hz, thrust=1.0, idle=0.05, samples=samples)
        for rate_hz, samples in ((1000, 4), (2000, 2))
    )
    assert coarse is not None and fine is not None
    assert fine.mae == pytest.approx(coarse.mae, rel=0.05)
    assert fine.mse == pytest.approx(coarse.mse, rel=0.05)


def test_what_was_reached_before_the_next_change_counts_for_itself() -> None:
    """The floor of two changes is the sum of theirs, however long the commands hold."""
    long, short = stepped((500, 0.0), (600, 90.0), (600, 0.0)), stepped((300, 0.0), (300, 90.0), (300, 0.0))
    both = [floors(NF1, each, 1e-3, thrust=1.0, idle=0.05) for each in (long, short)]
    assert both[0] is not None and both[1] is not None
    assert both[0].mae * 1700 == pytest.approx(both[1].mae * 900, rel=2e-3)


def test_rotors_that_stand_at_first_cost_more() -> None:
    from_stand = floors(NF1, stepped((500, 60.0)), 1e-3, thrust=1.0, idle=0.05)
    turning = floors(NF1, stepped((500, 0.0), (500, 60.0)), 1e-3, thrust=1.0, idle=0.05)
    assert from_stand is not None and turning is not None
    assert from_stand.mae[0] * 500 > 1.2 * turning.mae[0] * 1000


def test_no_floor_is_told_of_commands_that_nobody_can_reach_in_time() -> None:
    rng = np.random.default_rng(2)
    sticks = np.deg2rad(np.cumsum(rng.normal(0.0, 1.0, (2, 400, 3)), axis=1))
    assert floors(NF1, sticks, 1e-3, thrust=1.0, idle=0.05) is None
    hurried = stepped((200, 0.0), (30, 900.0), (300, 0.0))
    assert floors(NF1, hurried, 1e-3, thrust=0.4, idle=0.05) is None


def test_floors_of_episodic_flights_begin_with_rotors_that_stand() -> None:
    controller = load_controller("pid:flying", NF1)
    task = EpisodicTask(limit_deg_s=100.0)
    flown = Conditions(NF1, task, 6, 3, gyro_rate_hz=4000, noise=False).fly(controller, 0.3)
    least = floors_of(flown, NF1, idle=controller.idle)
    assert least is not None
    assert (scores(flown).tracking.mae.mean(axis=1) > least.mae).all()
