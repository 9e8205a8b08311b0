"""The least error after a command that any motors could leave, found over motors' sequences.

The search is in C (`c/open_loop.c`): an interior-point method along the derivatives of the learner's rotors
and body. Each sequence that it finds is one that the motors of the file can make, so no less error is left
than the least possible; how much more is bounded only as far as the error is linear in what motors do, see
`Found.bound`. An independent cone solver agrees within 0.15 % (docs/explanation/decisions/evaluation.md).
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.arrays import Array
from neuroflight.sim.physics.rotor import next_speed, response_rows, rotor_geometry, thrust_and_torque
from neuroflight.training.learners.network.library import aligned, load, pointer
from neuroflight.training.learners.pathwise.plan import put_aircraft

NUMBER = "float64"
LANES = 16  # as api.h says
ITERATIONS = 30
BARRIER = (10.0, 1e-5)  # with them 30, 40 and 60 iterations agree within 1e-4, on each shipped aircraft
MARGIN = 0.02  # of a decision's range, that the search starts away from its limits
LAST = 0.1  # of the steps, in which a sequence that ended has no error
SETTLED = 1e-3  # of the mean error at the start, that it may have there
NEWTON = 10  # steps to the rotors' speeds in trim
RAISE = 1.02  # of the thrust, until every rotor turns as fast as its motor's least value lets it
RAISES = 200


@dataclass(frozen=True, eq=False)
class Commands:
    """The sudden commands of E aircraft: from a held rate to a wanted one."""

    held: Array  # (E, 3) [rad/s]
    wanted: Array  # (E, 3) [rad/s]
    thrust: Array  # (E,) [N], of all rotors while the rate is held; 0: they stand, as before a flight

    def at(self, which: NDArray[np.intp]) -> Commands:
        """Return the rows of `which`."""
        return Commands(self.held[which], self.wanted[which], self.thrust[which])


@dataclass(frozen=True)
class Motors:
    """The limits of motors and rotors, and the time of a step."""

    aircraft: Aircraft
    dt: float  # [s], of a step
    samples: int  # of the twin, in a step
    slowest: float  # [rad/s], rotor speed that the least motor value settles at
    fastest: float  # [rad/s], likewise the greatest


@dataclass(frozen=True, eq=False)
class Found:
    """The sequences of E commands over N steps, from the first that motors can act in."""

    absolute: Array  # (E,) [deg/s], sum over the steps of |e|, mean of the axes
    squared: Array  # (E,) [deg^2/s^2], likewise of e^2
    bound: Array  # (E,), of the one that was sought: none is below it, were the error linear in the decisions
    settled: NDArray[np.bool_]  # (E,), whether no error is left in the last steps
    decision: Array  # (E, N, M), 0..1: see c/open_loop.c
    slope: Array  # (E, N, M), of the one that was sought, by the decisions
    rate: Array  # (E, N, 3) [rad/s], after each step
    speed: Array  # (E, N + 1, M) [rad/s], of the rotors before the first and after each step


def trim(motors: Motors, commands: Commands) -> Array:
    """Compute rotor speeds (E, M) [rad/s] that hold the rates with the thrust.

    With more thrust where a rotor would have to be slower than its motor lets it.
    """
    aircraft, rate = motors.aircraft, commands.held
    inertia, count = aircraft.mass_properties.inertia, aircraft.motor_count
    slowest = np.full(count, motors.slowest)
    least = float(thrust_and_torque(slowest, aircraft.propulsion)[0].sum())
    thrust = np.where(commands.thrust > 0.0, np.maximum(commands.thrust, least), 0.0)
    wanted = np.column_stack([np.cross(rate, rate @ inertia.T), thrust])
    even = np.full((len(rate), count), 0.5 * (motors.slowest + motors.fastest))
    for _ in range(RAISES):
        speed = _balanced(aircraft, rate, wanted, even)
        low = (speed.min(axis=1) < motors.slowest) & (commands.thrust > 0.0)
        if not low.any():
            break
        wanted[low, 3] *= RAISE
    return np.where(commands.thrust[:, None] > 0.0, np.clip(speed, motors.slowest, motors.fastest), 0.0)


def _balanced(aircraft: Aircraft, rate: Array, wanted: Array, start: Array) -> Array:
    """Compute rotor speeds (E, M) of moments and thrust `wanted` (E, 4), by Newton's shortest steps."""
    geometry, propulsion = rotor_geometry(aircraft), aircraft.propulsion
    twist = np.concatenate([np.zeros_like(rate), rate], axis=1)

    def made(speed: Array) -> Array:
        thrust, torque = thrust_and_torque(speed, propulsion)
        moving = (speed[:, :, None] * twist[:, None, :]).reshape(len(speed), -1)
        wrench = thrust @ geometry.thrust_wrench + torque @ geometry.torque_wrench
        wrench = wrench + moving @ geometry.motion_wrench
        return np.concatenate([wrench[:, 3:], wrench[:, 2:3]], axis=1)

    speed = start.copy()
    for _ in range(NEWTON):
        now = made(speed)
        slopes = np.empty((*now.shape, speed.shape[1]))
        for motor in range(speed.shape[1]):
            moved = speed.copy()
            moved[:, motor] += 1e-3
            slopes[:, :, motor] = (made(moved) - now) / 1e-3
        step = np.einsum("emk,ek->em", np.linalg.pinv(slopes), wanted - now)
        speed = np.maximum(speed + step, 0.1 * speed)
    return speed


