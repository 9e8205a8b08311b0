"""Answers of a pilot about an aircraft, and typical values where there is none."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace

from neuroflight.toolchain.errors import AircraftError

INCH = 0.0254  # [m]
CELL_NOMINAL = 3.7  # [V]
WEIGHT_MIN, WEIGHT_MAX = 0.015, 25.0  # [kg]
DELAYS = {  # [s] of ESC and a control loop at 1 kHz together, by protocol
    "dshot": 0.0015,
    "oneshot": 0.0018,
    "pwm": 0.0045,
}
_PITCH_RATIO_MAX = 1.6
_INCHES = re.compile(r"(\d{1,2}(?:\.\d+)?)x(\d{1,2}(?:\.\d+)?)(?:x([2-8]))?")
_MILLIMETRES = re.compile(r"(\d{2,3}(?:\.\d+)?)mm(?:x([2-8]))?")
_STATOR = re.compile(r"(\d\d)(\d\d(?:\.\d)?)")


@dataclass(frozen=True)
class Propeller:
    """The size of a propeller; what its print does not say is None."""

    diameter_m: float
    pitch_m: float | None = None
    blades: int | None = None

    @classmethod
    def parse(cls, text: str) -> Propeller:
        """Read "5.1x4.3x3": diameter, pitch [inch] and blades (2 if left out), or "31mmx4" of a whoop.

        Raises AircraftError.
        """
        plain = "".join(text.lower().split()).replace(",", ".")
        if match := _INCHES.fullmatch(plain):
            diameter, pitch = float(match[1]) * INCH, float(match[2]) * INCH
            propeller = cls(diameter, pitch, int(match[3] or 2))
            fits = pitch <= _PITCH_RATIO_MAX * diameter
        elif match := _MILLIMETRES.fullmatch(plain):
            propeller = cls(float(match[1]) / 1000, None, int(match[2]) if match[2] else None)
            fits = True
        else:
            fits = False
        if not fits or not 0.02 <= propeller.diameter_m <= 0.8:
            raise AircraftError(
                f"propeller {text!r}: expected diameter x pitch x blades in inches, such as 5.1x4.3x3, or a "
                f"whoop's diameter and blades, such as 31mmx4"
            )
        return propeller


def parse_stator(text: str) -> tuple[float, float]:
    """Read "2207" or "2806.5": diameter and height [mm] of a motor's stator. Raises AircraftError."""
    match = _STATOR.fullmatch(text.strip())
    if match is None or float(match[1]) < 5 or not 1 <= float(match[2]) <= 40:
        raise AircraftError(
            f"motor size {text!r}: expected the stator's diameter and height in mm as printed, such as 2207"
        )
    return float(match[1]), float(match[2])


@dataclass(frozen=True)
class Answers:
    """Answers about an aircraft of four motors in an X; None: not answered."""

    weight_kg: float  # ready to fly, battery included
    cells: int | None = None  # of the battery, in series
    kv: float | None = None  # of the motors [rpm/V]
    propeller: Propeller | None = None
    arm_m: float | None = None  # motor to the middle of the four
    stator_mm: tuple[float, float] | None = None  # diameter and height: 2207 is (22, 7)
    capacity_ah: float | None = None  # of the battery
    protocol: str | None = None  # of the ESCs, one of DELAYS
    props_out: bool = False
    name: str = "mine"

    def __post_init__(self) -> None:
        """Raise AircraftError on what no such aircraft has."""
        _within("weight", self.weight_kg, WEIGHT_MIN, WEIGHT_MAX, "kg", "with its battery, in kilograms")
        _within("cells", self.cells, 1, 14, "", "lithium cells in series")
        _within("Kv", self.kv, 50, 60_000, "rpm/V", "as printed on the motor")
        _within("arm", self.arm_m, 0.015, 1.0, "m", "from a motor to the middle of the four")
        _within("capacity", self.capacity_ah, 0.05, 60, "Ah", "1300 mAh are 1.3")
        if self.protocol is not None and self.protocol not in DELAYS:
            raise AircraftError(f"protocol {self.protocol!r}: expected one of: {', '.join(DELAYS)}")


