"""A payload on an aircraft: a point mass at a place of the body frame."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace

from neuroflight.sim.aircraft.airframe import ZERO
from neuroflight.sim.aircraft.mass import Part, Vector, mass_properties
from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.toolchain.errors import AircraftError

GRAMS_MAX = 100_000.0
REACH_MAX = 5.0  # [m]
_FORM = re.compile(r"([^@]+)@([^,]+),([^,]+),([^,]+)")


@dataclass(frozen=True)
class Payload:
    """A point mass."""

    mass: float  # [kg]
    position: Vector  # [m], body frame of the aircraft file

    @property
    def words(self) -> str:
        """Mass and place, for tables."""
        x, y, z = (f"{1e3 * value:g}" for value in self.position)
        return f"{1e3 * self.mass:g} g at {x}, {y}, {z} mm"


def parse_payload(text: str) -> Payload:
    """Parse a payload from GRAMS@X,Y,Z, metres in the body frame. Raises AircraftError."""
    expected = (
        f"expected GRAMS@X,Y,Z in g and m, such as 50@0.04,0,0.02, up to {GRAMS_MAX:g} g, {REACH_MAX:g} m"
    )
    found = _FORM.fullmatch(text)
    try:
        grams, x, y, z = map(float, found.groups() if found else ())
    except ValueError:
        raise AircraftError(f"payload {text!r}: {expected}") from None
    place = (x, y, z)
    if not (0.0 < grams <= GRAMS_MAX and all(math.isfinite(v) and abs(v) <= REACH_MAX for v in place)):
        raise AircraftError(f"payload {text!r}: {expected}")
    return Payload(grams / 1e3, place)


def loaded(aircraft: Aircraft, payload: Payload) -> Aircraft:
    """Return `aircraft` with the payload fixed to it."""
    nothing = (ZERO, ZERO, ZERO)
    part = Part("payload", payload.mass, payload.position, ZERO, ZERO, nothing)
    parts = (*aircraft.parts, part)
    return replace(aircraft, parts=parts, mass_properties=mass_properties(parts))
