"""The host program in lockstep with a tool, whose time is the program's, or with samples at a test's wish."""

from __future__ import annotations

import struct
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from neuroflight.flash.board.info import Info, read_info
from neuroflight.flash.link.client import Client
from neuroflight.flash.link.transport import open_transport
from neuroflight.toolchain.contract import (
    BOOT_GRACE_MS,
    CALIBRATION_MS,
    RECEIVER_RECOVERY_MS,
    SIM_RECEIVER_FORMAT,
)
from tests.firmware.conftest import Program

GYRO_HZ = 1000
BOOT_MS = 1300
BOOT_SAMPLES = (max(BOOT_GRACE_MS, CALIBRATION_MS) + 100) * GYRO_HZ // 1000
LINK_SAMPLES = (RECEIVER_RECOVERY_MS + 50) * GYRO_HZ // 1000  # until the receiver is believed
STICKS_DOWN = (1500, 1500, 1000, 1500, 1000, *[1000] * 11)  # roll, pitch, throttle, yaw, arm switch
SWITCH_ON = (*STICKS_DOWN[:4], 2000, *STICKS_DOWN[5:])
THROTTLE_UP = (*STICKS_DOWN[:2], 1800, *STICKS_DOWN[3:])
Motors = tuple[float, ...]


class Lockstep:
    """A booted program, disarmed, with a receiver whose sticks are down unless `sticks` says otherwise."""

    def __init__(self, program: Program, receiver: bool = True) -> None:
        self.program, self.receiver = program, receiver
        self.sticks: dict[str, Any] = {}
        self.samples = 0
        self.turned: list[Motors] = []  # what the motors were sent, where it differs from the sample before
        self.run(BOOT_MS)

    @property
    def port(self) -> str:
        return f"tcp:127.0.0.1:{self.program.ports['msp']}"

    def client(self) -> Client:
        return Client(open_transport(self.port))

    def run(self, ms: float) -> Motors:
        """So much of the firmware's time; returns motor fractions."""
        motors: Motors = ()
        for _ in range(max(1, round(ms * GYRO_HZ / 1000))):
            if self.receiver:
                self.program.sticks(**self.sticks)
            motors = tuple(self.program.step())
            self.samples += 1
            if not self.turned or self.turned[-1] != motors:
                self.turned.append(motors)
        return motors

    def clock(self) -> float:
        return self.samples / GYRO_HZ

    def sleep(self, seconds: float) -> None:
        assert seconds >= 0
        self.run(1000 * seconds)

    def stopped_after(self, limit_ms: int) -> int:
        """Milliseconds until no motor turns. Fails after `limit_ms`."""
        for ms in range(limit_ms + 1):
            if not any(self.run(1)):
                return ms
        raise AssertionError(f"motors turn after {limit_ms} ms: {self.turned[-1]}")

    @property
    def most(self) -> Motors:
        """The largest fraction that each motor was sent."""
        return tuple(max(values) for values in zip(*self.turned, strict=True))


@contextmanager
def lockstep(host_program: Path, *options: str, receiver: bool = True) -> Iterator[Lockstep]:
    program = Program(host_program.parent, f"--gyro-hz={GYRO_HZ}", *options)
    try:
        yield Lockstep(program, receiver)
    finally:
        program.close()


@pytest.fixture
def booted(host_program: Path, tmp_path: Path) -> Iterator[Lockstep]:
    """One around the shipped policy that keeps its flash in tmp_path."""
    with lockstep(host_program, f"--settings={tmp_path / 'flash.bin'}") as one:
        yield one


class Host:
    """A program at power-on, with samples at rest and channels for as long as a test lets them come."""

    def __init__(self, program: Program) -> None:
        self.program = program

    @property
    def port(self) -> str:
        return f"tcp:127.0.0.1:{self.program.ports['msp']}"

    def fly(self, samples: int, channels_us: tuple[int, ...]) -> None:
        """Let so many gyro samples pass at rest with these channels."""
        for _ in range(samples):
            self.program.send("receiver", struct.pack(SIM_RECEIVER_FORMAT, 0.0, *channels_us))
            self.program.step()

    @contextmanager
    def flying(self, channels_us: tuple[int, ...]) -> Iterator[None]:
        """Samples come without end, meanwhile."""
        over = threading.Event()

        def fly() -> None:
            while not over.is_set():
                self.fly(10, channels_us)

        pilot = threading.Thread(target=fly)
        pilot.start()
        try:
            yield
        finally:
            over.set()
            pilot.join()

    def info(self) -> Info:
        with Client(open_transport(self.port)) as client:
            return read_info(client)


@pytest.fixture
def host(host_program: Path) -> Iterator[Host]:
    # This gyro has no noise: without it a stuck one and a still one look alike.
    program = Program(host_program.parent, f"--gyro-hz={GYRO_HZ}", "--set=gyro_stuck_ms=0")
    try:
        yield Host(program)
    finally:
        program.close()
