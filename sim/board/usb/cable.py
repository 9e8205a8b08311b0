"""The USB cable: what a full-speed host and a device tell each other, a transaction at a time.

A host (`host.py`) calls a `Device`; a device never calls the host. Each call is one packet exchange of
USB 2.0 chapter 8, whole and free of bit errors: token, data and handshake. What a device does of its own
accord, to come (`attached`) or to ask for a resume (`wakes`), it holds as a level, as its pull-up does, and
the host looks. Time is the board's, in cycles of 216 MHz; it runs between two calls, never inside one.
Isochronous transfers and split transactions are not modelled.
"""

from __future__ import annotations

from enum import Enum
from typing import Protocol

from neuroflight.sim.board.core.context import Kept

CONTROL_MAX = 64  # bytes in a packet of a control, bulk or interrupt endpoint at full speed (USB 2.0, 5.5.3)


class Handshake(Enum):
    """Answer of a device to a token."""

    ACK = "acknowledged"
    NAK = "not ready: ask again"
    STALL = "halted, or a request that it does not know"
    SILENT = "no answer: another address, an endpoint that is off, a device that has gone"


Answer = Handshake | tuple[int, bytes]
"""Answer to an IN token: NAK, STALL, SILENT, or 0 or 1 for DATA0 or DATA1 with its bytes, which the host
acknowledges."""


class Device(Protocol):
    """A full-speed device at the end of the cable.

    The host decides nothing about data toggles for the device: it sends its own and looks at the device's.
    A device that gets a data packet with the toggle of the one before acknowledges it and drops its bytes
    (USB 2.0, 8.6.4).
    """

    @property
    def attached(self) -> bool:
        """True while its pull-up holds D+ high: it has seen VBUS and wants to be found."""

    @property
    def wakes(self) -> bool:
        """True while it drives resume signalling (remote wake-up); False always, if it never does."""

    def vbus(self, present: bool) -> None:
        """Plug the cable in, with 5 V on VBUS, or pull it."""

    def bus_reset(self) -> None:
        """Take the begin of a reset, which ends before the next frame: address 0, not configured."""

    def suspend(self) -> None:
        """Note 3 ms without any packet."""

    def resume(self) -> None:
        """Note resume signalling by the host; frames begin again 20 ms later."""

    def start_of_frame(self, number: int) -> None:
        """Take the packet that begins each millisecond; number: 0 to 2047."""

    def setup(self, address: int, endpoint: int, data: bytes) -> Handshake:
        """Take the 8 bytes of a request: ACK or SILENT, never NAK or STALL (USB 2.0, 8.5.3)."""

    def out(self, address: int, endpoint: int, toggle: int, data: bytes) -> Handshake:
        """Take a data packet of 0 to 64 bytes."""

    def take(self, address: int, endpoint: int) -> Answer:
        """Answer an IN token."""


class Connector(Kept):
    """The board's connector: of the devices that may answer behind it, the one that holds D+ high.

    Where another one takes over, the host sees nobody for one look at `attached`.
    """

    kept = ("_number",)

    def __init__(self, *devices: Device) -> None:
        """devices: at most one of them is attached at a time."""
        self.devices = list(devices)
        self._number: int | None = None  # of the device that was attached at the last look

    @property
    def _device(self) -> Device | None:
        device = None if self._number is None else self.devices[self._number]
        return device if device is not None and device.attached else None

    @property
    def attached(self) -> bool:
        """See Device."""
        before = self._number
        self._number = next((i for i, device in enumerate(self.devices) if device.attached), None)
        return self._number is not None and self._number == before

    @property
    def wakes(self) -> bool:
        """See Device."""
        return any(device.wakes for device in self.devices)

    def vbus(self, present: bool) -> None:
        """See Device."""
        for device in self.devices:
            device.vbus(present)

    def bus_reset(self) -> None:
        """See Device."""
        for device in self.devices:
            device.bus_reset()

    def suspend(self) -> None:
        """See Device."""
        for device in self.devices:
            device.suspend()

    def resume(self) -> None:
        """See Device."""
        for device in self.devices:
            device.resume()

    def start_of_frame(self, number: int) -> None:
        """See Device."""
        if (device := self._device) is not None:
            device.start_of_frame(number)

    def setup(self, address: int, endpoint: int, data: bytes) -> Handshake:
        """See Device."""
        device = self._device
        return Handshake.SILENT if device is None else device.setup(address, endpoint, data)

    def out(self, address: int, endpoint: int, toggle: int, data: bytes) -> Handshake:
        """See Device."""
        device = self._device
        return Handshake.SILENT if device is None else device.out(address, endpoint, toggle, data)

    def take(self, address: int, endpoint: int) -> Answer:
        """See Device."""
        device = self._device
        return Handshake.SILENT if device is None else device.take(address, endpoint)
