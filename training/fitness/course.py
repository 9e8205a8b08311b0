"""The course of a check: flights of ten commands and a hover, full turns, and the ground.

All controllers fly the same commands, noise and bias, each at the throttle at which it gives the thrust of a
flight. Times are as short as showed every fault of the policies in tests/training/fitness: a drift grows
within the first ten commands, an oscillation within half a second of a turn.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.design.figures import Endurance, aircraft_figures
from neuroflight.sim.physics.variation import Variation
from neuroflight.toolchain.contract import RATE_FULL_STICK_DEG_S
from neuroflight.training.tasks.flight import FlightTask
from neuroflight.training.tasks.task import GivenCommands, PulseTask

SEED = 2_000_003  # of commands, noise and bias: neither training, monitor nor results use it
THRUSTS = (0.35, 1.0, 2.0, 4.0)  # of the weight, in which the ten commands are flown
LIFT_SHARE = 0.8  # of the lift at full throttle: the most that a flight asks for; the rest is to steer with
HOVER_S = 10.0
FLIGHT = FlightTask(pulses=10, idle_s=0.2, command_s=0.8, rest_s=1.0, hover_s=HOVER_S)  # 30 s
TURN_RATES_DEG_S = (720.0, float(RATE_FULL_STICK_DEG_S))  # two turns a second, and full stick
TURN_THRUSTS = (1.0, 2.5)  # of the weight
AXES = ("roll", "pitch", "yaw")
GROUND_S = 3.0  # on the ground, armed, the throttle closed
GROUND_AIRCRAFT = 4  # gyro biases that are tried there


@dataclass(frozen=True)
class Condition:
    """An aircraft that differs from its file, in words and figures."""

    name: str
    charge: float | None = None  # of the battery; None: the bench supply
    lag: float = 1.0  # factor of the time that the rotors take
    delay_s: float = 0.0  # more than the file's delay


# The rotors' times and the delay are those of an aircraft built to the file: other propellers and ESCs, and
# other settings of these. Every controller flies the same ones, so a bar is not harder where flying is.
CONDITIONS = (
    Condition("quick rotors (0.6 of their time)", lag=0.6),
    Condition("slow rotors (1.5 times their time)", lag=1.5),
    Condition("2 ms less delay", delay_s=-0.002),
    Condition("2 ms more delay", delay_s=0.002),
)
EMPTY_RESERVE = 1.5  # times what a hover draws in a flight: so much an empty battery holds at its beginning


@dataclass(frozen=True)
class CommandFlight:
    """One of the flights of ten commands."""

    name: str
    thrust: float  # of the weight
    condition: Condition | None = None

    @property
    def where(self) -> str:
        """Condition of the flight, within a sentence."""
        return f"at {self.name}" if self.condition is None else f"with {self.name}"


@dataclass(frozen=True)
class Turn:
    """One of the full turns."""

    axis: int
    rate_deg_s: float  # signed
    thrust: float  # of the weight

    @property
    def name(self) -> str:
        """Name of the turn, within a sentence."""
        words = (
            ("roll to the right", "roll to the left"),
            ("forward flip", "backward flip"),
            ("turn to the left", "turn to the right"),
        )
        word = words[self.axis][self.rate_deg_s < 0]
        return f"a {word} of {abs(self.rate_deg_s):g} deg/s at {self.thrust:g} times the weight"


@dataclass(frozen=True)
class Course:
    """All that is flown of one aircraft."""

    aircraft: Aircraft
    flights: tuple[CommandFlight, ...]
    turns: tuple[Turn, ...]

    def nominal(self) -> Course:
        """Return the part of the course in the file's own aircraft, and turns at the lower thrust only.

        Betaflight, whose every copy is a process, flies no more than this beside a PID.
        """
        least = min(turn.thrust for turn in self.turns)
        return replace(
            self,
            flights=tuple(flight for flight in self.flights if flight.condition is None),
            turns=tuple(turn for turn in self.turns if turn.thrust == least),
        )

    @property
    def turn(self) -> PulseTask:
        """Rest, a full turn held, rest again."""
        return PulseTask(idle_s=0.3, command_s=1.1, rest_s=0.6)

    def turning(self) -> GivenCommands:
        """Return the task of the turns, an episode for each."""
        commands = [np.eye(3)[turn.axis] * turn.rate_deg_s for turn in self.turns]
        return GivenCommands(self.turn, np.deg2rad(commands))

    def variation(self) -> Variation:
        """Return the differences of the flights' aircraft from the file."""
        delay = self.aircraft.propulsion.delay
        nominal = Variation.nominal(len(self.flights), delay)
        known = [flight.condition or Condition("") for flight in self.flights]
        return replace(
            nominal,
            lag=np.array([each.lag for each in known]),
            delay_s=np.array([max(0.0, delay + each.delay_s) for each in known]),
            charge=np.array([np.nan if each.charge is None else each.charge for each in known]),
        )


def course(aircraft: Aircraft, lift: float | None = None) -> Course:
    """Lay out the course for an aircraft that lifts at most `lift` times its weight; None: by its figures."""
    figures = aircraft_figures(aircraft)
    most = LIFT_SHARE * (figures.thrust_to_weight if lift is None else lift)
    thrusts = [thrust for thrust in THRUSTS if thrust < most] or [most]
    if len(thrusts) < len(THRUSTS):
        thrusts.append(most)
    flights = [CommandFlight(f"{thrust:.3g} times the weight", thrust) for thrust in dict.fromkeys(thrusts)]
    hover = min(1.0, most)
    for condition in (*CONDITIONS, *_batteries(aircraft, figures.endurance)):
        flights.append(CommandFlight(condition.name, hover, condition))
    turn_thrusts = dict.fromkeys(min(thrust, most) for thrust in TURN_THRUSTS)
    turns = [
        Turn(axis, sign * rate, round(thrust, 2))
        for thrust, rate, axis, sign in product(turn_thrusts, TURN_RATES_DEG_S, range(3), (1, -1))
    ]
    return Course(aircraft, tuple(flights), tuple(turns))


def _batteries(aircraft: Aircraft, endurance: Endurance | None) -> tuple[Condition, ...]:
    """Return a battery that is almost empty at the end of a flight, and a full one.

    None if the aircraft has none that affects its thrust. Begun at 0 it would collapse on the way, and no
    controller flies then.
    """
    battery = aircraft.battery
    if battery is None or aircraft.propulsion.supply_voltage is None or endurance is None:
        return ()
    left = EMPTY_RESERVE * endurance.current * FLIGHT.duration_s / battery.capacity
    return (
        Condition("an empty battery", charge=min(1.0, left)),
        Condition("a full battery", charge=1.0),
    )
