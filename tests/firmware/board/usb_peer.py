"""A program at the image's USB port on the emulated board, in lockstep with it, for MSP's client."""

from __future__ import annotations

from neuroflight.flash.link.client import Client
from neuroflight.sim.board.core.context import TIME_HZ
from neuroflight.sim.board.serial.idle_board import IdleBoard
from neuroflight.sim.board.usb.enumeration import (
    Description,
    complete,
    enumerate_device,
    request,
    transfer_to,
)
from neuroflight.sim.board.usb.host import Host, Status, Transfer

MS = TIME_HZ // 1000
DATA_OUT, DATA_IN = 0x01, 0x81
TO_INTERFACE = 0x21  # a class's request
SET_LINES = 0x22
READY = 3  # DTR and RTS
SLICE = TIME_HZ // 20_000


def plug(idle: IdleBoard, seconds: float = 1.0) -> Description:
    """Plug the cable in; returns the device, configured."""
    host = idle.board.hardware.usb_host
    host.plug()
    end = idle.board.cycle + round(seconds * TIME_HZ)
    while not host.connected:
        assert idle.board.cycle < end, "no device has come"
        idle.run_to(idle.board.cycle + MS)
    return complete(host, enumerate_device(host), idle.run_to)


def run(idle: IdleBoard, ms: float) -> None:
    idle.run_to(idle.board.cycle + round(ms * MS))


def finish(idle: IdleBoard, transfer: Transfer, ms: float = 1000) -> Transfer:
    """Run until a transfer has ended."""
    end = idle.board.cycle + round(ms * MS)
    while not transfer.done:
        assert idle.board.cycle < end, f"a transfer that does not end: {transfer}"
        idle.run_to(idle.board.cycle + SLICE)
    return transfer


class UsbPeer:
    """flash.transport.Transport: a program with the port open; `reads`: it asks for what the board says."""

    def __init__(self, idle: IdleBoard, device: Description, *, reads: bool = True) -> None:
        self.idle, self.device, self.reads = idle, device, reads
        self._asked: Transfer | None = None
        assert self.lines(READY) is Status.DONE

    @property
    def host(self) -> Host:
        return self.idle.board.hardware.usb_host

    @property
    def name(self) -> str:
        return "USB of the emulated board"

    def client(self) -> Client:
        return Client(self, self.clock)

    def clock(self) -> float:
        return self.idle.board.cycle / TIME_HZ

    def lines(self, state: int) -> Status:
        """Set DTR and RTS; a board that has gone does not hear it."""
        asked = self.host.control(request(TO_INTERFACE, SET_LINES, state), address=self.device.address)
        return finish(self.idle, asked).status

    def write(self, data: bytes) -> None:
        transfer_to(self.host, self.device, DATA_OUT, data)

    def take(self) -> bytes:
        """What has come."""
        came = b""
        if self._asked is not None and self._asked.done:
            came, self._asked = self._asked.received, None
        if self._asked is None and self.reads:
            self._asked = transfer_to(self.host, self.device, DATA_IN, length=4096)
        return came

    def read(self, timeout: float) -> bytes:
        end = self.idle.board.cycle + max(1, round(timeout * TIME_HZ))
        while not (came := self.take()):
            if self.idle.board.cycle >= end:
                return b""
            self.idle.run_to(min(end, self.idle.board.cycle + SLICE))
        return came

    def close(self) -> None:
        self.lines(0)
