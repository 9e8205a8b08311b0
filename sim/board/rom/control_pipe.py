"""Endpoint 0 of a USB device: control transfers of USB 2.0 chapters 5.5 and 8.5.3, stage by stage.

What a request means is its owner's. `answer` gives the data of one that reads, `accept` takes one that
writes, when all its data is there; either may say NAK, "ask again", as long as it is not ready, or STALL.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import NamedTuple

from neuroflight.sim.board.core.context import Kept
from neuroflight.sim.board.usb.cable import CONTROL_MAX, Answer, Handshake

SETUP_BYTES = 8
_IN = 0x80  # of a request's type: the device sends
SET_ADDRESS = (0x00, 5)  # type and number of the request that takes effect behind its status stage


class Setup(NamedTuple):
    """A request (USB 2.0, table 9-2)."""

    kind: int  # bmRequestType
    number: int  # bRequest
    value: int
    part: int  # wIndex: interface or endpoint
    length: int  # of the data that follow

    @property
    def reads(self) -> bool:
        """True if the device sends data."""
        return bool(self.kind & _IN and self.length)


class ControlPipe(Kept):
    """The stages of a control transfer, and the device's address."""

    kept = ("address", "_setup", "_sent", "_received", "_toggle", "_halted")

    def __init__(
        self,
        answer: Callable[[Setup], bytes | Handshake],
        accept: Callable[[Setup, bytes], Handshake],
        done: Callable[[Setup], None],
    ) -> None:
        """done: gets a request whose status stage is over."""
        self._answer, self._accept, self._done = answer, accept, done
        self.reset()

    def reset(self) -> None:
        """Take a reset of the bus."""
        self.address = 0
        self._setup: Setup | None = None
        self._sent: bytes | None = None  # what is left to send; None: not asked for yet
        self._received = b""
        self._toggle = 1  # of the next data packet
        self._halted = False

    def setup(self, address: int, endpoint: int, data: bytes) -> Handshake:
        """See cable.Device. A request ends the one before, wherever that was."""
        if address != self.address or endpoint or len(data) != SETUP_BYTES:
            return Handshake.SILENT
        self._setup = Setup(*struct.unpack("<BBHHH", data))
        self._sent, self._received, self._toggle, self._halted = None, b"", 1, False
        return Handshake.ACK

    def out(self, address: int, endpoint: int, toggle: int, data: bytes) -> Handshake:
        """See cable.Device."""
        setup = self._setup
        if address != self.address or endpoint:
            return Handshake.SILENT
        if setup is None or self._halted:
            return Handshake.STALL
        if setup.reads:  # its status stage
            if data:
                return self._halt()
            self._end(setup)
            return Handshake.ACK
        if toggle != self._toggle:  # the packet of before, whose ACK the host did not get
            return Handshake.ACK
        if len(data) > CONTROL_MAX or len(self._received) + len(data) > setup.length:
            return self._halt()
        self._received += data
        self._toggle ^= 1
        return Handshake.ACK

    def take(self, address: int, endpoint: int) -> Answer:
        """See cable.Device."""
        setup = self._setup
        if address != self.address or endpoint:
            return Handshake.SILENT
        if setup is None or self._halted:
            return Handshake.STALL
        return self._send(setup) if setup.reads else self._confirm(setup)

    def _send(self, setup: Setup) -> Answer:
        if self._sent is None:
            answer = self._answer(setup)
            if isinstance(answer, Handshake):
                return self._halt() if answer is Handshake.STALL else answer
            self._sent = answer[: setup.length]
        packet, self._sent = self._sent[:CONTROL_MAX], self._sent[CONTROL_MAX:]
        toggle, self._toggle = self._toggle, self._toggle ^ 1
        return toggle, packet

    def _confirm(self, setup: Setup) -> Answer:
        """Answer the status stage of a request that writes."""
        length = 0 if setup.kind & _IN else setup.length
        if len(self._received) != length:
            return self._halt()
        answer = self._accept(setup, self._received)
        if answer is Handshake.STALL:
            return self._halt()
        if answer is not Handshake.ACK:
            return answer
        self._end(setup)
        return 1, b""

    def _end(self, setup: Setup) -> None:
        self._setup = None
        if (setup.kind, setup.number) == SET_ADDRESS:
            self.address = setup.value & 0x7F
        self._done(setup)

    def _halt(self) -> Handshake:
        """Refuse until the next request."""
        self._halted = True
        return Handshake.STALL
