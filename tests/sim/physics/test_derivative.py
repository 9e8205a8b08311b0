"""Derivatives of a step against differences of the twin itself, pybullet included."""

from __future__ import annotations

from dataclasses import astuple, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from sim.aircraft.model import (
    Aircraft,
    FirstOrderResponse,
    Response,
    TorqueResponse,
    load_aircraft,
    shipped,
)
from sim.physics.derivative import StepModel
from sim.physics.twin import Twin
from sim.physics.variation import Variation

Array = NDArray[np.float64]
RATE_HZ = 1000
# Large enough that the twin's own rounding does not show, small enough that the equations are straight.
SPEED_STEP, RATE_STEP, COMMAND_STEP = 1e-2, 1e-3, 1e-5


def stepped(aircraft: Aircraft, speed: Array, rate: Array, command: Array) -> tuple[Array, Array]:
    """Rotor speeds and rates of N twins after one step from `speed` and `rate` under `command`."""
    twin = Twin(aircraft, len(speed), rate_hz=RATE_HZ, noise=False, rng=np.random.default_rng(0))
    try:
        for _ in range(round(aircraft.propulsion.delay * RATE_HZ)):
            twin.step(command)
        twin._world.reset(range(len(speed)), rate)
        twin.live.rotor_speed[:] = speed
        twin.step(command)
        return twin.rotor_speed, twin.rate
    finally:
        twin.close()


def differences(
    aircraft: Aircraft, speed: Array, rate: Array, command: Array
) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
    """Of w' and of r' by each of w, r and c, rows by what was moved; one state (M,), (3,), (M,)."""
    motors = len(speed)
    moved = np.diag([SPEED_STEP] * motors + [RATE_STEP] * 3 + [COMMAND_STEP] * motors)
    state = np.concatenate([speed, rate, command]) + np.concatenate([moved, -moved])
    ends = stepped(aircraft, *np.split(state, [motors, motors + 3], axis=1))
    parts = []
    for end in ends:
        slope = (end[: len(moved)] - end[len(moved) :]) / (2.0 * moved.diagonal()[:, None])
        parts.append(tuple(np.split(slope, [motors, motors + 3])))
    return parts[0], parts[1]


def states(aircraft: Aircraft, count: int) -> tuple[Array, Array, Array]:
    """Rotor speeds, rates and commands of flights that are anything but gentle."""
    rng = np.random.default_rng(7)
    motors, fastest = aircraft.motor_count, aircraft.propulsion.speed_max
    return (
        rng.uniform(0.1, 0.9, (count, motors)) * fastest,
        rng.normal(0.0, 8.0, (count, 3)),
        rng.uniform(0.05, 0.95, (count, motors)),
    )


@pytest.mark.parametrize("name", shipped())
def test_derivatives_are_those_of_the_twin_when_it_flies_wildly(name: str) -> None:
    aircraft = load_aircraft(name)
    speeds, rates, commands = states(aircraft, 12)
    model = StepModel.of(aircraft, RATE_HZ, Variation.nominal(len(speeds), 0.0))
    found = model.derivatives(speeds, rates, commands)
    for i in range(len(speeds)):
        of_speed, of_rate = differences(aircraft, speeds[i], rates[i], commands[i])
        assert np.diag(of_speed[0]) == pytest.approx(found.speed_by_speed[i], rel=1e-6, abs=1e-6)
        assert np.diag(of_speed[2]) == pytest.approx(found.speed_by_command[i], rel=1e-5, abs=1e-4)
        scale = np.abs(of_rate[0]).max(), 1.0, np.abs(of_rate[2]).max()
        analytic = found.rate_by_speed[i], found.rate_by_rate[i], found.rate_by_command[i]
        for numeric, exact, size in zip(of_rate, analytic, scale, strict=True):
            assert exact == pytest.approx(numeric, rel=1e-4, abs=1e-4 * size)


