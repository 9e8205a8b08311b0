"""Moments of inertia from swings: of the twin's bodies in pybullet, and of a pendulum's own equation."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.arrays import Array
from neuroflight.sim.identification.recording import Recording
from neuroflight.sim.identification.swing import bifilar_stiffness, find_swing, moment, reference_stiffness
from neuroflight.sim.physics.imu import quantised_rate
from neuroflight.sim.physics.world import Mount, World
from neuroflight.toolchain.contract import AXES, GRAVITY
from neuroflight.toolchain.errors import TraceError

MASS, DISTANCE, LENGTH = 0.391, 0.15, 1.0
INERTIA, DAMPING = 1.5e-3, 2e-5  # [kg m^2], [N m s/rad]
RATE_HZ = 500.0


def pendulum(angle: float, seconds: float, inertia: float = INERTIA) -> Array:
    """Rate [rad/s] of a bifilar pendulum whose wires stay straight, at finite angles, let go at `angle`.

    The height of the body follows from the angle; gravity turns it back by the work of lifting it.
    """

    def turn(_: float, state: Array) -> list[float]:
        theta, rate = state
        rise = math.sqrt(LENGTH**2 - (DISTANCE * math.sin(theta / 2)) ** 2)
        torque = MASS * GRAVITY * DISTANCE**2 * math.sin(theta) / (4 * rise)
        return [rate, -(torque + DAMPING * rate) / inertia]

    time = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    solved = solve_ivp(turn, (0, time[-1]), [angle, 0.0], t_eval=time, rtol=1e-9, atol=1e-12)
    rates: Array = solved.y[1]
    return rates


def logged(rate: Array, axis: int = 2, noise_deg_s: float = 1.0) -> Recording:
    """As the gyro logs it: with bias, noise and whole counts."""
    rng = np.random.default_rng(5)
    gyro = np.deg2rad(rng.normal(0.3, noise_deg_s, (len(rate), 3)))
    gyro[:, axis] += rate
    return Recording(RATE_HZ, quantised_rate(gyro).astype(np.float64), None, 0)


def test_moment_is_found_within_its_margin_when_a_bifilar_pendulum_swings() -> None:
    swing = find_swing(logged(pendulum(math.radians(5), 30.0)), "log")
    found = moment(swing, bifilar_stiffness(MASS, DISTANCE, LENGTH), bifilar=True)
    assert swing.axis == 2
    assert abs(found.value - INERTIA) < found.margin < 0.005 * INERTIA


def test_finite_angles_are_in_the_margin_when_it_swings_far() -> None:
    swing = find_swing(logged(pendulum(math.radians(14), 20.0)), "log")
    found = moment(swing, bifilar_stiffness(MASS, DISTANCE, LENGTH), bifilar=True)
    assert 0.001 * INERTIA < abs(found.value - INERTIA) < found.margin


@pytest.mark.parametrize("axis", range(3))
def test_moment_is_the_twins_when_its_body_turns_on_a_spring(axis: int) -> None:
    aircraft = load_aircraft("nf1")
    stiffness, dt = 0.02, 1.0 / RATE_HZ
    world = World(aircraft, 1, dt, Mount.CENTRE, gravity=False)
    true = aircraft.mass_properties.inertia[axis, axis]
    angle, rates = math.radians(6), []
    try:
        for _ in range(round(12 * RATE_HZ)):
            wrench = np.zeros((1, 6))
            # Other axes are held by the wire's tension: strongly damped.
            wrench[0, 3:] = -1e-3 * world.rate[0]
            wrench[0, 3 + axis] = -stiffness * angle
            world.step(wrench)
            rates.append(world.rate[0, axis])
            angle += dt * world.rate[0, axis]
    finally:
        world.close()
    swing = find_swing(logged(np.array(rates), axis), "log")
    assert swing.axis == axis
    assert moment(swing, stiffness).value == pytest.approx(true, rel=0.01)


def test_stiffness_follows_from_a_reference_body() -> None:
    body = find_swing(logged(pendulum(math.radians(4), 20.0, inertia=1e-3)), "log")
    stiffness, relative = reference_stiffness(body, 1e-3)
    assert stiffness == pytest.approx(bifilar_stiffness(MASS, DISTANCE, LENGTH), rel=0.004)
    assert 0.0 < relative < 0.01


def test_margin_covers_the_truth_as_often_as_it_says_when_noise_is_drawn_anew() -> None:
    time = np.arange(4000) / RATE_HZ
    clean = 0.2 * np.exp(-0.05 * time) * np.cos(9.0 * time)
    period = 2 * math.pi / math.hypot(9.0, 0.05)
    rng, inside = np.random.default_rng(1), 0
    for _ in range(100):
        gyro = rng.normal(0.0, 0.02, (4000, 3))
        gyro[:, 0] += clean
        swing = find_swing(Recording(RATE_HZ, gyro, None, 0), "log")
        inside += abs(swing.period_s - period) <= swing.period_margin_s
    assert 88 <= inside <= 100


def test_outliers_do_not_move_the_moment_when_the_log_has_knocks() -> None:
    rate = pendulum(math.radians(5), 30.0)
    rate[[2000, 5000, 9001]] += 8.0
    found = moment(find_swing(logged(rate), "log"), bifilar_stiffness(MASS, DISTANCE, LENGTH))
    assert found.value == pytest.approx(INERTIA, rel=0.003)


@pytest.mark.parametrize(
    ("recording", "words"),
    [
        (lambda: logged(np.zeros(10_000)), "periods|no swing|wobble|turns with"),
        (lambda: logged(pendulum(math.radians(5), 3.0)), "expected at least 5 periods"),
        (lambda: logged(pendulum(math.radians(40), 30.0)), "expected at most 15"),
        (lambda: Recording(RATE_HZ, np.zeros((5000, 3)), None, 0), "never changes"),
        (lambda: Recording(RATE_HZ, np.zeros((5000, 3)), None, 2), "missing in 2 places"),
    ],
)
def test_log_is_refused_when_it_shows_no_free_swing(recording: object, words: str) -> None:
    with pytest.raises(TraceError, match=words):
        find_swing(recording(), "log")  # type: ignore[operator]


def test_log_is_refused_when_two_axes_swing() -> None:
    swinging = logged(pendulum(math.radians(5), 20.0))
    swinging.gyro[:, 0] = 0.6 * swinging.gyro[:, 2]
    with pytest.raises(TraceError, match=f"{AXES[0]} turns with 0.6"):
        find_swing(swinging, "log")
