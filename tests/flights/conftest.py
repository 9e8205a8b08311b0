"""Flights of a shipped policy in the twin of its aircraft, the NF1 unless a test says another."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.control.pid import aircraft_pid
from neuroflight.sim.control.pid_table import pid_settings
from neuroflight.sim.flight.loop import fly
from neuroflight.sim.flight.scenario import Scenario
from neuroflight.sim.flight.trace import Trace
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.ports.library import ReferencePort
from neuroflight.sim.ports.port import FirmwarePort
from neuroflight.sim.ports.python_controller import ControllerPort

GYRO_RATE_HZ = 4000
Flown = Callable[..., Trace]


@pytest.fixture(scope="session")
def flown() -> Flown:
    """Flies a port in a fresh twin, gyro noise on, and closes both."""

    def run(
        port: FirmwarePort,
        scenario: Scenario,
        seed: int = 1,
        motor_order: tuple[int, ...] | None = None,
        aircraft: str = "nf1",
    ) -> Trace:
        rng = np.random.default_rng((seed, 1))
        twin = Twin(load_aircraft(aircraft), rate_hz=port.gyro_rate_hz, mount=scenario.mount, rng=rng)
        with closing(port), closing(twin):
            return fly(twin, port, scenario, motor_order=motor_order)

    return run


@pytest.fixture
def reference(reference_library: Path) -> ReferencePort:
    """A freshly booted firmware."""
    return ReferencePort(reference_library, GYRO_RATE_HZ)


@pytest.fixture
def pid() -> ControllerPort:
    """The PID with the aircraft's gains."""
    nf1 = load_aircraft("nf1")
    own = pid_settings(nf1)
    return ControllerPort(
        aircraft_pid(nf1), 4, GYRO_RATE_HZ, idle=own.idle, mix=own.mix, gyro_filters=own.gyro_filters
    )
