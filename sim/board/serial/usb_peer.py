"""A program at the image's USB port on the emulated board, in lockstep with it, for MSP's client."""

from __future__ import annotations

from typing import Protocol

from neuroflight.flash.link.client import Client
from neuroflight.sim.board.board import Board
from neuroflight.sim.board.core.context import TIME_HZ
from neuroflight.sim.board.usb.enumeration import (
    Description,
    complete,
    enumerate_device,
    request,
    transfer_to,
)
from neuroflight.sim.board.usb.host import Host, Status, Transfer
from neuroflight.toolchain.errors import LinkError

MS = TIME_HZ // 1000
DATA_OUT, DATA_IN = 0x01, 0x81
TO_INTERFACE = 0x21  # a class's request
SET_LINES = 0x22
READY = 3  # DTR and RTS
SLICE = TIME_HZ // 20_000


class Idle(Protocol):
    """An IdleBoard, as far as a program at its USB port needs one."""

    board: Board

    def run_to(self, cycle: int) -> None:
        """Let the board run until `cycle`."""

    def client(self) -> Client:
        """Open an MSP client on another line of it."""


def plug(idle: Idle, seconds: float = 1.0) -> Description:
    """Plug the cable in and return the device, configured. Raises LinkError: none has come."""
    host = idle.board.hardware.usb_host
    host.plug()
    end = idle.board.cycle + round(seconds * TIME_HZ)
    while not host.connected:
        if idle.board.cycle >= end:
            raise LinkError(f"no USB device has come within {seconds:g} s; expected the image's")
        idle.run_to(idle.board.cycle + MS)
    return complete(host, enumerate_device(host), idle.run_to)


def run(idle: Idle, ms: float) -> None:
    """Let so much time pass."""
    idle.run_to(idle.board.cycle + round(ms * MS))


def finish(idle: Idle, transfer: Transfer, ms: float = 1000) -> Transfer:
    """Run until a transfer has ended. Raises LinkError: it has not."""
    end = idle.board.cycle + round(ms * MS)
    while not transfer.done:
        if idle.board.cycle >= end:
            raise LinkError(f"a USB transfer has not ended within {ms:g} ms: {transfer}")
        idle.run_to(idle.board.cycle + SLICE)
    return transfer


class UsbPeer:
    """flash.transport.Transport: a program with the port open; `reads`: it asks for what the board says."""

    def __init__(self, idle: Idle, device: Description, *, reads: bool = True) -> None:
        """Open the port of a plugged device. Raises LinkError: it does not hear."""
        self.idle, self.device, self.reads = idle, device, reads
        self._asked: Transfer | None = None
        if (status := self.lines(READY)) is not Status.DONE:
            raise LinkError(f"USB: the port cannot be opened: {status.name}")

    @property
    def host(self) -> Host:
        """The computer's side of the cable."""
        return self.idle.board.hardware.usb_host

    @property
    def name(self) -> str:
        """The port, as messages call it."""
        return "USB of the emulated board"

    def client(self) -> Client:
        """Open an MSP client on it."""
        return Client(self, self.clock)

    def clock(self) -> float:
        """Return the emulated time since power-up [s]."""
        return self.idle.board.cycle / TIME_HZ

    def lines(self, state: int) -> Status:
        """Set DTR and RTS; a board that has gone does not hear it."""
        asked = self.host.control(request(TO_INTERFACE, SET_LINES, state), address=self.device.address)
        return finish(self.idle, asked).status

    def write(self, data: bytes) -> None:
        """Write; see Transport."""
        transfer_to(self.host, self.device, DATA_OUT, data)

    def take(self) -> bytes:
        """Return what has come."""
        came = b""
        if self._asked is not None and self._asked.done:
            came, self._asked = self._asked.received, None
        if self._asked is None and self.reads:
            self._asked = transfer_to(self.host, self.device, DATA_IN, length=4096)
        return came

    def read(self, timeout: float) -> bytes:
        """Read; see Transport. timeout: in emulated seconds."""
        end = self.idle.board.cycle + max(1, round(timeout * TIME_HZ))
        while not (came := self.take()):
            if self.idle.board.cycle >= end:
                return b""
            self.idle.run_to(min(end, self.idle.board.cycle + SLICE))
        return came

    def close(self) -> None:
        """Close; see Transport."""
        self.lines(0)
