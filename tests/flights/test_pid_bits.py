"""The PID of evaluations is the one that flies: the same bits, from a step to a whole flight.

Recorded flights of the firmware are given to compare's controller step by step. Then Python's control path
and the loop of evaluations fly the same flights by themselves.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from neuroflight.sim.aircraft.model import Aircraft, load_aircraft
from neuroflight.sim.flight.loop import fly
from neuroflight.sim.flight.scenario import Scenario, Segment
from neuroflight.sim.flight.trace import Trace
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.physics.world import Mount
from neuroflight.sim.ports.emulator import EmulatedPort
from neuroflight.sim.ports.host import HostPort
from neuroflight.sim.ports.library import ReferencePort
from neuroflight.sim.ports.port import FirmwarePort
from neuroflight.sim.ports.python_controller import ControllerPort
from neuroflight.training.evaluation.controllers import load_controller
from neuroflight.training.evaluation.evaluation import record
from tests.flights.recomputed import recomputed
from tests.given_task import Given
from tests.sampling import sampled

Flown = Callable[..., Trace]
NF1 = load_aircraft("nf1")
PID = load_controller("pid", NF1)
GYRO_HZ = 4000
# A pack of 15.0 V at rest, of the PID's nominal 16: it is compensated throughout, as the load has it.
SUPPLIES = pytest.mark.parametrize("full", [None, 15.0], ids=["bench supply", "sagging pack"])
CELLS = {"battery_cells": 4}


def busy(mount: Mount) -> Scenario:
    """A second of commands on all axes, from throttle closed to full."""
    segments = (Segment(0.1, (250.0 * (-1) ** k, 60.0 * k, -50.0 * k), min(1.0, 0.12 * k)) for k in range(10))
    return Scenario("busy", tuple(segments), mount).under_pid()


def supplied(full: float | None) -> tuple[Aircraft, float | None]:
    """Return an NF1 and its pack's charge; full: voltage of a full pack at rest, None: the bench supply."""
    if full is None:
        return NF1, None
    assert NF1.battery is not None
    return replace(NF1, battery=replace(NF1.battery, rest_voltage=full)), 1.0


def flight(port: FirmwarePort, mount: Mount, full: float | None, *, noise: bool) -> Trace:
    aircraft, charge = supplied(full)
    rng = np.random.default_rng(1)
    twin = Twin(aircraft, rate_hz=GYRO_HZ, mount=mount, noise=noise, charge=charge, rng=rng)
    with closing(port), closing(twin):
        return fly(twin, port, busy(mount))


@pytest.mark.parametrize("where", sampled(["host program", "library", "emulated board"], "library"))
def test_compares_controller_gives_the_values_that_the_firmware_sent(
    host_program: Path, reference_library: Path, board_image: Path, flown: Flown, where: str
) -> None:
    make: dict[str, Callable[[], FirmwarePort]] = {
        "host program": lambda: HostPort(host_program, GYRO_HZ),
        "library": lambda: ReferencePort(reference_library, GYRO_HZ),
        "emulated board": lambda: EmulatedPort(board_image.with_suffix(".bin"), GYRO_HZ),
    }
    trace = flown(make[where](), busy(Mount.CENTRE))
    assert np.ptp(trace.dshot.astype(int), axis=0).min() > 1000, "every motor went through most of its range"
    assert np.array_equal(recomputed(trace, PID), trace.dshot)


@SUPPLIES
def test_pythons_control_path_flies_the_firmwares_flight(reference_library: Path, full: float | None) -> None:
    python = ControllerPort(
        PID.build(1), 4, GYRO_HZ, PID.control_rate_hz, PID.idle, mix=PID.mix, gyro_filters=PID.gyro_filters
    )
    flown = flight(ReferencePort(reference_library, GYRO_HZ, CELLS), Mount.CENTRE, full, noise=True)
    assert flight(python, Mount.CENTRE, full, noise=True).same(flown)


@SUPPLIES
@pytest.mark.parametrize("mount", [Mount.CENTRE, Mount.RIG])
def test_an_evaluation_flies_the_firmwares_flight(
    reference_library: Path, mount: Mount, full: float | None
) -> None:
    """Without noise: an evaluation begins where the firmware has measured its gyro's bias for a second."""
    port = ReferencePort(reference_library, GYRO_HZ, {**CELLS, "gyro_stuck_ms": 0})
    firmware = flight(port, mount, full, noise=False)
    aircraft, charge = supplied(full)
    evaluated = record(
        PID.build(1),
        aircraft,
        Given(firmware.setpoint[None]),
        episodes=1,
        seed=1,
        control_rate_hz=PID.control_rate_hz,
        mount=mount,
        noise=False,
        throttle=firmware.throttle[None],
        idle=PID.idle,
        mix=PID.mix,
        gyro_filters=PID.gyro_filters,
        charge=charge,
    )
    assert evaluated.motors is not None
    assert np.array_equal(evaluated.motors[0], firmware.motors.astype(np.float32))
    assert np.array_equal(evaluated.rate[0], firmware.rate.astype(np.float32))
