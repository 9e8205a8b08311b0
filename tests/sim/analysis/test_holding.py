"""Errors by the age of a flight, and drift: flights whose figures are known, and one that pybullet turns."""

import numpy as np
import pybullet as p
import pytest
from scipy.spatial.transform import Rotation

from neuroflight.sim.analysis.confidence import mean_of
from neuroflight.sim.analysis.holding import holding, holding_figures

STEP_S = 0.01
BEFORE, HOVER = 1000, 1000  # rows: five commands of 2 s each, 10 s of hover


def flight(rest_deg_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Five commands of 60 deg/s in roll in the first second of 2 s; flown perfectly but for the rest.

    rest_deg_s: (BEFORE + HOVER, 3), the rate with the sticks centred.
    """
    wanted = np.zeros((1, BEFORE + HOVER, 3))
    for n in range(5):
        wanted[0, 200 * n : 200 * n + 100, 0] = np.deg2rad(60.0)
    moved = np.asarray(wanted.any(axis=2))[..., None]
    return wanted, np.where(moved, wanted, np.deg2rad(rest_deg_s))


def test_rest_and_commands_are_told_by_age_when_the_aircraft_turns_faster_the_older_the_flight() -> None:
    growing = np.zeros((BEFORE + HOVER, 3))
    growing[:, 1] = np.repeat(np.arange(10), 200)  # 0, 1, .. 4 deg/s of pitch in the commands' rests
    wanted, rate = flight(growing)
    found = holding(wanted, rate, STEP_S, 5, BEFORE)
    assert found.rest[0, :, 1] == pytest.approx([0.0, 1.0, 2.0, 3.0, 4.0])
    assert not found.rest[0, :, [0, 2]].any()
    assert found.early[0].tolist() == [0.0, 0.0, 0.0]
    assert found.late[0] == pytest.approx([0.0, 4.0, 0.0])
    assert found.mae[0, :, 1] == pytest.approx(np.arange(5) / 2)  # half of each command's time is rest
    assert found.mse[0, :, 1] == pytest.approx(np.arange(5) ** 2 / 2)
    assert found.hover[0] == pytest.approx([0.0, 7.0, 0.0])
    assert found.drift[0] == pytest.approx([0.0, 70.0, 0.0])


def test_the_first_half_second_after_a_command_is_no_rest() -> None:
    swinging = np.zeros((BEFORE + HOVER, 3))
    for n in range(5):
        swinging[200 * n + 100 : 200 * n + 150, 2] = 50.0  # just until the sticks are centred for 0.5 s
    found = holding(*flight(swinging), STEP_S, 5, BEFORE)
    assert not found.rest.any()
    assert found.mae[0, :, 2] == pytest.approx([50.0 * 50 / 200] * 5)


def test_drifts_to_either_side_do_not_cancel_in_their_mean() -> None:
    sides = [flight(np.full((BEFORE + HOVER, 3), rate)) for rate in (2.0, -2.0)]
    wanted, rate = (np.concatenate(each) for each in zip(*sides, strict=True))
    each = holding(wanted, rate, STEP_S, 5, BEFORE)
    assert each.drift == pytest.approx(np.array([[20.0] * 3, [-20.0] * 3]))
    assert holding_figures(each).drift.value == pytest.approx([20.0] * 3)


@pytest.mark.parametrize(
    ("commands", "before", "match"),
    [(5, BEFORE + 1, "equal"), (3, BEFORE, "equal"), (5, 700, "not centred")],
)
def test_a_flight_without_its_hover_is_refused(commands: int, before: int, match: str) -> None:
    wanted, rate = flight(np.zeros((BEFORE + HOVER, 3)))
    wanted[:, -5:] = 1.0 if match == "not centred" else 0.0
    with pytest.raises(ValueError, match=match):
        holding(wanted, rate, STEP_S, commands, before)


def test_drift_is_what_pybullet_turned_the_body_by() -> None:
    """A free body, turning about one axis: its attitude after 10 s, against the sum of its rates."""
    client = p.connect(p.DIRECT)
    try:
        p.setTimeStep(STEP_S, physicsClientId=client)
        shape = p.createCollisionShape(p.GEOM_SPHERE, radius=0.1, physicsClientId=client)
        body = p.createMultiBody(1.0, shape, physicsClientId=client)
        p.changeDynamics(body, -1, linearDamping=0.0, angularDamping=0.0, physicsClientId=client)
        start = Rotation.from_euler("xyz", [0.3, -0.2, 1.1])  # any attitude: rates are those of the body
        p.resetBasePositionAndOrientation(body, [0, 0, 0], start.as_quat(), physicsClientId=client)
        spin = start.apply(np.deg2rad([4.7, 0.0, 0.0]))
        p.resetBaseVelocity(body, [0, 0, 0], spin, physicsClientId=client)
        rates = np.zeros((1, BEFORE + HOVER, 3))
        for k in range(HOVER):
            p.stepSimulation(physicsClientId=client)
            attitude = Rotation.from_quat(p.getBasePositionAndOrientation(body, physicsClientId=client)[1])
            rates[0, BEFORE + k] = attitude.inv().apply(p.getBaseVelocity(body, physicsClientId=client)[1])
    finally:
        p.disconnect(client)
    turned = np.rad2deg((start.inv() * attitude).as_rotvec())
    found = holding(np.zeros_like(rates), rates, STEP_S, 5, BEFORE)
    assert turned[0] == pytest.approx(47.0, rel=1e-3)
    assert found.drift[0] == pytest.approx(turned, abs=0.05)


def test_commands_of_one_flight_count_as_one_when_they_are_all_alike() -> None:
    rng = np.random.default_rng(1)
    flights = rng.normal(5.0, 1.0, 12)
    alike = mean_of(np.repeat(flights, 10), np.ones(120, bool), 10)
    single = mean_of(flights, np.ones(12, bool))
    careless = mean_of(np.repeat(flights, 10), np.ones(120, bool))
    assert [float(alike.low), float(alike.high)] == pytest.approx([float(single.low), float(single.high)])
    assert float(careless.high - careless.low) < 0.5 * float(single.high - single.low)
    assert int(alike.count) == 120


def test_the_interval_of_clustered_commands_holds_the_truth_in_95_of_100_when_some_have_no_number() -> None:
    rng = np.random.default_rng(3)
    hits = 0
    for _ in range(400):
        values = rng.normal(2.0, 1.0, (15, 1)) + rng.normal(0.0, 1.0, (15, 8))
        mean = mean_of(values.ravel(), rng.random(120) < 0.7, 8)
        hits += bool(mean.low <= 2.0 <= mean.high)
    assert 0.91 < hits / 400 < 0.98
