"""Comparison of the setpoints that a firmware flies with those that the sent channels mean.

They differ where its settings were changed since it started: it flies the old ones until the next start.
"""

from __future__ import annotations

from collections import deque

from neuroflight.flash.monitoring.stream import Sample
from neuroflight.toolchain.contract import FlightState

WINDOW_S = 0.4  # age of a sample, at most
PAUSE_S = 0.1  # without channels, after which the firmware centres the sticks
TOLERANCE = 0.02  # rad/s, and of the rate
SAMPLES = 3  # in a row
OBEYED = frozenset({FlightState.DISARMED.name, FlightState.ARMED.name})  # states in which sticks are obeyed

Rates = tuple[float, ...]


class SetpointCheck:
    """The setpoints sent lately, compared with those flown."""

    def __init__(self) -> None:
        self.wrong = False  # for good
        self._asked: deque[tuple[float, Rates]] = deque()
        self._since = 0.0  # time of the first of an unbroken sequence of channels
        self._misses = 0

    def sent(self, setpoint: Rates, now: float) -> None:
        """Record that channels for `setpoint` [rad/s] were sent."""
        if self._asked and now - self._asked[-1][0] > PAUSE_S:
            self._asked.clear()
        if not self._asked:
            self._since = now
        self._asked.append((now, setpoint))
        while self._asked[0][0] < now - WINDOW_S:
            self._asked.popleft()

    def see(self, sample: Sample, now: float) -> bool:
        """Check a sample that is no older than WINDOW_S; return True when the setpoints first prove wrong."""
        steered = bool(self._asked) and now - self._asked[-1][0] < PAUSE_S and now - self._since >= WINDOW_S
        if self.wrong or not steered or sample.state not in OBEYED:
            return False
        self._misses = 0 if self._is_asked(sample.setpoint) else self._misses + 1
        self.wrong = self._misses >= SAMPLES
        return self.wrong

    def _is_asked(self, setpoint: Rates) -> bool:
        """Return True if each axis lies within the range asked for lately."""
        for told, *asked in zip(setpoint, *(rates for _, rates in self._asked), strict=True):
            low, high = min(asked), max(asked)
            room = TOLERANCE * (1 + max(abs(low), abs(high)))
            if not low - room <= told <= high + room:
                return False
        return True
