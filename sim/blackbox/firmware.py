"""The firmware that wrote a log, and its version: the meaning of a field's number depends on both.

The names are those of the lines `Firmware type` and `Firmware revision`, read in the sources of each firmware
(Betaflight 2.1 to 2025.12, Cleanflight 1.8 to 2.5, INAV 8, EmuFlight 1.0, Rotorflight 4.6).
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum


class Maker(Enum):
    """The project whose firmware wrote a log."""

    NEUROFLIGHT = "Neuroflight"
    BETAFLIGHT = "Betaflight"
    CLEANFLIGHT = "Cleanflight"
    BASEFLIGHT = "Baseflight"
    INAV = "INAV"
    EMUFLIGHT = "EmuFlight"
    ROTORFLIGHT = "Rotorflight"
    OTHER = "another firmware"


@dataclass(frozen=True)
class Firmware:
    """A maker's firmware of one version; () if the log does not name the version."""

    maker: Maker
    version: tuple[int, ...] = ()

    def since(self, maker: Maker, *version: int) -> bool:
        """Return True if this is `maker`'s firmware, of `version` or newer."""
        return self.maker is maker and self.version >= version

    def __str__(self) -> str:
        return " ".join((self.maker.value, ".".join(map(str, self.version)))).strip()


_REVISION = re.compile(r"(?i)\b([a-z]+)\b\D{0,9}?(\d{1,4})\.(\d{1,4})(?:\.(\d{1,4}))?")
_NAMES = {one.value.lower(): one for one in Maker if one not in (Maker.OTHER, Maker.NEUROFLIGHT)}
# ButterFlight and Raceflight's blackbox are Betaflight's of their time; Betaflight's tools read them so.
_NAMES |= {"butterflight": Maker.BETAFLIGHT, "raceflight": Maker.BETAFLIGHT}


def firmware(headers: Mapping[str, str]) -> Firmware:
    """Read the maker and version of the log with these header lines.

    `Firmware revision` decides where it has a name: Betaflight, INAV and EmuFlight call their type
    "Cleanflight". Cleanflight before 2.0 and Baseflight give a type and a bare revision.
    """
    if "nf_version" in headers:
        return Firmware(Maker.NEUROFLIGHT)
    revision = headers.get("Firmware revision", "")
    for found in _REVISION.finditer(revision):
        if (maker := _NAMES.get(found[1].lower())) is not None:
            return Firmware(maker, tuple(int(part) for part in found.groups()[1:] if part is not None))
    words = re.split(r"[^a-z]+", revision.lower())
    named = next((_NAMES[word] for word in words if word in _NAMES), None)
    if named is None and (kind := headers.get("Firmware type", "").strip().lower()) in _NAMES:
        # A lost revision hides which of the firmwares that call themselves Cleanflight it was.
        named = _NAMES[kind] if revision or kind != "cleanflight" else None
    return Firmware(named or Maker.OTHER)


def has_mapped_throttle(told: Firmware) -> bool:
    """Return True if rcCommand[3] runs from minthrottle to maxthrottle, rather than from 1000 to 2000 us."""
    return (
        told.maker in (Maker.INAV, Maker.BASEFLIGHT)
        or (told.maker is Maker.CLEANFLIGHT and told.version < (2,))
        or (told.maker is Maker.BETAFLIGHT and () < told.version < (3, 1, 4))
    )


def has_box_mask(told: Firmware) -> bool:
    """Return True if bit 0 of flightModeFlags is the arm switch, bit 1 ANGLE and bit 2 HORIZON.

    Cleanflight before 2.0, Betaflight before 2.7 and Baseflight log the modes that are on instead, ANGLE and
    HORIZON in bits 0 and 1; these log only while the motors are armed.
    """
    if told.maker in (Maker.NEUROFLIGHT, Maker.INAV, Maker.EMUFLIGHT, Maker.ROTORFLIGHT):
        return True
    return told.since(Maker.BETAFLIGHT, 2, 7) or told.since(Maker.CLEANFLIGHT, 2)
