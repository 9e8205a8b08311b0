"""Rotors against the published figures and closed forms."""

import math
from dataclasses import replace

import numpy as np
import pytest

from neuroflight.sim.aircraft.model import RPM, TorqueResponse, load_aircraft
from neuroflight.sim.physics.rotor import next_speed, rotor_geometry, rotor_wrench, speeds_along, target_speed

NF1 = load_aircraft("nf1")
PROPULSION = NF1.propulsion


def wrench_at(speeds: list[float], before: list[float] | None = None, **motion: list[float]) -> np.ndarray:
    after = np.array([speeds])
    wrench: np.ndarray = rotor_wrench(
        np.array([before or speeds]),
        after,
        0.001,
        np.array([motion.get("velocity", [0.0] * 3)]),
        np.array([motion.get("rate", [0.0] * 3)]),
        rotor_geometry(NF1),
    )[0]
    return wrench


def test_full_throttle_settles_within_measurement_of_the_bench_figures() -> None:
    top = float(target_speed(np.array(1.0), PROPULSION))
    assert top == pytest.approx(25042 * RPM, rel=0.005)  # measured 25,042 rpm
    thrust = PROPULSION.thrust_coefficient[0] * top**2
    assert thrust == pytest.approx(6.59, abs=0.5)  # measured 6.59 N; K_T's own fit error is 0.588 N


def test_speed_rises_as_the_bench_saw_when_stepped_to_full_throttle() -> None:
    speed, target = np.zeros(1), target_speed(np.ones(1), PROPULSION)
    steps = 0
    while speed[0] < 0.9 * target[0]:
        speed = next_speed(speed, target, 0.001, PROPULSION)
        steps += 1
        if steps == 10:  # held by the clamp: 0.05 N m / 4.24e-6 kg m^2
            assert speed[0] == pytest.approx(0.010 * 11790, rel=0.01)
    assert 0.001 * steps == pytest.approx(0.21, abs=0.03)


def test_settling_is_the_same_at_any_step_when_the_clamp_is_away() -> None:
    target = np.array([510.0])
    coarse = next_speed(np.array([500.0]), target, 0.004, PROPULSION)
    fine = np.array([500.0])
    for _ in range(16):
        fine = next_speed(fine, target, 0.00025, PROPULSION)
    assert fine[0] == pytest.approx(coarse[0], abs=1e-9)
    assert isinstance(PROPULSION.response, TorqueResponse)
    lag = PROPULSION.rotor_inertia / PROPULSION.response.gain
    assert coarse[0] == pytest.approx(510 - 10 * math.exp(-0.004 / lag))


def test_speed_never_turns_negative_when_braked_hard() -> None:
    assert next_speed(np.array([5.0]), np.array([0.0]), 0.1, PROPULSION)[0] >= 0.0


def test_speeds_along_targets_are_those_of_single_steps() -> None:
    targets = np.random.default_rng(2).uniform(0.0, 2600.0, (200, 3)).repeat(5, axis=0)
    start = np.array([0.0, 900.0, 2600.0])
    speeds = speeds_along(start, targets, 0.001, PROPULSION)
    assert speeds.shape == (1001, 3)
    for k, target in enumerate(targets):
        assert np.array_equal(speeds[k + 1], next_speed(speeds[k], target, 0.001, PROPULSION))
    assert np.array_equal(speeds[0], start)


def test_equal_speeds_only_lift() -> None:
    wrench = wrench_at([1000.0] * 4)
    assert wrench[2] == pytest.approx(4 * 9.37e-7 * 1e6)
    assert wrench[[0, 1, 3, 4, 5]] == pytest.approx(np.zeros(5), abs=1e-12)


