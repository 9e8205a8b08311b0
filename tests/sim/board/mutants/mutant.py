"""A mutant: the real firmware with one deliberate mistake, and the error that the board must raise."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Mutant:
    """One textual replacement in one source of the firmware."""

    name: str
    file: str  # in firmware/
    old: str  # stands there exactly once
    new: str
    message: str  # regular expression: what the board's error says of the mistake
    place: str = ""  # function that the error names; empty: the mistake shows while something else runs
    seconds: float = 0.05  # of the board's time, enough for the mistake to show
    flown: bool = False  # armed by the receiver, at part throttle; else idle, receiver off
    saves: float | None = None  # when a client asks for the settings to be saved [s]
    boots: int = 1  # so many power-ups, each for so long
    gyro: str = "icm20602"  # what is fitted
    ordinary: bool = False  # otherwise for the long run only
