"""The least error that motors can reach, against closed forms, differences, and the twin."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import quad
from scipy.optimize import minimize_scalar

from neuroflight.sim.aircraft.model import Aircraft, FirstOrderResponse, TorqueResponse, load_aircraft
from neuroflight.sim.physics.rotor import response_rows, target_speed, thrust_and_torque
from neuroflight.sim.physics.twin import Twin
from neuroflight.toolchain.contract import GRAVITY
from neuroflight.training.learners.pathwise.open_loop import Commands, Found, Motors, search, trim

Array = NDArray[np.float64]
IDLE = 0.055
NF1 = load_aircraft("nf1")
LAGGING = replace(
    NF1,
    propulsion=replace(
        NF1.propulsion, response=FirstOrderResponse(time_constant_up=0.024, time_constant_down=0.032)
    ),
)


def motors_of(aircraft: Aircraft, dt: float = 1e-3, samples: int = 1) -> Motors:
    slowest, fastest = (float(target_speed(u, aircraft.propulsion)) for u in (IDLE, 1.0))
    return Motors(aircraft, dt, samples, slowest, fastest)


def random_commands(aircraft: Aircraft, count: int, thrust: float) -> Commands:
    """From rest at `thrust`, of the weight, to rates of 100 deg/s an axis."""
    wanted = np.deg2rad(np.random.default_rng(7).normal(0.0, 100.0, (count, 3)))
    weight = aircraft.mass_properties.mass * GRAVITY
    return Commands(np.zeros_like(wanted), wanted, np.full(count, thrust * weight))


@cache
def fuller_cost(order: int, curve: float) -> float:
    """Integral of |x|^order from x = 1 at rest, where x'' = -1 until x = curve x'^2, then 1 until x' = 0.

    There x rests again, nearer by a factor, and all goes on mirrored.
    """
    turn = 1.0 / np.sqrt(curve + 0.5)
    nearer = (0.5 - curve) / (0.5 + curve)
    away = quad(lambda t: abs(1.0 - t * t / 2) ** order, 0.0, turn)[0]
    back = quad(lambda t: abs(t * t / 2 - nearer) ** order, 0.0, turn, points=[np.sqrt(2 * nearer)])[0]
    return float((away + back) / (1.0 - nearer ** (order + 0.5)))


def test_the_constant_of_fullers_switching_curve_is_the_known_one() -> None:
    # Fuller 1963, as textbooks have it: sqrt((sqrt(33) - 1) / 24).
    found = minimize_scalar(lambda c: fuller_cost(2, float(c)), bounds=(0.3, 0.49), method="bounded")
    assert found.x == pytest.approx(np.sqrt((np.sqrt(33.0) - 1.0) / 24.0), abs=1e-4)


@pytest.mark.parametrize("order", [1, 2])
def test_a_small_turn_costs_what_fullers_problem_does(order: int) -> None:
    """Fast rotors with limited torque: only the second derivative of the body's rate is limited."""
    propulsion = replace(
        NF1.propulsion,
        response=TorqueResponse(gain=1.0, torque_up=0.05, torque_down=0.1),
        drag_coefficient=0.0,
        rolling_coefficient=0.0,
    )
    aircraft, dt, step = replace(NF1, propulsion=propulsion), 1e-5, np.deg2rad(1.0)
    weight = aircraft.mass_properties.mass * GRAVITY
    commands = Commands(np.zeros((1, 3)), np.array([[step, 0.0, 0.0]]), np.array([4.0 * weight]))
    motors = motors_of(aircraft, dt, samples=1000)  # the mean of a step's speeds acts, nearly
    found = search(motors, commands, 500, squared=order == 2)
    speed = trim(motors, commands)[0]
    levers = np.abs(aircraft.rotor_positions[:, 1])
    slope = 2.0 * propulsion.thrust_coefficient[0] * speed
    torques = (0.05 + 0.1) / propulsion.rotor_inertia / 2  # [rad/s^2], mean of the pairs, of which one gains
    fastest = float((levers * slope).sum()) * torques / aircraft.mass_properties.inertia[0, 0]
    best = minimize_scalar(lambda c: fuller_cost(order, float(c)), bounds=(0.3, 0.49), method="bounded").fun
    expected = best * np.rad2deg(step) ** order * np.sqrt(step / fastest)
    total = 3.0 * (found.squared if order == 2 else found.absolute)[0]
    # The sum begins after the first step; the thrust's slope changes by a hundredth on the way.
    assert dt * (total + 0.5 * np.rad2deg(step) ** order) == pytest.approx(expected, rel=0.005)


