"""Lines on which programs that others have written talk to the firmware, and to Betaflight."""

from __future__ import annotations

import contextlib
import re
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import serial

from neuroflight.sim.ports.betaflight.build import build_betaflight
from neuroflight.sim.ports.betaflight.process import STEP_NS, BetaflightProcess
from neuroflight.toolchain.contract import MSP_TCP_PORT
from tests.cli.test_board import Running
from tests.firmware.conftest import Program
from tests.peers.usb_computer import computer, wait_until
from tests.peers.yamspy_client import WAIT_S
from tests.sampling import sampled

BETAFLIGHT = Path(__file__).resolve().parents[2] / "build" / "tests" / "BETAFLIGHT"
BOOT_SAMPLES = 4200  # at 1 kHz: the delay before arming, and some more

Line = Any  # a serial port, or a socket that looks like one


def tcp_line(port: int) -> Line:
    """TCP in place of a serial port."""
    return serial.serial_for_url(f"socket://127.0.0.1:{port}", timeout=WAIT_S)


@pytest.fixture
def betaflight_port() -> Iterator[int]:
    """Run a new SITL of Betaflight, whose time goes on in a thread of its own; give its MSP port."""
    ended = threading.Event()
    with BetaflightProcess(build_betaflight(BETAFLIGHT, print)) as process:

        def live() -> None:
            while not ended.is_set():
                process.run(STEP_NS)

        life = threading.Thread(target=live)
        life.start()
        try:
            yield process.ports[MSP_TCP_PORT]
        finally:
            ended.set()
            life.join()


@pytest.fixture
def betaflight_line(betaflight_port: int) -> Iterator[Line]:
    """Connect to that SITL."""
    with tcp_line(betaflight_port) as line:
        yield line


@pytest.fixture
def start_host(host_program: Path) -> Iterator[Callable[..., Program]]:
    """Starts host programs at 1 kHz with the settings that are given, booted, and ready to arm."""
    with contextlib.ExitStack() as running:

        def start(**settings: object) -> Program:
            told = [f"--set={name}={value}" for name, value in settings.items()]
            program = Program(host_program.parent, "--gyro-hz=1000", *told)
            running.callback(program.close)
            for _ in range(BOOT_SAMPLES):
                program.sticks()
                program.step()
            return program

        yield start


@pytest.fixture
def host(start_host: Callable[..., Program]) -> Program:
    """One as it comes."""
    return start_host()


def usb_port(told: str) -> int:
    """The USB/IP port that `image emulate` tells."""
    found = re.search(r"^USB +127\.0\.0\.1:(\d+),", told, re.MULTILINE)
    assert found is not None, told
    return int(found[1])


@contextlib.contextmanager
def board_port(image: Path, line: str, folder: Path) -> Iterator[tuple[str, int]]:
    """Run an image on the emulated board; its serial port and speed, by "uart" or "usb"."""
    with contextlib.ExitStack() as running:
        board = Running(image, *(("--usb", "0") if line == "usb" else ()))
        running.callback(board.end)
        if line == "uart":
            yield board.port, board.baud
            return
        at = running.enter_context(computer(usb_port(board.told), folder / "by-id"))
        yield str(wait_until(lambda: next(at.links.iterdir(), None))), board.baud


@pytest.fixture(params=sampled(["tcp", "uart", "usb"], "tcp", "uart"))
def line(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Line]:
    """A line to the firmware: to the host program, and to the image on the emulated board, twice."""
    if request.param == "tcp":
        with tcp_line(request.getfixturevalue("host").ports["msp"]) as tcp:
            yield tcp
        return
    image = request.getfixturevalue("board_image").with_suffix(".bin")
    with (
        board_port(image, request.param, tmp_path) as (port, baud),
        serial.Serial(port, baud, timeout=WAIT_S) as uart,
    ):
        yield uart
