"""Flights on the twin's battery: the firmware measures it, and tells the pilot when it is nearly empty."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from neuroflight.flash.link import messages
from neuroflight.flash.link.client import Client
from neuroflight.flash.link.messages import BatteryLevel, BatteryState
from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.board.core.context import TIME_HZ
from neuroflight.sim.board.serial.bridge import LineTransport, UartLine
from neuroflight.sim.flight.loop import fly
from neuroflight.sim.flight.scenario import Scenario, Segment
from neuroflight.sim.flight.trace import Trace
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.ports.emulator import EmulatedPort
from neuroflight.sim.ports.host import HostPort
from neuroflight.sim.ports.library import ReferencePort
from neuroflight.sim.ports.port import BatteryPort, FirmwarePort, Sample
from neuroflight.toolchain.contract import Msp

CLIMB = Scenario("climb", (Segment(0.4, throttle=0.5), Segment(1.6, (40.0, -30.0, 20.0), 0.6)))
STILL = Sample(0.0, np.zeros(3), np.eye(3), np.zeros(3), np.zeros(3), np.array([0.0, 0.0, 9.80665]))
VOLTS, AMPS = 13.6, 21.5  # of a pack under load
BEEPER, LED = "PC13", "PB9"
SLOT_S = 0.05  # of the firmware's rhythms
EMPTY = 0.005  # charge of a pack that has nearly nothing left


def fly_on(port: FirmwarePort, charge: float | None) -> Trace:
    """A flight on the NF1's battery charged so far, None: on the bench supply; the port stays open."""
    rng = np.random.default_rng((1, 1))
    with closing(Twin(load_aircraft("nf1"), rate_hz=port.gyro_rate_hz, charge=charge, rng=rng)) as twin:
        return fly(twin, port, CLIMB)


def ask_board(port: EmulatedPort) -> BatteryState:
    """What the image answers over MSP, on its UART."""
    transport = LineTransport(UartLine(port.board))
    return messages.battery_state(Client(transport, transport.clock).request(Msp.BATTERY_STATE))


def ask_host(port: HostPort) -> BatteryState:
    with port._msp() as client:
        return messages.battery_state(client.request(Msp.BATTERY_STATE))


def ask_library(port: ReferencePort) -> BatteryState:
    return messages.battery_state(Client(port.reference).request(Msp.BATTERY_STATE))


class Pin:
    """Times and levels to which a pin of the image changes."""

    def __init__(self, port: EmulatedPort, name: str) -> None:
        self._changes: list[tuple[float, bool]] = []
        self._board = port.board
        port.board.hardware.pins.watch(name, self._note)

    def _note(self, level: bool) -> None:
        self._changes.append((self._board.cycle / TIME_HZ, level))

    def slots(self, level: bool, since: float) -> list[int]:
        """For how many slots it was at `level`, each time that it came to be so from `since` on [s]."""
        changes = [change for change in self._changes if change[0] >= since]
        pairs = pairwise(changes)
        return [round((end - begin) / SLOT_S) for (begin, was), (end, _) in pairs if was == level]


@pytest.fixture(scope="module")
def image(board_image: Path) -> Path:
    """The file to be flashed."""
    return board_image.with_suffix(".bin")


@dataclass(frozen=True)
class Told:
    """A flight of the board, and how it told of its battery."""

    trace: Trace
    beeper: Pin
    led: Pin
    ended_s: float  # of the board's time
    state: BatteryState


@pytest.fixture(scope="module")
def fly_told(image: Path) -> Callable[[float], Told]:
    """Flies the board on a pack of that charge, each of them once."""

    @cache
    def run(charge: float) -> Told:
        with closing(EmulatedPort(image)) as port:
            beeper, led = Pin(port, BEEPER), Pin(port, LED)
            trace = fly_on(port, charge)
            return Told(trace, beeper, led, port.board.cycle / TIME_HZ, ask_board(port))

    return run


@pytest.fixture
def open_port(
    image: Path, host_program: Path, reference_library: Path
) -> dict[str, Callable[[], BatteryPort]]:
    """What opens each port that measures a battery, by its name."""
    return {
        "emulator": lambda: EmulatedPort(image),
        "host": lambda: HostPort(host_program),
        "library": lambda: ReferencePort(reference_library),
    }


ASK: dict[str, Callable[..., BatteryState]] = {
    "emulator": ask_board,
    "host": ask_host,
    "library": ask_library,
}


@pytest.mark.parametrize("name", ASK)
def test_the_firmware_measures_the_battery_that_its_port_is_told(
    name: str, open_port: dict[str, Callable[[], BatteryPort]]
) -> None:
    with closing(open_port[name]()) as port:
        port.set_battery(VOLTS, AMPS)
        for _ in range(3000):
            port.exchange(STILL, None)
        state = ASK[name](port)
    assert state.voltage_v == pytest.approx(VOLTS, abs=0.02)  # a step of the converter is 9 mV
    assert state.current_a == pytest.approx(AMPS, abs=0.1)  # and 45 mA
    assert (state.cells, state.level) == (4, BatteryLevel.WARNING)


# What beeper and LED do armed, in slots of 50 ms: a tone of 4 for the arming, then the battery's rhythm.
GOOD, WARNING, CRITICAL = (
    (BatteryLevel.GOOD, {4}, 1),
    (BatteryLevel.WARNING, {4}, 2),
    (BatteryLevel.CRITICAL, {8}, 3),
)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("charge", "told"),
    [
        pytest.param(0.9, GOOD, marks=pytest.mark.slow),
        pytest.param(0.05, WARNING, marks=pytest.mark.slow),
        (EMPTY, CRITICAL),
    ],
)
def test_msp_beeper_and_led_tell_when_the_twins_pack_is_nearly_empty(
    fly_told: Callable[[float], Told], charge: float, told: tuple[BatteryLevel, set[int], int]
) -> None:
    level, beeps, least = told
    flight = fly_told(charge)
    began = flight.ended_s - flight.trace.t[-1] - 0.05
    assert flight.state.level == level
    heard = flight.beeper.slots(True, began)
    assert set(heard) == beeps
    assert len(heard) >= least
    dark = flight.led.slots(True, began)  # the LED is lit by a low pin
    assert dark.count(2) >= 3 if level is BatteryLevel.CRITICAL else not dark


def test_the_policys_flight_is_the_same_on_board_host_and_library_when_the_battery_sags(
    fly_told: Callable[[float], Told], open_port: dict[str, Callable[[], BatteryPort]]
) -> None:
    board = fly_told(EMPTY).trace
    for name in ("host", "library"):
        with closing(open_port[name]()) as port:
            assert board.same(fly_on(port, EMPTY)), name
    with closing(open_port["library"]()) as port:
        assert not board.same(fly_on(port, None)), "the bench supply does not sag"


@pytest.mark.slow
def test_the_image_sees_a_full_pack_when_the_aircraft_hangs_on_the_bench_supply(image: Path) -> None:
    with closing(EmulatedPort(image)) as port:
        fly_on(port, None)
        state = ask_board(port)
    assert state.level is BatteryLevel.GOOD
    assert state.voltage_v == pytest.approx(16.8, abs=0.02)
