"""Unseen aircraft: rows of builds.csv, each hidden behind draws of how far a real one is off its file.

Of each there are two files: what `aircraft new` writes from a pilot's ten answers, and the truth, which is
what the twin flies. The truth is the former with the draws of SPREAD: what nobody weighed or measured is off
by that much. Beside the files stand what no file tells: motors that differ, and the battery's charge.

An aircraft depends on the seed and its number alone, so that the first 24 of 200 are those of 24.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from neuroflight.sim.aircraft.mass import MassProperties
from neuroflight.sim.aircraft.model import Aircraft, FirstOrderResponse, Propulsion, parse_aircraft
from neuroflight.training.evaluation.fleet.builds import Build, builds
from neuroflight.training.evaluation.fleet.truth import truth_text

LIMIT = 2.0  # of a deviation, at most so many of it: a real aircraft is off, not absurd
MOTORS_DIFFER = 0.10  # of the thrust at the same command: the weakest has so much less than the best could
CHARGE = (0.3, 1.0)  # of the battery
CENTRE = 0.03  # of the arm, standard deviation of the centre of mass forwards and sideways
SHAKEN_DEG_S = (0.0, 12.0)  # of the gyro's worst axis, by a rotor at full speed


@dataclass(frozen=True)
class Spread:
    """Distances of aircraft from what their answers tell: standard deviations of logarithms.

    Together, 0.3 of the authority about roll and pitch, 0.4 about yaw, 0.33 of the response, 0.2 of full
    thrust: as far as `typical` is off the aircraft, motors and propellers that it was held against.
    """

    inertia: float = 0.22  # of all moments together
    axis: float = 0.12  # of each moment apart
    thrust: float = 0.15  # at the same speed
    torque: float = 0.25  # at the same thrust
    speed: float = 0.06  # at full command
    bend: float = 0.20  # of the curve of speed over command
    response: float = 0.32  # of both directions together
    direction: float = 0.10  # of each direction apart
    delay: float = 0.40
    rotor_inertia: float = 0.20
    resistance: float = 0.30
    noise: float = 0.40


SPREAD = Spread()


@dataclass(frozen=True)
class Unseen:
    """An aircraft that nobody was trained on."""

    name: str
    build: Build
    told: Aircraft  # as `aircraft new` describes it
    truth: Aircraft
    text: str  # the truth's file
    shares: tuple[float, ...]  # of each motor's thrust at the same command
    charge: float  # of its battery, 0..1


def fleet(count: int, seed: int, answered: Callable[[Build, str], Aircraft]) -> Iterator[Unseen]:
    """Yield `count` unseen aircraft, of all classes alike. answered: what `aircraft new` makes of a row."""
    rows = builds()
    order = np.random.default_rng([seed, 0]).permutation(len(rows))
    for number in range(count):
        build = rows[order[number % len(rows)]]
        name = f"{build.name}-{number}"
        yield unseen(name, build, answered(build, name), np.random.default_rng([seed, 1, number]))


def unseen(
    name: str, build: Build, told: Aircraft, rng: np.random.Generator, spread: Spread = SPREAD
) -> Unseen:
    """Return an aircraft that is off its file `told` by the spread."""

    def off(deviation: float, count: int = 1) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
        return np.exp(deviation * np.clip(rng.standard_normal(count), -LIMIT, LIMIT))

    mass = told.mass_properties
    turn = np.sqrt(off(spread.inertia) * off(spread.axis, 3))
    inertia = mass.inertia * np.outer(turn, turn)
    x, y, z = sorted(np.linalg.eigvalsh(inertia))
    if z > 0.98 * (x + y):  # no body has such moments
        inertia = inertia + np.eye(3) * (z - 0.98 * (x + y))
    shift = CENTRE * build.arm_m * np.clip(rng.standard_normal(2), -LIMIT, LIMIT)
    centre = mass.centre + np.array([*shift, 0.0])
    shares = 1.0 - MOTORS_DIFFER * rng.random(told.motor_count)
    drive = _drive(told.propulsion, off, spread, 1.0 / float(shares.mean()))
    gyro = told.gyro
    noise = off(spread.noise)[0]
    shaken = np.deg2rad(rng.uniform(*SHAKEN_DEG_S)) * np.array([1.0, 0.8, 0.5])
    held = told.battery
    changed = replace(
        told,
        gyro=replace(
            gyro,
            noise=tuple((noise * np.array(gyro.noise)).tolist()),
            vibration=tuple(shaken.tolist()),
        ),
        battery=held and replace(held, resistance=held.resistance * float(off(spread.resistance)[0])),
    )
    text = truth_text(name, changed, MassProperties(mass.mass, centre, inertia), drive)
    return Unseen(
        name=name,
        build=build,
        told=told,
        truth=parse_aircraft(text.encode(), name),
        text=text,
        shares=tuple(shares.tolist()),
        charge=float(rng.uniform(*CHARGE)),
    )


def _drive(
    told: Propulsion,
    off: Callable[[float], np.ndarray[tuple[int, ...], np.dtype[np.float64]]],
    spread: Spread,
    even: float,
) -> Propulsion:
    """Return motors and propellers as they are. even: factor of thrust that unlike motors have on average."""
    a, b, c = (float(off(spread.speed)[0]) * value for value in told.speed_curve)
    bent = a * float(off(spread.bend)[0])
    straight = b + a - bent  # the speed at full command stays
    if 2 * bent + straight < 0.0:  # the curve would fall before full command
        bent, straight = a, b
    thrust, torque = float(off(spread.thrust)[0]) * even, float(off(spread.torque)[0])
    slow = float(off(spread.response)[0])
    response = told.response
    assert isinstance(response, FirstOrderResponse)
    return replace(
        told,
        speed_curve=(bent, straight, c),
        thrust_coefficient=tuple(thrust * term for term in told.thrust_coefficient),
        torque_ratio=tuple(torque * term for term in told.torque_ratio),
        rotor_inertia=told.rotor_inertia * float(off(spread.rotor_inertia)[0]),
        response=FirstOrderResponse(
            response.time_constant_up * slow * float(off(spread.direction)[0]),
            response.time_constant_down * slow * float(off(spread.direction)[0]),
        ),
        delay=told.delay * float(off(spread.delay)[0]),
    )
