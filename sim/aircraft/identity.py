"""The aircraft that a policy was trained on, by the digest in its file."""

from __future__ import annotations

from neuroflight.sim.aircraft.model import Aircraft, load_aircraft, shipped
from neuroflight.sim.aircraft.props_out import SUFFIX

DIGITS = 12  # of a digest, as shown to people


def shipped_as(sha256: str) -> str | None:
    """Return the shipped aircraft, as --aircraft names it, with that digest; None: none has it."""
    names = [name + end for name in shipped() for end in ("", SUFFIX)]
    return next((name for name in names if load_aircraft(name).is_meant_by(sha256)), None)


def told(name: str, sha256: str) -> str:
    """Return an aircraft's name and digest as people read them."""
    return f"{name} ({sha256[:DIGITS]})"


def other_aircraft_note(what: str, name: str, sha256: str, flown: Aircraft) -> str | None:
    """Return one line where a policy flies the twin of another aircraft than its own; None: of its own.

    what: the policy, in that line. name, sha256: of the aircraft that it was trained on, by its metadata.
    """
    if flown.is_meant_by(sha256):
        return None
    return (
        f"{what} was trained on aircraft {told(name, sha256)} and flies the twin of another: "
        f"{told(flown.name, flown.sha256)}"
    )