@pytest.mark.parametrize("aircraft", [NF1, LAGGING], ids=["limited", "first order"])
def test_slopes_are_those_of_differences(aircraft: Aircraft) -> None:
    motors, commands = motors_of(aircraft, samples=4), random_commands(aircraft, 3, 1.0)
    start = np.random.default_rng(1).uniform(0.1, 0.9, (3, 40, 4))

    def flown(decision: Array) -> Found:
        return search(motors, commands, 40, squared=True, start=decision, iterations=0)

    slope = flown(start).slope
    for episode, step, motor in ((0, 0, 0), (1, 7, 1), (2, 20, 2), (0, 38, 3)):
        moved = np.zeros_like(start)
        moved[episode, step, motor] = 1e-5
        difference = (flown(start + moved).squared - flown(start - moved).squared)[episode] / 2e-5
        assert slope[episode, step, motor] == pytest.approx(difference, rel=1e-4)


def flown_by_twin(motors: Motors, found: Found) -> Array:
    """Rates (E, N, 3) [rad/s] after each step, of motor values that make the rotors turn as found."""
    aircraft, speed = motors.aircraft, found.speed
    episodes, steps = speed.shape[0], speed.shape[1] - 1
    rise, fall = response_rows(aircraft.propulsion, motors.dt, np.ones(1))[0, :2]
    gained = np.diff(speed, axis=1)
    if isinstance(aircraft.propulsion.response, TorqueResponse):
        fall = rise
    target = speed[:, :-1] + gained / np.where(gained > 0.0, rise, fall)
    fractions = np.linspace(0.0, 1.0, 20001)
    # A target that the torque's limit does not let the rotor follow at once stands for any further one.
    command = np.interp(target, target_speed(fractions, aircraft.propulsion), fractions)
    at_rest = np.interp(speed[:, 0], target_speed(fractions, aircraft.propulsion), fractions)
    rate_hz = round(motors.samples / motors.dt)
    delay = max(1, round(aircraft.propulsion.delay * rate_hz))
    rates = []
    with closing(
        Twin(aircraft, episodes, rate_hz=rate_hz, noise=False, rng=np.random.default_rng(0))
    ) as twin:
        for _ in range(rate_hz):
            twin.step(at_rest)
        for sample in range(delay + steps * motors.samples):
            twin.step(command[:, min(sample // motors.samples, steps - 1)])
            if sample >= delay and (sample - delay + 1) % motors.samples == 0:
                rates.append(twin.rate.copy())
    return np.array(rates).swapaxes(0, 1)


@pytest.mark.parametrize("samples", [1, 4])
@pytest.mark.parametrize("aircraft", [NF1, LAGGING], ids=["limited", "first order"])
def test_the_twin_flies_what_was_found(aircraft: Aircraft, samples: int) -> None:
    motors, commands = motors_of(aircraft, samples=samples), random_commands(aircraft, 6, 1.0)
    found = search(motors, commands, 120, squared=False)
    size = np.abs(commands.wanted).max(axis=1)[:, None, None]
    assert flown_by_twin(motors, found) / size == pytest.approx(found.rate / size, abs=0.005)


@pytest.mark.parametrize("squared", [False, True])
def test_other_starts_and_more_iterations_find_nothing_less(squared: bool) -> None:
    motors, commands = motors_of(NF1), random_commands(NF1, 16, 0.5)
    found = search(motors, commands, 120, squared=squared)
    total = found.squared if squared else found.absolute
    rng = np.random.default_rng(3)
    for _ in range(3):
        start = np.clip(found.decision + rng.uniform(-0.5, 0.5, found.decision.shape), 0.02, 0.98)
        other = search(motors, commands, 120, squared=squared, start=start, iterations=60)
        assert ((other.squared if squared else other.absolute) >= (1.0 - 1e-3) * total).all()
    assert (found.bound <= total).all()
    assert found.bound.sum() >= 0.99 * total.sum()


def test_the_least_absolute_error_is_not_the_least_squared_one() -> None:
    motors, commands = motors_of(NF1), random_commands(NF1, 16, 1.0)
    absolute, squared = (search(motors, commands, 120, squared=each) for each in (False, True))
    assert (absolute.absolute < 0.99 * squared.absolute).all()
    assert (squared.squared < absolute.squared).all()


@pytest.mark.parametrize("name", ["nf1", "iris", "hexa"])
def test_trim_holds_the_rate_with_the_thrust(name: str) -> None:
    aircraft = load_aircraft(name)
    commands = random_commands(aircraft, 5, 1.5)
    turning = replace(commands, held=commands.wanted)
    speed = trim(motors_of(aircraft), turning)
    assert thrust_and_torque(speed, aircraft.propulsion)[0].sum(axis=1) == pytest.approx(
        turning.thrust, rel=1e-6
    )
    # Nothing to do: no error from there on.
    still = search(motors_of(aircraft), turning, 50, squared=True)
    assert (still.squared < 1e-3).all()


def test_rotors_are_never_slower_than_their_least_motor_value_lets_them() -> None:
    commands = random_commands(NF1, 5, 0.001)
    motors = motors_of(NF1)
    assert trim(motors, commands).min() >= motors.slowest
    found = search(motors, replace(commands, thrust=np.full(5, 2.0)), 80, squared=True)
    assert found.speed.min() >= motors.slowest - 1e-6
    assert found.speed.max() <= motors.fastest + 1e-6