@pytest.mark.parametrize(
    ("faster", "axis"),
    [((2, 3), 0), ((0, 2), 1), ((0, 3), 2)],
    ids=["left pair rolls right", "rear pair pitches nose down", "clockwise pair yaws left"],
)
def test_moment_is_positive_about_one_axis_when_a_pair_is_faster(faster: tuple[int, int], axis: int) -> None:
    speeds = [1200.0 if motor in faster else 1000.0 for motor in range(4)]
    moment = wrench_at(speeds)[3:]
    thrusts = PROPULSION.thrust_coefficient[0] * np.array(speeds) ** 2
    lever = [0.07, 0.0805, PROPULSION.torque_ratio[0]][axis]
    expected = np.zeros(3)
    expected[axis] = lever * 2 * (thrusts.max() - thrusts.min())
    assert moment == pytest.approx(expected, abs=1e-9)


def test_body_turns_against_a_rotor_that_accelerates() -> None:
    calm = wrench_at([1000.0] * 4)
    kicked = wrench_at([1000.0, 1011.0, 1000.0, 1000.0], before=[1000.0] * 4)  # motor 2 spins up, ccw
    slow = wrench_at([1000.0, 1011.0, 1000.0, 1000.0])
    assert calm[5] == pytest.approx(0.0, abs=1e-12)
    assert kicked[5] - slow[5] == pytest.approx(-4.24e-6 * 11.0 / 0.001)


def test_gyroscopic_moment_is_that_of_the_net_spin() -> None:
    bare = replace(NF1, propulsion=replace(PROPULSION, drag_coefficient=0.0, rolling_coefficient=0.0))
    speeds, still = np.array([[1000.0, 1500.0, 1500.0, 1000.0]]), np.zeros((1, 3))
    rate = np.array([[2.0, -3.0, 1.0]])
    geometry = rotor_geometry(bare)
    turned = rotor_wrench(speeds, speeds, 0.001, still, rate, geometry)
    held = rotor_wrench(speeds, speeds, 0.001, still, still, geometry)
    momentum = np.array([0.0, 0.0, 4.24e-6 * (3000.0 - 2000.0)])
    assert (turned - held)[0, 3:] == pytest.approx(-np.cross(rate[0], momentum))


def test_rotor_drag_opposes_sideways_motion_at_the_hubs() -> None:
    wrench = wrench_at([1000.0] * 4, velocity=[2.0, 0.0, 5.0]) - wrench_at([1000.0] * 4)
    force = -4 * 8e-5 * 1000.0 * 2.0  # climbing (5 m/s) is along the rotor axis: no drag
    assert wrench[:3] == pytest.approx([force, 0.0, 0.0])
    hub_height = NF1.rotor_positions[0, 2]
    rolling = -4 * 1e-6 * 1000.0 * 2.0
    assert wrench[3:] == pytest.approx([rolling, hub_height * force, 0.0], abs=1e-12)


def test_a_rotor_with_friction_follows_its_equation_and_stops_where_friction_takes_all_torque() -> None:
    """Chapter 3's motors: I dw/dt = clamp(0.01 (838 u - w), +-2) - 0.0046 w, here in steps of 1 us."""
    response = TorqueResponse(gain=0.0146, torque_up=2.0, torque_down=2.0, friction=0.0046)
    inertia = 1.676e-4
    rotor = replace(
        PROPULSION,
        speed_curve=(0.0, 838.0 * 0.01 / 0.0146, 0.0),
        rotor_inertia=inertia,
        response=response,
    )
    speed, exact = np.zeros(1), 0.0
    worst = 0.0
    for step in range(400):
        command = 1.0 if step < 200 else 0.2
        speed = next_speed(speed, target_speed(np.array([command]), rotor), 0.001, rotor)
        for _ in range(1000):
            torque = min(max(0.01 * (838.0 * command - exact), -2.0), 2.0) - 0.0046 * exact
            exact += 1e-6 * torque / inertia
        worst = max(worst, abs(float(speed[0]) - exact))
        if step == 199:
            assert float(speed[0]) == pytest.approx(2.0 / 0.0046, rel=0.01)
    assert worst < 7.0  # of 435 rad/s, with steps of a millisecond
    assert float(speed[0]) == pytest.approx(838.0 * 0.2 * 0.01 / 0.0146, rel=1e-6)
    assert rotor.speed_max == pytest.approx(2.0 / 0.0046)
