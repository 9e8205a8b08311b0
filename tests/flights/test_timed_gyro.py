"""Boards whose gyro's data-ready line nobody tells: the firmware reads the chip at a timer's beat."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.board.debug.fault_injection import parse_fault
from neuroflight.sim.board.fitted import GYROS, MATEKF722
from neuroflight.sim.flight.loop import fly
from neuroflight.sim.flight.trace import Trace
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.ports.emulator import EmulatedPort
from neuroflight.sim.ports.library import ReferencePort
from neuroflight.sim.ports.port import FirmwarePort
from neuroflight.toolchain.boards.allocation import allocate
from tests.flights.test_boards import part, restamped
from tests.flights.test_emulator import OnTheChipsGrid
from tests.sampling import sampled

Again = Callable[..., Trace]  # a flight from power on, of a chip that is so much slower, with faults


def flight(port: FirmwarePort) -> Trace:
    with closing(Twin(load_aircraft("nf1"), rate_hz=port.gyro_rate_hz, rng=np.random.default_rng(1))) as twin:
        return fly(twin, port, part())


def ported(board_image: Path, folder: Path, kind: str) -> EmulatedPort:
    """MATEKF722 with that chip, and nobody who knows its data-ready line. What finds a stuck one is off."""
    place = replace(MATEKF722.gyros[0], ready=None)
    wiring = replace(MATEKF722, gyros=(place,), gyro_kinds=(kind.upper(),))
    image = restamped(board_image, allocate(wiring), folder)
    return EmulatedPort(image, settings={"gyro_stuck_ms": 0}, wiring=wiring, gyro=GYROS[kind])


@pytest.fixture(scope="module")
def port(board_image: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[EmulatedPort]:
    with closing(ported(board_image, tmp_path_factory.mktemp("timed"), "mpu6000")) as port:
        yield port


@pytest.fixture(scope="module")
def again(port: EmulatedPort) -> Again:
    moment = port.save()

    def run(slower: float = 1.0, *faults: str) -> Trace:
        port.restore(moment, [parse_fault(fault) for fault in faults])
        gyro = port.board.hardware.gyro
        assert gyro.next_sample is not None
        gyro.begin_at(gyro.next_sample, slower)
        return flight(port)

    return run


@pytest.fixture(scope="module")
def on_host(reference_library: Path) -> Trace:
    return flight(ReferencePort(reference_library))


def mean_error(trace: Trace) -> float:
    return float(np.abs(trace.setpoint - trace.rate).mean())


def test_it_flies_the_librarys_bits_when_the_chips_clock_is_the_processors(
    again: Again, on_host: Trace
) -> None:
    assert again().same(on_host)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "library"), [("icm42688p", ReferencePort), ("lsm6dsv16x", OnTheChipsGrid)])
def test_it_reads_chips_of_all_makers(
    board_image: Path, reference_library: Path, tmp_path: Path, kind: str, library: type[ReferencePort]
) -> None:
    with closing(ported(board_image, tmp_path, kind)) as port:
        assert flight(port).same(flight(library(reference_library)))


@pytest.mark.parametrize("slower", sampled([0.98, 0.99, 1.01, 1.02], 1.02))
def test_it_follows_as_well_when_the_chips_clock_is_another(
    again: Again, on_host: Trace, slower: float
) -> None:
    on_board = again(slower)
    assert not on_board.same(on_host)  # samples are up to a period of the chip's older
    assert mean_error(on_board) == pytest.approx(mean_error(on_host), rel=0.005)


@pytest.mark.parametrize("fault", sampled(["gyro-silent", "gyro-line=1", "gyro-line=0"], "gyro-line=1"))
def test_the_motors_stop_when_the_chip_says_nothing_new(again: Again, port: EmulatedPort, fault: str) -> None:
    again(1.0, f"{fault}@0.1")
    (stop,) = (event for event in port.events if event.stops)
    assert stop.what == "FAULT: GYRO_INVALID" and 0.11 <= stop.at_s < 0.112
