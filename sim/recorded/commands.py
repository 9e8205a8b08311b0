"""A pilot's recorded commands: setpoints and throttle by time, to be flown again.

Body frame as everywhere: roll right, pitch nose down and yaw left are positive. That is also how Betaflight
logs its setpoints, so that theirs are taken as they are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.control import sticks
from sim.flight.scenario import Scenario, Segment
from sim.physics.world import Mount
from toolchain.contract import RATE_FULL_STICK_DEG_S
from toolchain.errors import ScenarioError

LENGTH_MAX_S = 3600.0  # as a scenario's longest segment
ROWS_MAX = 8_000_000  # an hour at 2 kHz
# A command that float32 rounded up from full stick, or that a log rounded to whole deg/s, is full stick.
BEYOND_DEG_S = 0.51


@dataclass(frozen=True, eq=False)
class Commands:
    """N commands; each holds from its time to the next, the last for the median of these times."""

    name: str  # of the file, without its suffix
    time: NDArray[np.float64]  # (N,) [s], rising
    setpoint: NDArray[np.float64]  # (N, 3) [deg/s], body frame
    throttle: NDArray[np.float64]  # (N,) pilot's thrust, 0..1
    notes: tuple[str, ...] = ()  # what the user must know of how they were read, a sentence each

    def __post_init__(self) -> None:
        """Raises ScenarioError, beginning with the name, on commands that cannot be flown."""
        rows = len(self.time)
        if not 2 <= rows <= ROWS_MAX:
            raise ScenarioError(f"{self.name}: {rows} rows of commands, expected 2 to {ROWS_MAX}")
        for what, array, width in (("setpoint", self.setpoint, (3,)), ("throttle", self.throttle, ())):
            if array.shape != (rows, *width):
                raise ScenarioError(f"{self.name}: {what} has shape {array.shape}, expected {(rows, *width)}")
        for what, array in (("time", self.time), ("setpoint", self.setpoint), ("throttle", self.throttle)):
            if not np.isfinite(array).all():
                raise ScenarioError(f"{self.name}: {what} has a value that is no number")
        back = np.flatnonzero(~(np.diff(self.time) > 0))
        if len(back):
            at = int(back[0])
            raise ScenarioError(
                f"{self.name}: the time is {self.time[at + 1]:g} s after {self.time[at]:g} s, "
                f"expected it to rise"
            )
        if self.length_s > LENGTH_MAX_S:
            raise ScenarioError(
                f"{self.name}: {self.length_s:g} s of commands, expected at most {LENGTH_MAX_S:g}; cut it"
            )

    @property
    def length_s(self) -> float:
        """From the first command to the end of the last [s]."""
        return float(self.time[-1] - self.time[0] + np.median(np.diff(self.time)))

    def warnings(self) -> tuple[str, ...]:
        """The notes, and what sticks cannot express, a sentence each."""
        full = RATE_FULL_STICK_DEG_S
        size = np.abs(self.setpoint).max(axis=1)
        beyond = int((size > full + BEYOND_DEG_S).sum())
        found = list(self.notes)
        if beyond:
            found.append(
                f"{self.name}: {beyond} of {len(size)} commands ask for more than full stick ({size.max():g} "
                f"deg/s, full stick is {full}): they are flown as {full}"
            )
        off = int(((self.throttle < 0) | (self.throttle > 1)).sum())
        if off:
            found.append(
                f"{self.name}: {off} of {len(size)} throttles are outside 0 to 1: they are flown as its ends"
            )
        return tuple(found)

    def scenario(self, mount: Mount | None = None) -> Scenario:
        """The flight of these commands, on sticks that SBUS can express, held between commands.

        Beyond full stick they are full stick; `warnings` says so.
        """
        full = RATE_FULL_STICK_DEG_S
        rates, power = self.setpoint.clip(-full, full), self.throttle.clip(0.0, 1.0)
        us = sticks.channels(rates, power, armed=True)
        changes = np.flatnonzero((us[1:] != us[:-1]).any(axis=1)) + 1
        begins = np.concatenate([[0], changes])
        ends = np.append(self.time[changes] - self.time[0], self.length_s)
        durations = np.diff(ends, prepend=0.0).tolist()
        segments = tuple(
            Segment(duration, (roll, pitch, yaw), thrust)
            for duration, (roll, pitch, yaw), thrust in zip(
                durations, rates[begins].tolist(), power[begins].tolist(), strict=True
            )
        )
        return Scenario(self.name, segments, Mount.CENTRE if mount is None else mount)
