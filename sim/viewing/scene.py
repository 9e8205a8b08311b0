"""The scene of a flight: its trace, and attitude and place of the aircraft at each row."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.arrays import Array
from neuroflight.sim.blackbox.flight import Part, part_rows
from neuroflight.sim.flight.trace import COLUMNS, Trace
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.viewing.poses import attitudes

STAYS_M = 1e-3  # a flight that keeps within it is shown in place


@dataclass(frozen=True, eq=False)
class Scene:
    """A flight of N rows that can be drawn."""

    title: str
    aircraft: Aircraft
    trace: Trace
    rotation: Array  # (N, 3, 3), body to world
    position: Array | None  # (N, 3) [m], of the centre of mass, world axes; None: not known, or it stays
    source: str  # of attitude and place, a clause for the reader

    def rows(self, times: Array) -> list[int]:
        """Return the first row at or after each of `times` [s]; the last one after the end."""
        found = np.searchsorted(self.trace.t, times - 1e-9)
        return [min(int(row), len(self.trace.t) - 1) for row in found]

    def part(self, part: Part) -> Scene:
        """Return the rows of `part` with their original times. Raises TraceError if there are none."""
        taken = part_rows("flight", self.trace.t, part)
        trace = Trace(**{name: getattr(self.trace, name)[taken] for name in COLUMNS})
        position = None if self.position is None else self.position[taken]
        return replace(self, trace=trace, rotation=self.rotation[taken], position=position)


class Watch:
    """The `watch` of a flight of one aircraft: keeps attitude and place each time that it is called."""

    def __init__(self, twin: Twin) -> None:
        self._live = twin.live
        self._rotation: list[Array] = []
        self._position: list[Array] = []

    def __call__(self) -> None:
        """Keep the twin's state as it is now."""
        self._rotation.append(self._live.rotation[0].copy())
        self._position.append(self._live.position[0].copy())

    def scene(self, title: str, aircraft: Aircraft, trace: Trace) -> Scene:
        """Return the scene of the flight that was watched, at each row of `trace`."""
        position = np.array(self._position)
        moves = bool((np.ptp(position, axis=0) > STAYS_M).any())
        source = "attitude and place of the twin" if moves else "attitude of the twin"
        return Scene(title, aircraft, trace, np.array(self._rotation), position if moves else None, source)


def recorded(title: str, aircraft: Aircraft, trace: Trace, begin: float = 0.0) -> Scene:
    """Return the scene of a flight of which only the rates are known: level at its first row, and in place.

    begin: the time of the first row [s], where `trace` is a part of a flight.
    """
    shifted = replace(trace, t=trace.t - trace.t[0] + begin)
    source = f"attitude integrated from the rates, level at {begin:.2f} s"
    return Scene(title, aircraft, shifted, attitudes(trace.t, trace.rate), None, source)
