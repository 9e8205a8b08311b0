"""The cost to a policy of a wrong number in the aircraft file, and what measures the number.

A number counts by what a controller feels of it: the moment of its commands over inertia about each axis, the
rotors' lag, the delay, the gyro's noise. Those of the file with the number 1.5 times as large are
held against those of the file; what each costs is of a study.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from neuroflight.sim.aircraft.airframe import Meshes
from neuroflight.sim.aircraft.known import Known, numbers_of, scaled, value_of
from neuroflight.sim.aircraft.model import (
    FILE_BYTES_MAX,
    Aircraft,
    TorqueResponse,
    aircraft_file,
    aircraft_of,
    over_base,
)
from neuroflight.sim.design.figures import thrust_map
from neuroflight.sim.physics.rotor import target_speed, thrust_and_torque
from neuroflight.toolchain.errors import AircraftError
from neuroflight.toolchain.files import read_limited
from neuroflight.toolchain.strict_toml import parse_toml

WRONG = 1.5  # how far off a number is taken to be: half as much again, or a third less
THROTTLES = (0.15, 0.5)  # between which a policy steers most


@dataclass(frozen=True)
class Trait:
    """A property of an aircraft that a controller feels."""

    words: str
    cost: float  # of a policy's error, where this is wrong by WRONG; 0.1: a tenth
    told_by: str  # what measures it


# Costs: the NF1's policy, trained by the recipe that every aircraft without its own gets, on twins with one
# number 1.5 times more and less, `neuroflight compare training/policies/nf1/policy.onnx --aircraft TWIN.toml
# --task pulse --episodes 60 --thrust 1`: the geometric mean of both errors (MAE) over that on the right twin,
# so that what is harder or easier to fly for every controller goes out. Moments of inertia 1.10, of it 0.03
# yaw; lag 1.12; delay 1.01; noise 1.01. Not fitted to these: K_T 1.08, the speed curve (2.25 times the
# thrust) 1.35, K_Q 1.01, the rotors' drag and the body's 1.01 and 1.00.
TRAITS = {
    "turn": Trait("moment over inertia, roll and pitch", 0.07, "aircraft fit LOG, or aircraft inertia"),
    "yaw": Trait("moment over inertia, yaw", 0.03, "aircraft fit LOG, or aircraft inertia"),
    "lag": Trait("the rotors' lag", 0.12, "aircraft fit LOG (better with eRPM), or dyno fit"),
    "delay": Trait("the delay", 0.01, "aircraft fit LOG"),
    "noise": Trait("the gyro's noise", 0.01, "aircraft noise LOG"),
}


@dataclass(frozen=True)
class Guess:
    """A mark of an aircraft's file, and the cost of its number: 1.5 times off, or at an end of its range."""

    key: str
    mark: Known
    cost: float  # of a policy's error; 0.1: a tenth
    trait: str  # of TRAITS, which has the most of the cost; "": none


def marked_numbers(name: str | Path) -> list[Guess]:
    """Return the marks of an aircraft file with their cost, the dearest first. Raises AircraftError.

    The mark of a table counts for those of its numbers that have none of their own; without such it is left
    out.
    """
    path = aircraft_file(name)
    data = read_limited(path, f"aircraft file {path}", FILE_BYTES_MAX, AircraftError)
    document = over_base(parse_toml(data, f"aircraft file {path}", AircraftError), str(path))
    meshes = Meshes(path.parent)
    aircraft = aircraft_of(document, str(path), meshes)
    right = traits(aircraft)
    found = []
    for key, mark in aircraft.known.items():
        numbers = numbers_of(document, aircraft.known, key)
        if not numbers:
            continue
        each = [
            _costs(right, traits(_wrong(document, aircraft, key, numbers, factor, meshes)))
            for factor in _factors(document, key, mark)
        ]
        costs = max(each, key=lambda one: sum(one.values()))
        dearest = max(costs, key=lambda name: costs[name])
        found.append(Guess(key, mark, sum(costs.values()), dearest if costs[dearest] > 0 else ""))
    return sorted(found, key=lambda guess: -guess.cost)


def traits(aircraft: Aircraft) -> dict[str, float]:
    """Return what a controller feels of an aircraft, each in a unit of its own."""
    propulsion = aircraft.propulsion
    response = propulsion.response
    if isinstance(response, TorqueResponse):
        lag = propulsion.rotor_inertia / response.gain
    else:
        lag = math.sqrt(response.time_constant_up * response.time_constant_down)
    speeds = target_speed(np.array(THROTTLES), propulsion)
    thrusts, torques = thrust_and_torque(speeds, propulsion)
    slope = (thrusts[1] - thrusts[0]) / (THROTTLES[1] - THROTTLES[0])
    levers = np.abs(thrust_map(aircraft, torques.sum() / thrusts.sum() * np.ones(aircraft.motor_count)))
    roll, pitch, yaw = slope * levers[1:].sum(axis=1) / np.diag(aircraft.mass_properties.inertia)
    return {
        "turn": math.sqrt(roll * pitch),
        "yaw": float(yaw),
        "lag": lag,
        "delay": propulsion.delay,
        "noise": math.hypot(*aircraft.gyro.noise),
    }


def _costs(right: Mapping[str, float], wrong: Mapping[str, float]) -> dict[str, float]:
    """Return the cost of each trait: it grows with the square of its relative error."""
    off = {
        name: math.log(wrong[name] / right[name]) / math.log(WRONG) if right[name] and wrong[name] else 0.0
        for name in TRAITS
    }
    return {name: trait.cost * off[name] ** 2 for name, trait in TRAITS.items()}


def _factors(document: dict[str, Any], key: str, mark: Known) -> list[float]:
    """Return how many times as large a number may be: by the ends of its range, where it has one."""
    value = value_of(document, key)
    if mark.range is None or not isinstance(value, int | float) or value == 0:
        return [WRONG]
    return [end / value for end in mark.range]


def _wrong(
    document: dict[str, Any],
    aircraft: Aircraft,
    key: str,
    numbers: list[str],
    factor: float,
    meshes: Meshes,
) -> Aircraft:
    """Return the aircraft whose numbers are `factor` times as large; as much less where they cannot be.

    Of parts as a whole their moments of inertia are, at the same weight.
    """
    if key == "part":
        properties = aircraft.mass_properties
        return replace(aircraft, mass_properties=replace(properties, inertia=factor * properties.inertia))
    for each in (factor, 1 / factor) if factor > 0 else ():
        changed = scaled(document, numbers, each)
        changed.pop("known", None)
        try:
            return aircraft_of(changed, aircraft.name, meshes)
        except AircraftError:
            continue
    return aircraft
