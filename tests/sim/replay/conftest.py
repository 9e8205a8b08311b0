"""Flights of the library, noted from outside, to be replayed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from neuroflight.sim.flight.scenario import load_scenario
from neuroflight.sim.ports.port import Sample
from neuroflight.sim.replay.inputs import Flight
from tests.sim.replay.recorder import Recorder, recorded

LATE, ON_TIME = 4800, 4812  # gyro samples; three control steps in between
NO_NUMBER = 5403
SILENT = 6001


def troubled(port: Recorder, number: int, sample: Sample) -> None:
    """Missed deadlines, so that the PID takes over; a sample that is none; at last a silence, which stops."""
    if number in (LATE, ON_TIME):
        port.late(number == LATE)
    if number == NO_NUMBER:
        sample.gyro[:] = np.nan
    if number == SILENT:
        port.silent()


@pytest.fixture(scope="session")
def calm_flight(reference_library: Path) -> Flight:
    """1.5 s in the air, nothing happens."""
    return recorded(reference_library, load_scenario("roll", 1))


@pytest.fixture(scope="session")
def troubled_flight(reference_library: Path) -> Flight:
    """One that a fallback and a fault end."""
    return recorded(reference_library, load_scenario("roll", 1), meddle=troubled)
