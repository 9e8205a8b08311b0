"""Headings of thrust stands' logs: which quantity a column holds, and in which unit.

A heading is a name with its unit in brackets, behind a dash or an underscore, or as its last word:
`Thrust (gf)`, `Torque [N·m]`, `Torque - N*m`, `thrust_n`, `Motor Optical Speed (RPM)`. Units are those that
the heading names or the user gives; none is guessed from the numbers.

Sources of the names: logs of RCbenchmark's stands (now Tyto Robotics') that their owners published, and ours.
The names of forces along axes (Fz, Mz) are from memory of Tyto's Flight Stand.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

from neuroflight.sim.aircraft.model import RPM
from neuroflight.toolchain.contract import GRAVITY

POUND = 0.45359237  # [kg], international
OUNCE = POUND / 16
INCH = 0.0254  # [m]
FOOT = 12 * INCH

_FORCES = {"n": 1.0, "gf": GRAVITY / 1000, "kgf": GRAVITY, "lbf": POUND * GRAVITY, "ozf": OUNCE * GRAVITY}
_FORCES |= {"g": _FORCES["gf"], "kg": _FORCES["kgf"], "kp": _FORCES["kgf"]}
_FORCES |= {"lb": _FORCES["lbf"], "lbs": _FORCES["lbf"], "oz": _FORCES["ozf"]}
_LENGTHS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": INCH, "inch": INCH, "ft": FOOT}
_FORCE_WORDS = {"newton": 1.0, "newtons": 1.0, "mn": 1e-3, "kn": 1e3}
_FORCE_WORDS |= dict.fromkeys(("gram", "grams", "gramforce", "gramsforce"), _FORCES["gf"])
_FORCE_WORDS |= dict.fromkeys(("kilogram", "kilograms", "kilogramforce"), _FORCES["kgf"])
_FORCE_WORDS |= dict.fromkeys(("pound", "pounds", "poundforce", "poundsforce"), _FORCES["lbf"])
_FORCE_WORDS |= dict.fromkeys(("ounce", "ounces", "ounceforce", "ouncesforce"), _FORCES["ozf"])
_TORQUES = {
    name: force * length
    for a, force in _FORCES.items()
    for b, length in _LENGTHS.items()
    for name in (a + b, b + a)
    if name != "mn"  # of a force
}
_TORQUES |= {"mnm": 1e-3, "knm": 1e3, "unm": 1e-6, "newtonmeter": 1.0, "newtonmeters": 1.0}

FRACTION, MICROSECONDS = "", "us"
LENGTH_MAX = 200  # characters of a heading


class Quantity(Enum):
    """The quantity in a column of a thrust stand's log; the value is its name in options."""

    TIME = "time"
    THROTTLE = "throttle"
    SPEED = "speed"
    THRUST = "thrust"
    TORQUE = "torque"


# Factors to s, fractions, rad/s, N and N m. A pulse has none: its ends depend on the ESC.
UNITS: Mapping[Quantity, Mapping[str, float]] = {
    Quantity.TIME: {"s": 1.0, "sec": 1.0, "secs": 1.0, "second": 1.0, "seconds": 1.0, "ms": 1e-3}
    | {"msec": 1e-3, "us": 1e-6, "usec": 1e-6, "min": 60.0, "minutes": 60.0},
    Quantity.THROTTLE: {FRACTION: 1.0, "fraction": 1.0, "01": 1.0, "%": 0.01, "pct": 0.01, "percent": 0.01}
    | dict.fromkeys((MICROSECONDS, "usec", "microseconds"), math.nan),
    Quantity.SPEED: dict.fromkeys(("rpm", "r/min", "rev/min", "1/min", "min1", "erpm"), RPM)
    | {"krpm": 1000 * RPM, "rad/s": 1.0, "rads": 1.0, "radsec": 1.0, "rad/sec": 1.0, "deg/s": math.pi / 180}
    | dict.fromkeys(("hz", "rps", "rev/s", "r/s", "1/s"), 2 * math.pi),
    Quantity.THRUST: _FORCES | _FORCE_WORDS,
    Quantity.TORQUE: _TORQUES,
}
SHOWN = {  # names of these units in messages
    Quantity.TIME: "s, ms, us",
    Quantity.THROTTLE: "fraction, %, us",
    Quantity.SPEED: "rpm, rad/s, Hz",
    Quantity.THRUST: "N, gf, kgf, ozf, lbf",
    Quantity.TORQUE: "N·m, gf·cm, kgf·cm, ozf·in, lbf·in",
}
_FILLERS = frozenset(
    (
        *("motor", "rotor", "prop", "propeller", "signal", "sensor", "load", "cell", "a", "b"),
        *("average", "averaged", "avg", "mean", "measured"),
    )
)
_NAMES: Mapping[frozenset[str], Quantity] = {
    frozenset(words.split()): quantity
    for quantity, names in {
        Quantity.TIME: ("time", "timestamp", "time stamp", "elapsed time", "t"),
        Quantity.THROTTLE: (
            "throttle", "esc", "esc throttle", "pwm", "esc pwm", "throttle pwm", "command", "esc command",
            "throttle command", "throttle input", "esc input", "esc output", "esc pulse", "esc pulse width",
        ),
        Quantity.SPEED: (
            "speed", "optical speed", "electrical speed", "rotation speed", "rotational speed",
            "rotation rate", "angular speed", "angular velocity", "rpm", "optical rpm", "electrical rpm",
            "erpm", "omega",
        ),
        Quantity.THRUST: ("thrust", "thrust force", "force", "force fz", "fz", "thrust fz", "lift"),
        Quantity.TORQUE: ("torque", "torque mz", "mz", "moment", "moment mz"),
    }.items()
    for words in names
}  # fmt: skip


