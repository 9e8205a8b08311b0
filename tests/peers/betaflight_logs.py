"""Logs that Betaflight's SITL writes: by its virtual blackbox, and over a serial port."""

from __future__ import annotations

import contextlib
import socket
from pathlib import Path

import numpy as np

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.flight.loop import fly
from neuroflight.sim.flight.scenario import load_scenario
from neuroflight.sim.flight.trace import Trace
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.ports.betaflight.build import build_betaflight
from neuroflight.sim.ports.betaflight.port import BetaflightPort, aircraft_settings
from neuroflight.sim.ports.betaflight.process import STEP_NS, BetaflightProcess
from neuroflight.sim.ports.simulator_link import LOOPBACK
from tests.peers.conftest import BETAFLIGHT

VIRTUAL = "set blackbox_device = VIRTUAL"
SERIAL = ("set blackbox_device = SERIAL", "serial UART2 128 115200 57600 0 2000000")
UART2 = 5762  # its TCP port
AFTER = 1000  # steps of its time in which it ends the log
LIMIT_S = 20.0


def flown(name: str, *settings: str) -> tuple[bytes, Trace]:
    """The log of a flight, and its trace."""
    port = _port(settings)
    with contextlib.closing(port):
        trace = _fly(port, name)
        folder = port._process._folder
        (path,) = folder.glob("LOG*")
        return path.read_bytes(), trace


def flown_over_serial(name: str, *settings: str) -> bytes:
    """The log as it comes out of a serial port of its, which it opens when it arms."""
    port = _port((*SERIAL, *settings))
    heard = bytearray()
    with contextlib.closing(port), contextlib.ExitStack() as ends:
        line: list[socket.socket] = []
        run = port._process.run

        def run_and_hear(ns: int) -> None:
            run(ns)
            if not line and UART2 in port._process.ports:
                address = (LOOPBACK, port._process.ports[UART2])
                line.append(ends.enter_context(socket.create_connection(address, LIMIT_S)))
                line[0].setblocking(False)
            with contextlib.suppress(BlockingIOError):
                while line and (data := line[0].recv(1 << 16)):
                    heard.extend(data)

        port._process.run = run_and_hear  # type: ignore[method-assign]
        _fly(port, name)
    return bytes(heard)


def _port(settings: tuple[str, ...]) -> BetaflightPort:
    aircraft = load_aircraft("nf1")
    betaflight = build_betaflight(BETAFLIGHT, print)
    return BetaflightPort(betaflight, settings=(*aircraft_settings(aircraft), *settings))


def _fly(port: BetaflightPort, name: str) -> Trace:
    scenario = load_scenario(name, 1, 3, None)
    twin = Twin(
        load_aircraft("nf1"),
        rate_hz=port.gyro_rate_hz,
        mount=scenario.mount,
        rng=np.random.default_rng((1, 1)),
    )
    with contextlib.closing(twin):
        trace = fly(twin, port, scenario)
    process: BetaflightProcess = port._process
    for _ in range(AFTER):
        process.run(STEP_NS)
    return trace


def save(path: Path, data: bytes) -> Path:
    """The log as a file."""
    path.write_bytes(data)
    return path
