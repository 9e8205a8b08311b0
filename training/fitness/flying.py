"""Flies a controller through the course of a check, and takes its figures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.analysis.holding import holding
from neuroflight.sim.analysis.swing import change, swing
from neuroflight.sim.arrays import Array
from neuroflight.sim.physics.world import Mount
from neuroflight.toolchain.contract import GYRO_RATE_DEFAULT_HZ
from neuroflight.training.evaluation.controllers import AnyController, Conditions
from neuroflight.training.evaluation.evaluation import Flights
from neuroflight.training.evaluation.floor import floors_of
from neuroflight.training.evaluation.thrust import THROTTLES, at_rest, throttle_of
from neuroflight.training.fitness.course import (
    FLIGHT,
    GROUND_AIRCRAFT,
    GROUND_S,
    SEED,
    CommandFlight,
    Course,
    Turn,
)
from neuroflight.training.tasks.task import EpisodicTask

Axes = tuple[float, float, float]
Progress = Callable[[float], None]  # the part that is done, 0 to 1
HELD_S = 0.6  # the last part of a full turn, in which its rate is held
BACK_S = 0.3  # the last part of the rest after it
TILT_LAST_S = 0.5  # of the time on the ground, over which motors are averaged
REST_AIRCRAFT = 1  # at each throttle: thrusts need to be known to a few parts in a hundred only


@dataclass(frozen=True)
class CommandFigures:
    """The figures of a flight of ten commands and a hover."""

    mae: float  # [deg/s], mean of the axes, before the hover
    mse: float  # [(deg/s)^2], likewise
    early: Axes  # [deg/s], mean |rate| at rest in the first fifth
    late: Axes  # and in the hover
    drift: Axes  # [deg], turned in 10 s of the hover
    change: float  # mean |change| of a motor's fraction in 1 ms, in the hover
    mae_least: float | None = None  # [deg/s], that any motors could leave; None: not known
    mse_least: float | None = None  # [(deg/s)^2], likewise


@dataclass(frozen=True)
class TurnFigures:
    """The figures of a full turn."""

    swing: float  # motor fraction, amplitude of what its motors do between 20 and 200 Hz while it is held
    swing_hz: float  # where that is largest
    change: float  # mean |change| of a motor's fraction in 1 ms meanwhile
    held: float  # [deg/s], mean absolute error meanwhile, of all axes
    overshoot: float  # beyond the command, of the command
    back: float  # [deg/s], mean absolute error at rest afterwards


@dataclass(frozen=True)
class CourseFigures:
    """All figures of one controller."""

    label: str
    idle: float
    lift: tuple[tuple[float, float], ...]  # throttle, and what it lifts at rest, of the weight
    flights: dict[CommandFlight, CommandFigures]
    turns: dict[Turn, TurnFigures]
    ground_motor: float  # the highest mean fraction of a motor on the ground
    ground_turned: float  # [deg], about any axis there


def fly_course(controller: AnyController, course: Course, progress: Progress | None = None) -> CourseFigures:
    """Fly everything. progress: is called with the part that is done."""
    rate_hz = max(GYRO_RATE_DEFAULT_HZ, controller.control_rate_hz)
    base = Conditions(course.aircraft, FLIGHT, 1, SEED, gyro_rate_hz=rate_hz, sticks=True)
    turning = course.turning()
    seconds = (1.5, FLIGHT.duration_s, turning.duration_s, GROUND_S)
    done = [0.0]

    def part(number: int) -> Callable[[int, int], None]:
        begin = sum(seconds[:number])

        def show(step: int, steps: int) -> None:
            now = (begin + seconds[number] * step / steps) / sum(seconds)
            if progress is not None and now - done[0] >= 0.01:
                done[0] = now
                progress(now)

        return show

    rests = at_rest(controller, base, THROTTLES, part(0), REST_AIRCRAFT)

    def throttles(parts: Sequence[CommandFlight] | Sequence[Turn]) -> NDArray[np.float32]:
        return np.array([throttle_of(rests, each.thrust) for each in parts], np.float32)

    flights: tuple[CommandFigures, ...] = ()
    if course.flights:
        flying = replace(base, episodes=len(course.flights))
        flown = flying.fly(controller, throttles(course.flights), part(1), course.variation())
        flights = with_least(command_figures(flown), course, flown, controller.idle)
    turns: tuple[TurnFigures, ...] = ()
    if course.turns:
        flying = replace(base, task=turning, episodes=len(course.turns))
        turns = turn_figures(flying.fly(controller, throttles(course.turns), part(2)), course)
    still = EpisodicTask(distribution="normal", sigma_deg_s=0.0, hold_s=GROUND_S)
    ground = replace(base, task=still, episodes=GROUND_AIRCRAFT, mount=Mount.FREE, ground=True).fly(
        controller, 0.0, part(3)
    )
    assert ground.motors is not None
    last = slice(-round(TILT_LAST_S / ground.step_s), None)
    turned = np.rad2deg(ground.rate.sum(axis=1, dtype=np.float64) * ground.step_s)
    return CourseFigures(
        label=controller.label,
        idle=controller.idle,
        lift=tuple((rest.throttle, float(rest.thrust.value)) for rest in rests),
        flights=dict(zip(course.flights, flights, strict=True)),
        turns=dict(zip(course.turns, turns, strict=True)),
        ground_motor=float(ground.motors[:, last].mean(axis=1, dtype=np.float64).max()),
        ground_turned=float(np.abs(turned).max()),
    )


def command_figures(flights: Flights) -> tuple[CommandFigures, ...]:
    """Compute the figures of each flight of ten commands."""
    held = holding(
        flights.setpoint,
        flights.rate,
        flights.step_s,
        FLIGHT.pulses,
        flights.rate.shape[1] - round(FLIGHT.hover_s / flights.step_s),
    )
    assert flights.motors is not None
    hover = flights.motors[:, -round(FLIGHT.hover_s / flights.step_s) :]
    return tuple(
        CommandFigures(
            mae=float(held.mae[number].mean()),
            mse=float(held.mse[number].mean()),
            early=_axes(held.early[number]),
            late=_axes(held.hover[number]),
            drift=_axes(held.drift[number]),
            change=change(hover[number], flights.step_s),
        )
        for number in range(len(flights.rate))
    )


def with_least(
    figures: Sequence[CommandFigures], course: Course, flights: Flights, idle: float
) -> tuple[CommandFigures, ...]:
    """Add the least errors that motors could leave, for flights of the aircraft as its file says."""
    found = list(figures)
    as_filed = [number for number, flight in enumerate(course.flights) if flight.condition is None]
    assert flights.lift is not None
    part = replace(
        flights, setpoint=flights.setpoint[as_filed], rate=flights.rate[as_filed], lift=flights.lift[as_filed]
    )
    least = floors_of(part, course.aircraft, idle=idle) if as_filed else None
    if least is not None:
        for number, mae, mse in zip(as_filed, least.mae.tolist(), least.mse.tolist(), strict=True):
            found[number] = replace(found[number], mae_least=mae, mse_least=mse)
    return tuple(found)


def turn_figures(flights: Flights, course: Course) -> tuple[TurnFigures, ...]:
    """Compute the figures of each full turn."""
    assert flights.motors is not None
    step_s = flights.step_s
    end = round((course.turn.idle_s + course.turn.command_s) / step_s)
    held, back = slice(end - round(HELD_S / step_s), end), slice(-round(BACK_S / step_s), None)
    found = []
    for number, turn in enumerate(course.turns):
        error = np.abs(np.rad2deg(flights.setpoint[number] - flights.rate[number], dtype=np.float64))
        rate = np.rad2deg(flights.rate[number, :end, turn.axis], dtype=np.float64)
        amplitude, frequency = swing(flights.motors[number, held], step_s)
        found.append(
            TurnFigures(
                swing=amplitude,
                swing_hz=frequency,
                change=change(flights.motors[number, held], step_s),
                held=float(error[held].mean()),
                overshoot=float((rate / turn.rate_deg_s).max() - 1.0),
                back=float(error[back].mean()),
            )
        )
    return tuple(found)


def _axes(values: Array) -> Axes:
    roll, pitch, yaw = (float(value) for value in values)
    return roll, pitch, yaw
