"""Flights by eye: the pilot sees the twin, so that the firmware's sticks are the same wherever it runs."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.flight.loop import fly
from neuroflight.sim.flight.scenario import Scenario, Segment, load_scenario
from neuroflight.sim.flight.trace import Trace
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.physics.world import Mount
from neuroflight.sim.ports.emulator import EmulatedPort
from neuroflight.sim.ports.host import HostPort
from neuroflight.sim.ports.library import ReferencePort
from neuroflight.sim.ports.port import FirmwarePort

HOP = Scenario("hop", (Segment(0.1), Segment(1.5, (0.0, 0.0, 60.0), height_m=0.3), Segment(0.1)), Mount.FREE)


def by_eye(port: FirmwarePort, scenario: Scenario) -> Trace:
    """A flight from the ground in gusts, on a battery."""
    rng = np.random.default_rng((1, 1))
    nf1 = load_aircraft("nf1")
    twin = Twin(nf1, rate_hz=port.gyro_rate_hz, mount=Mount.FREE, charge=0.9, gust=7.7, ground=True, rng=rng)
    with closing(port), closing(twin):
        return fly(twin, port, scenario)


def test_a_flight_by_eye_is_the_same_on_library_and_host(reference_library: Path, host_program: Path) -> None:
    library, host = by_eye(ReferencePort(reference_library), HOP), by_eye(HostPort(host_program), HOP)
    assert library.same(host)
    assert len(np.unique(library.throttle)) > 5, "he moves his stick"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["hop", "sticks"])
def test_a_flight_by_eye_is_the_same_on_the_board(
    name: str, reference_library: Path, board_image: Path
) -> None:
    scenario = HOP if name == "hop" else load_scenario(name, 1)
    board = by_eye(EmulatedPort(board_image.with_suffix(".bin")), scenario)
    assert board.same(by_eye(ReferencePort(reference_library), scenario))
