"""Logs that the firmware's own blackbox writes on the library, for replays."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.flight.scenario import Scenario
from neuroflight.sim.ports.library import ReferencePort
from neuroflight.sim.ports.port import Sample, twin_settings
from tests.sim.replay.recorder import flown

DRAIN = 20  # gyro samples between two looks for bytes of the log
AFTER = 8000  # gyro samples after the flight: the log ends some time after disarming

Meddle = Callable[[Any, int, Sample], None]  # before sample number n is taken


class LoggingPort(ReferencePort):
    """The library behind its port, whose log is kept."""

    def __init__(self, *arguments: Any, meddle: Meddle) -> None:
        super().__init__(*arguments)
        self.log = bytearray(self.reference.blackbox())
        self._meddle, self._number = meddle, 0
        self.deaf = False  # no receiver frame arrives

    def exchange(self, sample: Sample, channels_us: Any) -> Any:
        """As the library, after whatever meddles."""
        self._meddle(self, self._number, sample)
        reply = super().exchange(sample, None if self.deaf else channels_us)
        self._number += 1
        if self._number % DRAIN == 0:
            self.log += self.reference.blackbox()
        return reply


def logged(
    library: Path,
    scenario: Scenario,
    path: Path,
    *,
    meddle: Meddle = lambda port, number, sample: None,
    settings: dict[str, float] | None = None,
    rate_hz: int = 4000,
) -> Path:
    """Fly the NF1 on the library and write its log to `path`."""
    given = {**twin_settings(load_aircraft("nf1")), **(settings or {})}
    port = LoggingPort(library, rate_hz, given, meddle=meddle)
    still = Sample(0.0, np.zeros(3), np.eye(3), np.zeros(3), np.zeros(3), np.array([0.0, 0.0, 9.81]))
    with closing(port):
        flown(port, scenario)
        for _ in range(AFTER):
            port.exchange(still, None)
    path.write_bytes(port.log)
    return path