@dataclass(frozen=True)
class Whole:
    """Answers with what is typical in place of what was not answered."""

    weight: float  # [kg]
    cells: int
    kv: float  # [rpm/V]
    diameter: float  # [m], of the propellers
    pitch: float  # [m]
    blades: int
    arm: float  # [m]
    stator: tuple[float, float]  # [mm]
    motor_mass: float  # [kg]
    capacity: float  # [A h]
    battery_mass: float  # [kg]
    delay: float  # [s]
    answered: frozenset[str]  # names of Answers' fields, and "pitch"

    @property
    def ducted(self) -> bool:
        """Return True for a whoop, whose frame is a ring about each propeller."""
        return self.diameter < WHOOP_DIAMETER


WHOOP_DIAMETER = 0.050  # [m], below it a frame with ducts is usual
_HEAVY_PROPELLER = 6.0  # [inch], from here on the pitch is lower
_WATT_HOURS_KG = 140.0  # of packs as flown: 1S 300 mAh 8 g, 6S 1300 mAh 204 g, 6S 5000 mAh 720 g


def completed(answers: Answers) -> Whole:
    """Fill what was not answered by rules through builds as they are sold. Raises AircraftError.

    The rules are fits by eye to about ten builds of 30 g to 3 kg (makers' pages, from memory) and good to
    some 20 %: diameter by weight, Kv by tip speed and cells, arm by diameter, a motor's mass by both.
    """
    weight = answers.weight_kg
    given = answers.propeller
    diameter = given.diameter_m if given else 5.1 * INCH * (weight / 0.65) ** 0.465
    inches = diameter / INCH
    blades = given.blades if given and given.blades else (3 if inches < 8 else 2)
    ratio = 0.84 if inches < _HEAVY_PROPELLER else 0.5
    pitch = given.pitch_m if given and given.pitch_m else ratio * diameter
    arm = answers.arm_m or (1.05 if diameter < WHOOP_DIAMETER else 0.85) * diameter
    if arm * math.sqrt(2) < diameter:
        raise AircraftError(
            f"arm {1000 * arm:.0f} mm: propellers of {1000 * diameter:.0f} mm would touch; expected at least "
            f"{1000 * diameter / math.sqrt(2):.0f} mm from a motor to the middle of the four"
        )
    cells = answers.cells or next((n for limit, n in ((0.045, 1), (0.1, 2), (0.3, 4)) if weight < limit), 6)
    no_load_rpm = 43_300 * (5.1 / inches) ** (0.53 if inches < 5.1 else 1.1)
    kv = answers.kv or no_load_rpm / (CELL_NOMINAL * cells)
    if answers.stator_mm:
        width, height = stator = answers.stator_mm
        motor_mass = 0.0019 * (width * width * height / 128) ** 0.835  # 0802: 1.9 g, 2207: 29 g, 4114: 148 g
    else:
        by_diameter, by_weight = 0.033 * (inches / 5.1) ** 1.9, 0.0485 * weight * (weight / 0.68) ** -0.12
        motor_mass = math.sqrt(by_diameter * by_weight)
        width = 22.0 * (motor_mass / 0.032) ** (1 / 3)
        stator = (width, 0.3 * width)
    nominal = CELL_NOMINAL * cells
    capacity = answers.capacity_ah or 0.3 * weight * _WATT_HOURS_KG / nominal
    whole = Whole(
        weight=weight,
        cells=cells,
        kv=kv,
        diameter=diameter,
        pitch=pitch,
        blades=blades,
        arm=arm,
        stator=stator,
        motor_mass=motor_mass,
        capacity=capacity,
        battery_mass=capacity * nominal / _WATT_HOURS_KG,
        delay=DELAYS[answers.protocol or "dshot"],
        answered=_answered(answers),
    )
    return replace(whole, battery_mass=min(whole.battery_mass, 0.6 * weight))


def _answered(answers: Answers) -> frozenset[str]:
    names = [
        name
        for name in ("weight_kg", "cells", "kv", "propeller", "arm_m", "stator_mm", "capacity_ah", "protocol")
        if getattr(answers, name) is not None
    ]
    if answers.propeller is not None:
        names += ["pitch"] * (answers.propeller.pitch_m is not None)
    return frozenset(names)


def _within(what: str, value: float | None, low: float, high: float, unit: str, how: str) -> None:
    if value is not None and not low <= value <= high:  # NaN included
        space = f" {unit}" if unit else ""
        raise AircraftError(f"{what}: got {value:g}{space}, expected {low:g} to {high:g}{space}: {how}")