def test_pull_is_the_transposed_map_of_the_twin_when_a_loss_weighs_what_came_after() -> None:
    aircraft = load_aircraft("nf1")
    speeds, rates, commands = states(aircraft, 3)
    model = StepModel.of(aircraft, RATE_HZ, Variation.nominal(3, 0.0))
    rng = np.random.default_rng(1)
    on_speed, on_rate = rng.normal(size=(3, 4)), rng.normal(size=(3, 3))
    pull = model.derivatives(speeds[None], rates[None], commands[None]).pull(0, on_speed, on_rate)
    for i in range(3):
        of_speed, of_rate = differences(aircraft, speeds[i], rates[i], commands[i])
        for part, found in enumerate((pull.speed, pull.rate, pull.command)):
            expected = of_speed[part] @ on_speed[i] + of_rate[part] @ on_rate[i]
            assert found[i] == pytest.approx(expected, rel=1e-4, abs=1e-6)


def test_derivatives_are_zero_by_command_when_the_motor_torque_is_at_its_clamp() -> None:
    aircraft = load_aircraft("nf1")
    model = StepModel.of(aircraft, RATE_HZ, Variation.nominal(1, 0.0))
    still = np.zeros((1, 4))
    found = model.derivatives(still + 500.0, np.zeros((1, 3)), still + 1.0)
    assert not found.speed_by_command.any()
    assert np.array_equal(found.speed_by_speed, np.ones((1, 4)))


def test_derivatives_follow_coefficients_when_they_are_polynomials_of_speed() -> None:
    aircraft = load_aircraft("nf1")
    curved = replace(aircraft.propulsion, thrust_coefficient=(7e-7, 1e-10), torque_ratio=(8e-3, 2e-7, 1e-10))
    aircraft = replace(aircraft, propulsion=curved)
    speeds, rates, commands = states(aircraft, 1)
    found = StepModel.of(aircraft, RATE_HZ, Variation.nominal(1, 0.0)).derivatives(speeds, rates, commands)
    _, of_rate = differences(aircraft, speeds[0], rates[0], commands[0])
    assert found.rate_by_speed[0] == pytest.approx(of_rate[0], rel=1e-3, abs=1e-4 * np.abs(of_rate[0]).max())


VARIED = {"inertia": 1.3, "thrust": 0.8, "torque": 1.4, "speed": 0.9, "lag": 2.0}


@pytest.mark.parametrize("name", ["nf1", "hexa"])
@pytest.mark.parametrize("parameter", VARIED)
def test_derivatives_are_those_of_a_changed_aircraft_when_it_is_varied(name: str, parameter: str) -> None:
    aircraft, factor = load_aircraft(name), VARIED[parameter]
    speeds, rates, commands = states(aircraft, 2)
    variation = replace(Variation.nominal(2, 0.0), **{parameter: np.full(2, factor)})
    found = StepModel.of(aircraft, RATE_HZ, variation).derivatives(speeds, rates, commands)
    other = changed(aircraft, parameter, factor)
    for i in range(2):
        of_speed, of_rate = differences(other, speeds[i], rates[i], commands[i])
        assert np.diag(of_speed[2]) == pytest.approx(found.speed_by_command[i], rel=1e-5, abs=1e-4)
        for part, exact in ((0, found.rate_by_speed[i]), (2, found.rate_by_command[i])):
            assert exact == pytest.approx(of_rate[part], rel=1e-3, abs=1e-4 * np.abs(of_rate[part]).max())


def changed(aircraft: Aircraft, parameter: str, factor: float) -> Aircraft:
    """The aircraft whose file says what the variation of `parameter` stands for."""
    old, mass = aircraft.propulsion, aircraft.mass_properties
    a, b, c = old.speed_curve
    thrust = tuple(factor * term for term in old.thrust_coefficient)
    match parameter:
        case "inertia":
            return replace(aircraft, mass_properties=replace(mass, inertia=factor * mass.inertia))
        case "thrust":
            propulsion = replace(old, thrust_coefficient=thrust)
        case "torque":
            propulsion = replace(old, torque_ratio=tuple(factor * term for term in old.torque_ratio))
        case "speed":
            propulsion = replace(old, speed_curve=(factor * a, factor * b, factor * c))
        case _:
            propulsion = replace(old, response=slower(old.response, factor))
    return replace(aircraft, propulsion=propulsion)


def slower(response: Response, factor: float) -> Response:
    """A response whose every time is `factor` times as long."""
    if isinstance(response, TorqueResponse):
        return TorqueResponse(*(value / factor for value in astuple(response)))
    return FirstOrderResponse(*(value * factor for value in astuple(response)))