@dataclass(frozen=True)
class Heading:
    """A column that a fit can use."""

    text: str  # as it is written
    quantity: Quantity
    unit: str | None  # a key of UNITS; None: it names none, or one that is not known
    shown: str  # the unit as it is written, empty where there is none
    electrical: bool  # a speed counted in electrical turns of the motor
    optical: bool


def read_heading(text: str) -> Heading | None:
    """Return quantity and unit of a heading; None for a column of something else."""
    if len(text) > LENGTH_MAX:
        return None
    plain = _ascii(text)
    bracket = re.fullmatch(r"([^(\[]*)[(\[]([^)\]]*)[)\]]?(.*)", plain)
    name, shown = (f"{bracket[1]} {bracket[3]}", bracket[2].strip()) if bracket else (plain, "")
    if not bracket and (dash := re.fullmatch(r"(.*\S)\s+[-/?]\s+(\S.*)", plain)):
        name, shown = dash[1], dash[2]
    tokens = re.findall(r"[a-z]+|%", re.sub(r"(?<=[a-z]{2})(?=[A-Z])", " ", name).lower())
    if tokens == ["t"] and "T" in text:
        return None  # a temperature, or a thrust
    for behind in range(0 if shown else 4):
        kept = tokens[: len(tokens) - behind]
        found = _quantity(kept)
        if found is None or (behind and "".join(tokens[len(kept) :]) not in UNITS[found]):
            continue
        return _heading(text, found, kept, "".join(tokens[len(kept) :]))
    found = _quantity(tokens)
    return None if found is None else _heading(text, found, tokens, shown)


def known_unit(quantity: Quantity, text: str) -> str | None:
    """Return the key of UNITS for the text of a unit; None for an unknown unit."""
    plain = re.sub(r"[^a-z0-9%/?]", "", _ascii(text).lower())
    if quantity in (Quantity.THRUST, Quantity.TORQUE):
        plain = plain.replace("?", "")  # a point between two units
    return plain if plain in UNITS[quantity] else None


def _heading(text: str, quantity: Quantity, tokens: list[str], shown: str) -> Heading:
    unit = known_unit(quantity, shown) if shown else None
    if not shown and quantity is Quantity.SPEED and {"rpm", "erpm"} & set(tokens):
        unit = "rpm"  # its name is its unit
    if not shown and quantity is Quantity.THROTTLE and text.strip() == "throttle":
        unit = FRACTION  # of our own logs
    electrical = "electrical" in tokens or "erpm" in tokens or unit == "erpm"
    return Heading(text, quantity, unit, shown, electrical, "optical" in tokens)


def _quantity(tokens: list[str]) -> Quantity | None:
    words = frozenset(tokens)
    return _NAMES.get(words) or _NAMES.get(words - _FILLERS)


def _ascii(text: str) -> str:
    """Return `text` in ASCII: u for micro, blanks for middle dots and the like, ? for any other sign."""
    text = re.sub(
        "\N{LATIN CAPITAL LETTER A WITH CIRCUMFLEX}(?=[\xa0-\xbf])", "", text
    )  # UTF-8 read as latin-1
    text = re.sub("[\N{MICRO SIGN}\N{GREEK SMALL LETTER MU}]", "u", text)
    text = re.sub(
        r"[\s\N{MIDDLE DOT}\N{DOT OPERATOR}\N{BULLET}\N{BULLET OPERATOR}\N{MULTIPLICATION SIGN}]", " ", text
    )
    return re.sub(r"[^\x20-\x7e]", "?", text)
