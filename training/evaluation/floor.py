"""The least errors of each command that any motors could reach.

A command is followed late by the delay, and then as fast as the rotors' response and the motors' limits let
the aircraft turn: that much no controller can take away. Here each change of the command is flown by the
motors' sequence with the least error, from the change's own step on, as nobody knows a command before.
Before it the rotors hold the old command with the thrust that the controller had there; the thrust is free
until the new rate is reached. There is no noise, and motors have no steps. The least mean absolute error and
the least mean squared error are those of two sequences: nothing reaches both at once.

Left out, as in the learner: the rotors' advance ratio, and the battery's voltage under load. Where rotors
have friction, or gain thrust as they sink, no floor is told. Behind a command
that was held for less than a second the rotors are still on their way, since their acceleration holds a part
of the yaw moment; a controller that is released then can be 0.6 % below.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.arrays import Array
from neuroflight.sim.physics.battery import open_circuit_voltage
from neuroflight.sim.physics.rotor import target_speed
from neuroflight.sim.physics.world import Mount
from neuroflight.toolchain.contract import GRAVITY
from neuroflight.training.evaluation.controllers import AnyController, Conditions
from neuroflight.training.evaluation.evaluation import Flights, Floors, Scores, scores
from neuroflight.training.learners.pathwise.open_loop import Commands, Motors, search

FIRST_S = 0.1  # [s] of a sequence; twice as long where an error is left, and so on
SHORTEST_S = 0.02  # [s] of a command: none can be reached sooner
BEFORE_S = 0.1  # [s] before a change of the command, in which the thrust at rest is taken
LEAST_THRUST = 1e-3  # of the weight


@dataclass(frozen=True, eq=False)
class Changes:
    """C changes of the commands of all episodes."""

    episode: NDArray[np.intp]  # (C,)
    step: NDArray[np.intp]  # (C,), the first one with the new command
    last: NDArray[np.intp]  # (C,), the step after the last one with it
    held: Array  # (C, 3) [rad/s], the command before
    wanted: Array  # (C, 3) [rad/s]


def changes(setpoint: NDArray[np.floating]) -> Changes:
    """Return the changes of setpoints (E, T, 3) [rad/s]. Before an episode the command is zero."""
    before = np.concatenate([np.zeros_like(setpoint[:, :1]), setpoint[:, :-1]], axis=1)
    episode, step = np.nonzero((setpoint != before).any(axis=2))
    last = np.append(step[1:], 0)
    last = np.where(np.append(episode[1:], -1) == episode, last, setpoint.shape[1])
    held, wanted = (np.asarray(part[episode, step], np.float64) for part in (before, setpoint))
    return Changes(episode, step, last, held, wanted)


def floors(
    aircraft: Aircraft,
    setpoint: NDArray[np.floating],
    step_s: float,
    *,
    thrust: float | Array,
    idle: float,
    samples: int = 1,
    charge: float | None = None,
    held: Array | None = None,
) -> Floors | None:
    """Return the least errors of the commands `setpoint` (E, T, 3) [rad/s] in control steps of `step_s` [s].

    thrust: of all rotors before a change of the command, in parts of the weight: one for all, or that of
    each change (C,), see `changes`; idle: least motor fraction, 0..1; samples: steps of the twin in a
    control step, which decide when a command acts; charge: of the battery, 0..1, whose voltage is taken as
    that without load; None: the bench supply; held: the rates that each change begins from (C, 3) [rad/s],
    None: the commands before. None where no floor is known: a command changes before the one before it could
    be reached, as a pilot's sticks do all the time.
    """
    found, steps = changes(setpoint), setpoint.shape[1]
    if len(found.step) and (found.last - found.step).min() * step_s < SHORTEST_S:
        return None
    if held is not None:
        found = replace(found, held=held)
    weight = aircraft.mass_properties.mass * GRAVITY
    before = np.where(found.step == 0, 0.0, np.maximum(thrust, LEAST_THRUST) * weight)
    motors = Motors(aircraft, step_s, samples, *_limits(aircraft, idle, charge))
    delay = max(1, round(aircraft.propulsion.delay / step_s * samples)) / samples
    sums = [_least(motors, found, before, steps, delay, squared=squared) for squared in (False, True)]
    mae, mse = (
        None if each is None else np.bincount(found.episode, each, len(setpoint)) / steps for each in sums
    )
    return None if mae is None or mse is None else Floors(mae, mse)


def scored(flights: Flights, controller: AnyController, conditions: Conditions) -> Scores:
    """Return the figures of each episode with its floors, where those are known: see `floors`."""
    known = scores(flights)
    propulsion = conditions.aircraft.propulsion
    sinks = propulsion.advance is not None and propulsion.advance.ratio_least < 0.0
    if conditions.mount is not Mount.CENTRE or propulsion.friction or sinks:
        return known
    least = floors_of(flights, conditions.aircraft, idle=controller.idle, charge=conditions.charge)
    return replace(known, floors=least)


def floors_of(
    flights: Flights, aircraft: Aircraft, *, idle: float, charge: float | None = None
) -> Floors | None:
    """Return the least errors from the thrust and rates that a controller had before each change.

    Rates, not commands: who is still on the way when the next command comes may have less of it to go.

    Of aircraft that turn about their centre of mass.
    """
    if flights.lift is None or flights.recorded:
        return None
    setpoint = flights.setpoint[:, flights.commanded]
    found = changes(setpoint)
    rows = np.minimum(found.step, max(1, round(BEFORE_S / flights.step_s)))
    total = np.cumsum(flights.lift, axis=1, dtype=np.float64)
    total = np.concatenate([np.zeros((len(total), 1)), total], axis=1)
    force = total[found.episode, found.step] - total[found.episode, found.step - rows]
    last = np.maximum(found.step - 1, 0)
    held = flights.rate[:, flights.commanded][found.episode, last].astype(np.float64)
    return floors(
        aircraft,
        setpoint,
        flights.step_s,
        thrust=force / np.maximum(rows, 1) / GRAVITY,
        idle=idle,
        samples=flights.samples,
        charge=charge,
        held=held,
    )


def _limits(aircraft: Aircraft, idle: float, charge: float | None) -> tuple[float, float]:
    """Return the rotor speeds [rad/s] that the least and the greatest motor fraction settle at."""
    voltage = None
    if charge is not None and aircraft.battery is not None:
        voltage = open_circuit_voltage(aircraft.battery, np.array(charge))
    low, high = (float(target_speed(u, aircraft.propulsion, voltage)) for u in (idle, 1.0))
    return low, high


def _least(
    motors: Motors, found: Changes, thrust: Array, steps: int, delay: float, *, squared: bool
) -> Array | None:
    """Return the least sum over the control steps of each change (C,), of |e| or e^2, mean of the axes.

    None where a command changes before the one before it could be reached.
    """
    away = np.rad2deg(np.abs(found.wanted - found.held))
    sums: Array = (delay + 1.0) * (away**2 if squared else away).mean(axis=1)
    left = found.last - found.step
    free = np.maximum(left - math.ceil(delay) - 1, 1)  # control steps whose error the motors can change
    open_ones, length = np.arange(len(left)), round(FIRST_S / motors.dt)
    while len(open_ones):
        lengths = np.minimum(free[open_ones], length)
        again: list[NDArray[np.intp]] = []
        for steps_now in np.unique(lengths):
            which = open_ones[lengths == steps_now]
            commands = Commands(found.held[which], found.wanted[which], thrust[which])
            result = search(motors, commands, int(steps_now), squared=squared)
            ended = free[which] == steps_now
            if (ended & ~result.settled & (found.last[which] < steps)).any():
                return None
            done = ended | result.settled
            sums[which[done]] += (result.squared if squared else result.absolute)[done]
            again.append(which[~done])
        open_ones, length = np.concatenate(again), 2 * length
    return sums
