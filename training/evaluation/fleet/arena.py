"""Flights of one controller on one unseen aircraft, and what is told of them.

All fly at equal thrust: before its flights a controller rests at throttles until it gives the thrusts of
LEVELS, as thrust.py does, with fewer throttles. Commands are what a pilot's sticks can say, gyros give 4 kHz,
every battery has the aircraft's charge and every motor its share.

pulses: short ones of several thrusts, held at the centre of mass.
minute: ten pulses and a hover in one flight, at the weight, nothing reset in it.
wash: free and level, the throttle closed and opened so that it sinks into its own wake and is caught.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.analysis.metrics import CHANGE_S
from neuroflight.sim.arrays import Array
from neuroflight.sim.design.figures import aircraft_figures
from neuroflight.sim.physics.rotor import target_speed, thrust_and_torque
from neuroflight.sim.physics.world import Mount
from neuroflight.toolchain.contract import GRAVITY, GYRO_RATE_DEFAULT_HZ
from neuroflight.training.evaluation.controllers import AnyController, Conditions
from neuroflight.training.evaluation.evaluation import Event, Flights
from neuroflight.training.evaluation.fleet.unseen import Unseen
from neuroflight.training.evaluation.robustness import DIVERGED_DRIFT, DIVERGED_FLOOR, DIVERGED_RATE
from neuroflight.training.tasks.flight import FlightTask
from neuroflight.training.tasks.task import EpisodicTask, PulseTask

LEVELS = (0.4, 1.0, 2.0, 3.5)  # of the weight, of the pulses; those that leave room
ROOM = 0.65  # of an aircraft's greatest thrust: the rest is to steer with
PULSE = PulseTask(idle_s=0.3, command_s=1.1, rest_s=0.8)
MINUTE = FlightTask()
WASH = (  # s, of the weight: after a hover, three descents into the wake, caught each time, and a hover
    (1.5, 1.0),
    *((1.0, 0.6), (0.4, 0.15), (0.7, 2.0), (0.6, 1.0)) * 3,
    (1.0, 1.0),
)
SETTLE_S = 1.0  # of free flight until the rotors carry it: not counted
REST_S, REST_LAST_S = 0.5, 0.2  # at a throttle, and its end of which the mean thrust counts
ROUNDS = 3  # of the search for throttles, at most
NEAR = 0.02  # of the thrust wanted, at which the search ends
REACHED = 0.05  # of it: beyond, the controller flies at another thrust than the others, which is told
FULL = 0.999  # motor fraction
AT_REST_S = 0.4  # end of an episode whose rates are told as rest
KINDS = ("pulses", "minute", "wash")

Progress = Callable[[float], None]  # the part that is done, 0..1


@dataclass(frozen=True)
class Figures:
    """Figures of the flights of one kind."""

    mae: float  # [deg/s], mean of axes and flights
    mse: float  # [deg^2/s^2]
    axes: tuple[float, float, float]  # MAE of each axis [deg/s]
    change: float  # mean |change| of a motor's fraction in 1 ms
    standing: float  # [deg/s], |mean rate| in the last 0.4 s of an episode, at rest: what no integral removes
    swing: float  # [deg/s], deviation of the rate from that mean
    overshoot: float  # most past a command, in parts of its jump, mean of the axes
    full: float  # share of time with a motor at full command
    lost: int  # flights
    count: int  # flights
    by_thrust: tuple[tuple[float, float], ...]  # thrust over weight, MAE [deg/s] at it; of the pulses
    off: float  # largest distance of a thrust at rest from the wanted one, of that
    drift: float = 0.0  # [deg] in ten seconds of hover, worst axis; of the minute

    def document(self) -> dict[str, Any]:
        """Return JSON data."""
        return asdict(self)

    @staticmethod
    def of(document: dict[str, Any]) -> Figures:
        """Return the figures of JSON data."""
        known = {field.name: document[field.name] for field in fields(Figures)}
        pairs = tuple(tuple(pair) for pair in document["by_thrust"])
        return Figures(**known | {"axes": tuple(document["axes"]), "by_thrust": pairs})


@dataclass(frozen=True)
class Plan:
    """The flights of a controller on an aircraft."""

    pulses: int = 8  # of all levels together
    seed: int = 0  # of commands, noise and bias
    flights: tuple[str, ...] = KINDS  # of KINDS


def levels(aircraft: Unseen) -> tuple[float, ...]:
    """Return the thrusts of its pulses, of the weight: those it has room above."""
    return _levels(ROOM * aircraft_figures(aircraft.truth).thrust_to_weight)


def _levels(most: float) -> tuple[float, ...]:
    found = tuple(level for level in LEVELS if level <= most)
    return found if max(found) >= 1.0 else (LEVELS[0], most)


def meet(
    controller: AnyController, aircraft: Unseen, plan: Plan, progress: Progress | None = None
) -> dict[str, Figures]:
    """Fly the plan; return the figures by kind of flight."""
    motors = np.array(aircraft.shares)
    conditions = Conditions(
        aircraft=aircraft.truth,
        task=PULSE,
        episodes=plan.pulses,
        seed=plan.seed,
        charge=aircraft.charge,
        gyro_rate_hz=GYRO_RATE_DEFAULT_HZ,
        sticks=True,
    )
    lift = aircraft_figures(aircraft.truth).thrust_to_weight
    pairing = _Pairing(controller, conditions, Event(0.0, lambda twin: twin.weaken(motors)), lift)
    found = {}
    for number, kind in enumerate(plan.flights):

        def show(done: int, total: int, number: int = number) -> None:
            if progress is not None and done % 200 == 0:
                progress((number + done / total) / len(plan.flights))

        found[kind] = getattr(pairing, kind)(show)
    return found


_Show = Callable[[int, int], None]


@dataclass(frozen=True)
class _Pairing:
    """A controller on an aircraft; a method for each kind of flight returns its figures."""

    controller: AnyController
    conditions: Conditions  # of its pulses
    event: Event  # at their begin: the motors are apart
    lift: float  # the aircraft's thrust over its weight

    def pulses(self, show: _Show) -> Figures:
        asked, episodes = _levels(ROOM * self.lift), self.conditions.episodes
        at, off = self._throttles(asked)
        each = np.array([at[asked[number % len(asked)]] for number in range(episodes)], np.float32)
        flights = self.conditions.fly(self.controller, each, show, event=self.event)
        found = _figures(flights, flights.setpoint, flights.rate, max(off.values()))
        error = np.rad2deg(np.abs(flights.setpoint - flights.rate)).mean(axis=(1, 2), dtype=np.float64)
        by_thrust = tuple(
            (level, float(error[n :: len(asked)].mean())) for n, level in enumerate(asked[: len(error)])
        )
        return replace(found, by_thrust=by_thrust)

    def minute(self, show: _Show) -> Figures:
        at, off = self._throttles((1.0,))
        flight = replace(self.conditions, task=MINUTE, episodes=1)
        flights = flight.fly(self.controller, at[1.0], show, event=self.event)
        rows = flights.commanded
        parts = (1 * MINUTE.pulses, -1, 3)
        setpoint, rate = (each[:, rows].reshape(parts) for each in (flights.setpoint, flights.rate))
        holding = flights.holding()
        assert holding is not None
        drift = float(np.abs(holding.drift).max())
        found = _figures(flights, setpoint, rate, off[1.0])
        lost = int(found.lost > 0 or not drift <= DIVERGED_DRIFT)
        return replace(found, lost=lost, count=1, drift=drift)

    def wash(self, show: _Show) -> Figures:
        most = round(ROOM * self.lift, 3)
        asked = [min(thrust, most) if thrust > 1.0 else thrust for _, thrust in WASH]
        at, off = self._throttles(sorted(set(asked)))
        still = EpisodicTask(distribution="normal", sigma_deg_s=0.0, hold_s=sum(time for time, _ in WASH))
        free = replace(self.conditions, task=still, episodes=1, mount=Mount.FREE)
        rate_hz = self.controller.control_rate_hz
        steps = round(still.duration_s * rate_hz)
        ends = np.cumsum([time for time, _ in WASH]) * rate_hz
        which = np.minimum(np.searchsorted(ends, np.arange(steps), side="right"), len(WASH) - 1)
        stick = np.array([at[thrust] for thrust in asked], np.float32)[which]
        flights = free.fly(self.controller, stick[None], show, event=self.event)
        rows = slice(round(SETTLE_S / flights.step_s), None)
        return _figures(flights, flights.setpoint[:, rows], flights.rate[:, rows], off[1.0])

    def _throttles(self, wanted: Sequence[float]) -> tuple[dict[float, float], dict[float, float]]:
        """Find throttles with these thrusts at rest, of the weight; return them and how far each is off.

        By the aircraft's curve of thrust on the bench supply; a round of flights tells how many fractions of
        the motors are lacking.
        """
        drive, idle = self.conditions.aircraft.propulsion, self.controller.idle
        fractions = np.linspace(0.0, 1.0, 201)
        lifts = thrust_and_torque(target_speed(fractions, drive), drive)[0]
        lifts = np.maximum.accumulate(lifts / lifts[-1] * self.lift)
        still = EpisodicTask(distribution="normal", sigma_deg_s=0.0, hold_s=REST_S)
        resting = replace(self.conditions, task=still, episodes=len(wanted))
        asked = np.array(wanted)
        needed = np.interp(asked, lifts, fractions)
        throttle = best = (needed - idle) / (1.0 - idle)
        got = np.full(len(wanted), np.inf)
        for _ in range(ROUNDS):
            throttle = throttle.clip(0.0, 1.0)
            flights = resting.fly(self.controller, throttle.astype(np.float32), event=self.event)
            assert flights.lift is not None
            last = slice(-round(REST_LAST_S / flights.step_s), None)
            thrust: Array = flights.lift[:, last].mean(axis=1, dtype=np.float64) / GRAVITY
            nearer = np.abs(thrust - asked) < np.abs(got - asked)
            best, got = np.where(nearer, throttle, best), np.where(nearer, thrust, got)
            off = np.abs(got / asked - 1.0)
            if (off <= NEAR).all():
                break
            throttle = throttle + (needed - np.interp(thrust, lifts, fractions)) / (1.0 - idle)
        return dict(zip(wanted, best.tolist(), strict=True)), dict(zip(wanted, off.tolist(), strict=True))


def _figures(
    flights: Flights, setpoint: NDArray[np.float32], rate: NDArray[np.float32], off: float
) -> Figures:
    """Return the figures of episodes (E, T, 3)."""
    error = np.rad2deg(np.subtract(setpoint, rate, dtype=np.float64))
    mae, mse = np.abs(error).mean(axis=1), (error**2).mean(axis=1)  # (E, 3)
    still = np.rad2deg(np.abs(setpoint).mean(axis=(1, 2), dtype=np.float64))
    spun = ~(np.abs(rate).max(axis=(1, 2)) <= DIVERGED_RATE)  # NaN included
    lost = spun | (mae.mean(axis=1) > np.maximum(still, DIVERGED_FLOOR))
    assert flights.motors is not None
    stride = max(1, round(CHANGE_S / flights.step_s))
    motors = flights.motors[:, round(0.2 / flights.step_s) :: stride]  # rotors start from rest
    standing, swing = _rest(setpoint, rate, flights.step_s)
    return Figures(
        mae=float(mae.mean()),
        mse=float(mse.mean()),
        axes=_three(mae.mean(axis=0)),
        change=float(np.abs(np.diff(motors, axis=1)).mean(dtype=np.float64)),
        standing=standing,
        swing=swing,
        overshoot=_overshoot(setpoint, rate),
        full=float((motors >= FULL).any(axis=2).mean()),
        lost=int(lost.sum()),
        count=len(lost),
        by_thrust=(),
        off=off,
    )


def _rest(setpoint: NDArray[np.float32], rate: NDArray[np.float32], step_s: float) -> tuple[float, float]:
    """Return |mean| and deviation [deg/s] of the rate in the last AT_REST_S of episodes that end at rest."""
    last = slice(-round(AT_REST_S / step_s), None)
    quiet = ~setpoint[:, last].any(axis=(1, 2))
    end = np.rad2deg(rate[quiet][:, last].astype(np.float64))
    if not len(end):
        return 0.0, 0.0
    return float(np.abs(end.mean(axis=1)).mean()), float(end.std(axis=1).mean())


def _overshoot(setpoint: NDArray[np.float32], rate: NDArray[np.float32]) -> float:
    """Return how far the rate goes past commands above 20 deg/s, in parts of them."""
    command = np.abs(setpoint).max(axis=1)  # (E, 3); one command an episode
    sign = np.sign(setpoint.sum(axis=1, dtype=np.float64))
    peak = (rate * sign[:, None]).max(axis=1)
    large = command > np.deg2rad(20.0)
    return float(((peak - command)[large] / command[large]).clip(0.0).mean()) if large.any() else 0.0


def _three(values: Array) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z
