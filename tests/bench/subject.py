"""What is timed in turns with others, so that a change of the machine's speed meets all alike."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass


@dataclass
class Subject:
    """Something that is stepped for time."""

    name: str
    aircraft: int  # that one call steps
    advance: Callable[[], object]
    best: float = 0.0  # aircraft steps a second

    def time(self, seconds: float) -> None:
        """Take one turn of about `seconds`."""
        self.advance()
        calls, began = 0, time.perf_counter()
        while time.perf_counter() - began < seconds:
            self.advance()
            calls += 1
        self.best = max(self.best, calls * self.aircraft / (time.perf_counter() - began))
