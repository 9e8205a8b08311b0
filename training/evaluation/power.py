"""Power that controllers draw from the aircraft's battery: disarmed, armed idling, and in flight.

Disarmed, the battery feeds the electronics alone. Armed idling, the aircraft stands on the ground with the
throttle closed and its gyro's noise, as a multimeter in line with the battery saw it (Koch 2019, ch. 4). In
flight each controller is held at its centre at the throttle that gives a thrust at rest; there it rests, and
then follows the commands of a task, so that its error stands beside what it draws.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.aircraft.model import Battery
from neuroflight.sim.analysis.confidence import Mean, mean_of
from neuroflight.sim.physics.battery import BatteryState
from neuroflight.sim.physics.world import Mount
from neuroflight.training.evaluation.comparison import values
from neuroflight.training.evaluation.controllers import AnyController, Conditions
from neuroflight.training.evaluation.evaluation import Flights, scores
from neuroflight.training.evaluation.thrust import Bar, Trim, transparency, trims
from neuroflight.training.tasks.task import EpisodicTask

SAMPLE_S = 0.001
SETTLING = 10  # samples until voltage and current of a constant power agree
SPIN_UP_S = 0.5  # left out of idling and rest: rotors and filters settle


@dataclass(frozen=True)
class Draw:
    """Voltage, current and power of the battery, mean over time, then over aircraft."""

    volts: Mean  # [V], under load
    amps: Mean  # [A]
    watts: Mean  # [W]


@dataclass(frozen=True)
class PowerAtThrust:
    """A controller at one thrust."""

    trim: Trim
    rest: Draw  # without any command
    commands: Draw  # following the task's
    mae: Mean  # [deg/s], mean of the axes, of the task's commands


@dataclass(frozen=True)
class Drawn:
    """Draw of a controller on the ground and in flight."""

    controller: AnyController
    idling: Draw  # on the ground, throttle closed
    flown: tuple[PowerAtThrust, ...]  # by thrust, as asked


def disarmed(battery: Battery, charge: float) -> Draw:
    """Return the load that stopped motors leave: the electronics. charge: 0..1."""
    pack = BatteryState(battery, 1)
    pack.reset(np.arange(1), charge)
    for _ in range(SETTLING):
        pack.step(np.full(1, battery.electronics_power), SAMPLE_S)
    return _draw(pack.voltage.copy(), pack.current[:, None].copy())


def power(
    controller: AnyController, conditions: Conditions, thrusts: Sequence[float], idle_s: float, bar: Bar
) -> Drawn:
    """Let a controller idle for `idle_s` and fly at each of `thrusts`, of the weight.

    conditions: with the charge of the batteries. Raises AircraftError where the aircraft lacks a battery or
    a body that could stand.
    """
    still = EpisodicTask(distribution="normal", sigma_deg_s=0.0, hold_s=SPIN_UP_S + idle_s)
    standing = replace(conditions, task=still, mount=Mount.FREE, ground=True)
    idling = settled(standing.fly(controller, 0.0, bar(f"{controller.label}, idling")))
    if not thrusts:
        return Drawn(controller, idling, ())
    known = transparency(controller, conditions, bar(f"{controller.label}, at rest"))
    resting = replace(conditions, task=still)
    flown = []
    for trim in trims(known, conditions, thrusts, bar(f"{controller.label}, throttles")):
        throttle = trim.rest.throttle
        rest = settled(resting.fly(controller, throttle, bar(f"{controller.label}, throttle {throttle:.3f}")))
        flights = conditions.fly(controller, throttle, bar(f"{controller.label}, commands"))
        errors = values(scores(flights))["mae"].mean(axis=1)
        flown.append(PowerAtThrust(trim, rest, _of(flights, 0), mean_of(errors)))
    return Drawn(controller, idling, tuple(flown))


def settled(flights: Flights) -> Draw:
    """Return the figures of flights after SPIN_UP_S."""
    return _of(flights, round(SPIN_UP_S / flights.step_s))


def _of(flights: Flights, first: int) -> Draw:
    assert flights.volts is not None and flights.current is not None  # every charge gives a battery
    return _draw(flights.volts[:, first:], flights.current[:, first:])


def _draw(volts: NDArray[np.floating], amps: NDArray[np.floating]) -> Draw:
    """Return the means of (E, T), over T and then over E."""
    each, drawn = volts.astype(np.float64), amps.astype(np.float64)
    return Draw(*(mean_of(series.mean(axis=1)) for series in (each, drawn, each * drawn)))
