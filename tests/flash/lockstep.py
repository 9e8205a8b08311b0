"""The host program in lockstep with a tool: the tool's time is the program's, and passes while it sleeps."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from neuroflight.flash.link.client import Client
from neuroflight.flash.link.transport import open_transport
from tests.firmware.conftest import Program

GYRO_HZ = 1000
BOOT_MS = 1300
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