def search(
    motors: Motors,
    commands: Commands,
    steps: int,
    *,
    squared: bool,
    start: Array | None = None,
    iterations: int = ITERATIONS,
) -> Found:
    """Search the sequences over `steps` with the least sum of |e|, or of e^2.

    start: decisions (E, steps, M) that the search begins with; None: those that keep the rotors' speeds.
    """
    load("pathwise", NUMBER)  # built here, if it has to be, and not by each thread
    count = len(commands.wanted)
    speed = trim(motors, commands)
    if start is None:
        start = np.repeat(_at_rest(motors, speed)[:, None], steps, axis=1)
    blocks = [np.arange(first, first + LANES) for first in range(0, count, LANES)]
    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        work = (
            pool.submit(_block, motors, commands.at(which), speed[which], start[which], squared, iterations)
            for which in (np.where(block < count, block, 0) for block in blocks)
        )
        parts = [each.result() for each in list(work)]
    columns = (np.concatenate(column)[:count] for column in zip(*parts, strict=True))
    return Found(*columns)


def _block(
    motors: Motors, commands: Commands, speed: Array, start: Array, squared: bool, iterations: int
) -> tuple[NDArray[Any], ...]:
    """Compute the columns of Found of LANES commands."""
    loaded = load("pathwise", NUMBER)
    propulsion, count = motors.aircraft.propulsion, motors.aircraft.motor_count
    plan = loaded.ffi.new("struct plan *")
    put_aircraft(plan, motors.aircraft, motors.dt)
    one = np.ones(LANES)
    away = np.abs(np.rad2deg(commands.wanted - commands.held))
    scale = (away * away if squared else away).mean(axis=1)
    steps = start.shape[1]
    rate, after = np.empty((steps, 3, LANES)), np.empty((steps, count, LANES))
    decision, slope = np.ascontiguousarray(start.transpose(1, 2, 0)), np.empty_like(after)
    figures = np.empty((4, LANES))
    arrays = {
        "scale": np.maximum(scale, 1e-6),
        "lowest": motors.slowest * one,
        "highest": motors.fastest * one,
        "wanted": _rows(commands.wanted),
        "rate": _rows(commands.held),
        "rotor_speed": _rows(speed),
        "decision": decision,
        "gradient": slope,
        "figures": figures,
        "rate_after": rate,
        "speed_after": after,
    }
    block, sought = loaded.ffi.new("struct block *"), loaded.ffi.new("struct open_loop *")
    response = _rows(response_rows(propulsion, motors.dt, one))
    block.response = pointer(response)
    block.lift = block.drag = block.light = pointer(one)
    sought.steps, sought.squared, sought.iterations, sought.barrier = steps, squared, iterations, BARRIER
    # The twin's wrench in a sample is that of the speeds after it.
    sought.middle = (motors.samples + 1) / (2 * motors.samples)
    for name, array in arrays.items():
        setattr(sought, name, pointer(array))
    memory = aligned(loaded.lib.open_loop_memory(plan, sought), NUMBER)
    loaded.lib.open_loop_run(plan, block, sought, pointer(memory))
    left = np.rad2deg(np.abs(commands.wanted.T - rate[-max(1, round(LAST * steps)) :])).mean(axis=(0, 1))
    settled = left <= SETTLED * away.mean(axis=1)
    found, by_found, rates, speeds = (part.transpose(2, 0, 1) for part in (decision, slope, rate, after))
    speeds = np.concatenate([speed[:, None], speeds], axis=1)
    return figures[0], figures[1], figures[3], settled, found, by_found, rates, speeds


def _rows(array: Array) -> Array:
    """Return rows for C of an array whose first axis is the lanes."""
    return np.ascontiguousarray(array.T, NUMBER)


def _at_rest(motors: Motors, speed: Array) -> Array:
    """Return decisions that keep the rotors' speeds, or nearly, where those are at a limit."""
    propulsion = motors.aircraft.propulsion
    low, high = (
        next_speed(speed, settles, motors.dt, propulsion) for settles in (motors.slowest, motors.fastest)
    )
    # From standstill the torque's limit may leave nothing to decide: any decision is as good.
    part = np.divide(speed - low, high - low, out=np.full_like(speed, 0.5), where=high > low)
    return np.clip(part, MARGIN, 1.0 - MARGIN)
