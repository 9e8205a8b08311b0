"""A pilot's recorded commands: setpoints and throttle by time, to be flown again.

Body frame as everywhere: roll right, pitch nose down and yaw left are positive. That is also how Betaflight
logs its setpoints, so that theirs are taken as they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from neuroflight.sim.arrays import Array
from neuroflight.sim.blackbox.flight import WHOLE, Part, part_rows
from neuroflight.sim.blackbox.sticks import RATE_MOST_DEG_S, beyond, check
from neuroflight.sim.control import sticks
from neuroflight.sim.flight.scenario import Scenario, Segment
from neuroflight.sim.physics.world import Mount
from neuroflight.toolchain.contract import RATE_FULL_STICK_DEG_S
from neuroflight.toolchain.errors import ScenarioError, TraceError

LENGTH_MAX_S = 3600.0  # as a scenario's longest segment
ROWS_MAX = 8_000_000  # an hour at 2 kHz


@dataclass(frozen=True, eq=False)
class Commands:
    """N commands; each holds from its time to the next, the last for the median of these times.

    Commands that no stick gives are refused, and so are rates beyond our full stick, unless the user has them
    limited to it: nothing is flown that the pilot did not command.
    """

    name: str  # of the file, without its suffix
    time: Array  # (N,) [s], rising
    setpoint: Array  # (N, 3) [deg/s], body frame, within full stick
    throttle: Array  # (N,) pilot's thrust, 0..1
    notes: tuple[str, ...] = ()  # what the user must know of how they were read, a sentence each
    first_row: int = 0  # row of the recording that they begin with
    since_s: float = 0.0  # seconds of the recording before them
    cut: bool = False  # rates beyond full stick become full stick

    def __post_init__(self) -> None:
        """Raise ScenarioError, beginning with the name, for commands that cannot be flown."""
        rows = len(self.time)
        if not 2 <= rows <= ROWS_MAX:
            raise ScenarioError(f"{self.name}: {rows} rows of commands, expected 2 to {ROWS_MAX}")
        for what, array, width in (("setpoint", self.setpoint, (3,)), ("throttle", self.throttle, ())):
            if array.shape != (rows, *width):
                raise ScenarioError(f"{self.name}: {what} has shape {array.shape}, expected {(rows, *width)}")
        for what, array in (("time", self.time), ("setpoint", self.setpoint), ("throttle", self.throttle)):
            if not np.isfinite(array).all():
                bad = ~np.isfinite(array.reshape(rows, -1)).all(axis=1)
                row = self.first_row + int(bad.argmax())
                words = f"{what} has a value that is no number in row {row} and {int(bad.sum()) - 1} more"
                if what == "setpoint":  # as `log decode --npz` writes it
                    words += (
                        ": there the stick commands an angle (ANGLE or HORIZON mode), or nothing is known"
                    )
                raise ScenarioError(f"{self.name}: {words}; leave them out by --from and --to")
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
        full, seconds = float(RATE_FULL_STICK_DEG_S), self.time - self.time[0] + self.since_s
        fast = int(beyond(self.setpoint, full).sum())
        most = RATE_MOST_DEG_S if self.cut else full
        try:
            check(self.name, self.setpoint, self.throttle, seconds, self.first_row, most)
        except TraceError as error:
            mend = ", or fly full stick by --cut-rates" if fast and not self.cut else ""
            raise ScenarioError(f"{error}{mend}") from error
        if fast:
            words = f"{fast} of {rows} commands ask for more than full stick: flown as {full:g} deg/s"
            object.__setattr__(self, "notes", (*self.notes, f"{self.name}: {words}"))
        object.__setattr__(self, "setpoint", self.setpoint.clip(-full, full))
        object.__setattr__(self, "throttle", self.throttle.clip(0.0, 1.0))

    @property
    def length_s(self) -> float:
        """Time from the first command to the end of the last [s]."""
        return float(self.time[-1] - self.time[0] + np.median(np.diff(self.time)))

    def warnings(self) -> tuple[str, ...]:
        """Return notes for the user on how the commands were read, a sentence each."""
        return self.notes

    def scenario(self, mount: Mount | None = None) -> Scenario:
        """Return the scenario of these commands, in SBUS's steps of the sticks, each held until the next."""
        us = sticks.channels(self.setpoint, self.throttle, armed=True)
        changes = np.flatnonzero((us[1:] != us[:-1]).any(axis=1)) + 1
        begins = np.concatenate([[0], changes])
        ends = np.append(self.time[changes] - self.time[0], self.length_s)
        durations = np.diff(ends, prepend=0.0).tolist()
        segments = tuple(
            Segment(duration, (roll, pitch, yaw), thrust)
            for duration, (roll, pitch, yaw), thrust in zip(
                durations, self.setpoint[begins].tolist(), self.throttle[begins].tolist(), strict=True
            )
        )
        return Scenario(self.name, segments, Mount.CENTRE if mount is None else mount)


def part_of(
    where: str, whole: Sequence[Array], part: Part, name: str, notes: Sequence[str] = (), *, cut: bool
) -> Commands:
    """Return the commands of a part of a recording, seconds since its first row; notes, cut: see Commands.

    where: names the file in messages; whole: time (N,) [s], setpoint (N, 3) [deg/s] and throttle (N,) as the
    file has them, of any kind. Raises ScenarioError.
    """
    time = whole[0]
    rows = slice(0, len(time))
    try:
        if part != WHOLE and len(time):
            rows = part_rows(name, time - time[0], part)
        since_s = float(time[rows.start] - time[0]) if rows.start else 0.0
        time, setpoint, throttle = (column[rows] for column in whole)
        return Commands(name, time, setpoint, throttle, tuple(notes), rows.start, since_s, cut)
    except (ScenarioError, TraceError) as error:
        raise ScenarioError(f"{where}: {str(error).removeprefix(f'{name}: ')}") from error
