"""A host on the cable of a chip in its ROM, in lockstep: control transfers, one behind the other."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from neuroflight.sim.board.board import Board
from neuroflight.sim.board.core.context import TIME_HZ
from neuroflight.sim.board.usb.cable import Answer, Handshake

PAUSE = TIME_HZ // 20_000  # between two tokens
LIMIT_S = 20.0  # of NAK: erasing the whole chip takes 8 s


class StalledError(Exception):
    """The device refused the request."""


@dataclass
class UsbHost:
    """The one host; `address` is the device's."""

    board: Board
    address: int = 0
    naks: int = 0

    @property
    def now(self) -> float:
        """Seconds on the board."""
        return self.board.cycle / TIME_HZ

    def plug(self) -> None:
        """Plug the cable in; enumerate as any system does once the device is there."""
        device = self.board.hardware.rom.dfu
        device.vbus(True)
        self.board.run(0 if device.attached else 0.06)
        assert device.attached
        device.bus_reset()
        self.address = 0
        self.control(0x00, 5, 9)
        self.address = 9
        self.control(0x00, 9, 1)

    def control(
        self, kind: int, number: int, value: int = 0, index: int = 0, length: int = 0, data: bytes = b""
    ) -> bytes:
        """Make a transfer; what it reads. Raises StalledError."""
        device, pipe = self.board.hardware.rom.dfu, (self.address, 0)
        setup = struct.pack("<BBHHH", kind, number, value, index, length or len(data))
        assert device.setup(*pipe, setup) is Handshake.ACK
        toggle = 1
        for at in range(0, len(data), 64):
            packet = data[at : at + 64]
            self._until(partial(device.out, *pipe, toggle, packet))
            toggle ^= 1
        got, toggle = b"", 1
        while kind & 0x80 and len(got) < length:
            answer = self._until(lambda: device.take(*pipe))
            assert isinstance(answer, tuple) and answer[0] == toggle
            got, toggle = got + answer[1], toggle ^ 1
            if len(answer[1]) < 64:
                break
        if kind & 0x80 and length:
            assert device.out(*pipe, 1, b"") is Handshake.ACK
        else:
            assert self._until(lambda: device.take(*pipe)) == (1, b"")
        return got

    def status(self) -> tuple[int, int, int]:
        """Status, wait [ms] and state by GETSTATUS."""
        got = self.control(0xA1, 3, length=6)
        assert len(got) == 6 and got[5] == 0
        return got[0], int.from_bytes(got[1:4], "little"), got[4]

    def download(self, block: int, data: bytes) -> tuple[int, int, int]:
        """Give an order and wait for its end as told: its status, the wait told, its state."""
        self.control(0x21, 1, block, data=data)
        status, wait, state = self.status()
        assert (status, state) == (0, 4)
        self.board.run(wait / 1000)
        status, _, state = self.status()
        return status, wait, state

    def _until(self, ask: Callable[[], Answer]) -> Answer:
        """Ask until it is not NAK."""
        end = self.board.cycle + round(LIMIT_S * TIME_HZ)
        while (answer := ask()) is Handshake.NAK:
            assert self.board.cycle < end
            self.naks += 1
            self.board.run_to(self.board.cycle + PAUSE)
        if answer is Handshake.STALL:
            raise StalledError
        return answer
