"""A USB controller and the host at its other end, a call at a time: what the firmware's src/usb is tested by.

The controller keeps the rules of port/usb_controller.h and fails where the device breaks one.
"""

from __future__ import annotations

import struct
from enum import Enum
from typing import Any

from tests.firmware.conftest import Core

IN, PACKET, FIFO = 0x80, 64, 512  # FIFO: bytes that one call of `send` takes
STANDARD, CLASS = 0x00, 0x20
DEVICE, INTERFACE, ENDPOINT = 0, 1, 2
GET_STATUS, CLEAR_FEATURE, SET_FEATURE, SET_ADDRESS, GET_DESCRIPTOR = 0, 1, 3, 5, 6
GET_CONFIGURATION, SET_CONFIGURATION, GET_INTERFACE, SET_INTERFACE = 8, 9, 10, 11


class Answer(Enum):
    """How a device answers that takes or gives no data."""

    NAK = "NAK"
    STALL = "STALL"


class ScriptedBus:
    """`controller` for a device whose `events` are set once it is there."""

    def __init__(self, core: Core) -> None:
        self.core = core
        self.events: Any = None
        self.address = self.next_address = 0
        self.opened: dict[int, tuple[int, int]] = {}  # endpoint -> kind, bytes of a packet
        self.stalled: set[int] = set()
        self.sending: dict[int, list[bytes]] = {}  # packets that the device has for the host
        self.hearing: dict[int, int] = {}  # packets that the host may send
        self.toggled: list[int] = []  # endpoints that began with DATA0
        ffi = core.ffi
        self._kept = [
            ffi.callback("void(void *, unsigned)", self._address),
            ffi.callback("void(void *, unsigned, uint8_t, size_t)", self._open),
            ffi.callback("void(void *)", self._close),
            ffi.callback("size_t(void *, unsigned, const uint8_t *, size_t)", self._send),
            ffi.callback("void(void *, unsigned)", self._drop),
            ffi.callback("void(void *, unsigned, unsigned)", self._receive),
            ffi.callback("void(void *, unsigned, bool)", self._stall),
        ]
        self.controller = ffi.new("struct usb_controller *", (ffi.NULL, *self._kept))
        self._broken: list[str] = []  # rules; a callback cannot raise

    # --- what the device calls -----------------------------------------------------------------------
    def _mind(self, kept: bool, rule: str) -> None:
        if not kept:
            self._broken.append(rule)

    def _address(self, context: object, address: int) -> None:
        self.next_address = address

    def _open(self, context: object, endpoint: int, kind: int, packet: int) -> None:
        self._mind(endpoint & 0x7F != 0 and endpoint not in self.opened, f"open of {endpoint:#x}")
        self.opened[endpoint] = (kind, packet)
        self.toggled.append(endpoint)

    def _close(self, context: object) -> None:
        self.opened.clear()
        for endpoint in {*self.sending, *self.hearing} - {0, IN}:
            self.sending.pop(endpoint, None)
            self.hearing.pop(endpoint, None)
        self.stalled &= {0}

    def _packet(self, endpoint: int) -> int:
        return PACKET if endpoint & 0x7F == 0 else self.opened[endpoint][1]

    def _send(self, context: object, endpoint: int, data: Any, count: int) -> int:
        known = endpoint == IN or endpoint in self.opened
        self._mind(known and endpoint & IN != 0, f"send by {endpoint:#x}, which is not open")
        self._mind(endpoint not in self.sending, f"send by {endpoint:#x}, which sends")
        self._mind(endpoint != IN or count <= PACKET, "more than a packet on the control pipe")
        if not known:
            return 0
        part, size = min(count, FIFO), self._packet(endpoint)
        taken = bytes(self.core.ffi.buffer(data, part)) if part else b""
        self.sending[endpoint] = [taken[at : at + size] for at in range(0, part, size)] or [b""]
        return part

    def _drop(self, context: object, endpoint: int) -> None:
        self.sending.pop(endpoint, None)

    def _receive(self, context: object, endpoint: int, packets: int) -> None:
        self._mind(endpoint == 0 or endpoint in self.opened, f"receive by {endpoint:#x}, which is not open")
        if endpoint == 0 or not self.hearing.get(endpoint):
            self.hearing[endpoint] = packets

    def _stall(self, context: object, endpoint: int, stalls: bool) -> None:
        if stalls:
            self.stalled.add(endpoint)
        else:
            self.stalled.discard(endpoint)
            self.toggled.append(endpoint)

    # --- what the host does ----------------------------------------------------------------------------
    def _judge(self) -> None:
        assert self._broken == []

    def reset(self) -> None:
        """A reset of the bus."""
        self.address = self.next_address = 0
        self.stalled.clear()
        self.sending.clear()
        self.hearing.clear()
        self.events.reset(self.events.context)
        self._judge()
        assert not self.opened

    def suspend(self, paused: bool = True) -> None:
        self.events.suspend(self.events.context, paused)
        self._judge()

    def setup(self, kind: int, request: int, value: int = 0, index: int = 0, length: int = 0) -> None:
        """The first stage of a request; nothing of one before it goes on."""
        self.stalled.discard(0)
        self.events.setup(self.events.context, struct.pack("<BBHHH", kind, request, value, index, length))
        self._judge()

    def give(self, endpoint: int, packet: bytes = b"") -> Answer | None:
        """A packet to the device; None: it took it."""
        if endpoint in self.stalled:
            return Answer.STALL
        if not self.hearing.get(endpoint):
            return Answer.NAK
        self.hearing[endpoint] -= 1
        size = self._packet(endpoint)
        over = self.hearing[endpoint] == 0 or len(packet) < size
        if over:
            self.hearing.pop(endpoint)
        self.events.received(self.events.context, endpoint, packet, len(packet))
        if over:
            self.events.ended(self.events.context, endpoint)
        self._judge()
        return None

    def take(self, endpoint: int) -> bytes | Answer:
        """A packet of the device."""
        endpoint |= IN
        if (0 if endpoint == IN else endpoint) in self.stalled:
            return Answer.STALL
        if endpoint not in self.sending:
            return Answer.NAK
        packet = self.sending[endpoint].pop(0)
        if not self.sending[endpoint]:
            del self.sending[endpoint]
            if endpoint == IN:
                self.address = self.next_address
            self.events.ended(self.events.context, endpoint)
        self._judge()
        return packet

    def ask(self, kind: int, request: int, value: int = 0, index: int = 0, length: int = 0) -> bytes | Answer:
        """A request of `length` bytes from the device, or without data; all of its stages."""
        self.setup(kind, request, value, index, length)
        data = b""
        while length and len(data) < length:
            packet = self.take(0)
            if isinstance(packet, Answer):
                return packet
            data += packet
            if len(packet) < PACKET:
                break
        done = self.give(0) if length else self.take(0)
        return data if done in (None, b"") else done

    def tell(self, kind: int, request: int, value: int, index: int, data: bytes) -> Answer | None:
        """A request that brings `data`; None: it was carried out."""
        self.setup(kind, request, value, index, len(data))
        for at in range(0, len(data), PACKET):
            answer = self.give(0, data[at : at + PACKET])
            if answer is not None:
                return answer
        done = self.take(0)
        return None if done == b"" else Answer(done)

    def read(self, endpoint: int, most: int = 1 << 20) -> bytes:
        """What an endpoint has for the host now, up to a short packet."""
        data = b""
        while len(data) < most and isinstance(packet := self.take(endpoint), bytes):
            data += packet
            if len(packet) < PACKET:
                break
        return data

    def enumerate(self, address: int = 5) -> None:
        """Address and configuration, as every host begins."""
        self.reset()
        assert self.ask(STANDARD, SET_ADDRESS, address) == b"" and self.address == address
        assert self.ask(STANDARD, SET_CONFIGURATION, 1) == b""
