"""Enumeration: what a host asks a device that has come, and what it learns (USB 2.0, 9.1.2 and 9.6).

Written as a generator of transfers to wait for, so that whoever runs the board's time decides how:

    description = complete(host, enumerate_device(host), run_to)
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import TypeVar

from neuroflight.sim.board.usb.host import FRAME, IN, Host, Kind, Status, Transfer
from neuroflight.toolchain.errors import LinkError

T = TypeVar("T")
Steps = Generator[Transfer, None, T]

DEVICE, CONFIGURATION, STRING, INTERFACE, ENDPOINT = 1, 2, 3, 4, 5  # types of descriptors (USB 2.0, 9.6)
CONFIGURATION_MAX = 4096  # bytes that are read of a configuration
_RECOVERY = 2 * FRAME  # within which a device takes its address (USB 2.0, 9.2.6.3)
_SET_ADDRESS, _GET_DESCRIPTOR, _SET_CONFIGURATION = 5, 6, 9


@dataclass(frozen=True)
class EndpointDescriptor:
    """One endpoint of a configuration."""

    address: int  # with IN, 0x80, where it goes to the host
    kind: int  # 0 control, 1 isochronous, 2 bulk, 3 interrupt
    packet_size: int  # bytes
    interval: int  # frames


@dataclass(frozen=True)
class Description:
    """A device at its address, configured, as its descriptors tell it."""

    address: int
    device: bytes  # 18 bytes
    configuration: bytes  # with all interfaces and endpoints

    @property
    def vendor(self) -> int:
        return int.from_bytes(self.device[8:10], "little")

    @property
    def product(self) -> int:
        return int.from_bytes(self.device[10:12], "little")

    @property
    def release(self) -> int:
        """Its bcdDevice."""
        return int.from_bytes(self.device[12:14], "little")

    @property
    def packet_size(self) -> int:
        """Largest packet of endpoint 0 [bytes]."""
        return self.device[7]

    @property
    def interfaces(self) -> tuple[tuple[int, int, int], ...]:
        """Class, subclass and protocol of each interface, in its first setting."""
        found = [d for d in descriptors(self.configuration) if d[1] == INTERFACE and len(d) >= 9]
        return tuple((d[5], d[6], d[7]) for d in found if d[3] == 0)

    @property
    def endpoints(self) -> dict[int, EndpointDescriptor]:
        """Endpoints by address."""
        found = [d for d in descriptors(self.configuration) if d[1] == ENDPOINT and len(d) >= 7]
        return {
            d[2]: EndpointDescriptor(d[2], d[3] & 3, int.from_bytes(d[4:6], "little") & 0x7FF, max(d[6], 1))
            for d in found
        }


def descriptors(configuration: bytes) -> list[bytes]:
    """Return the descriptors in a configuration, as far as their lengths make sense."""
    found, at = [], 0
    while at + 2 <= len(configuration) and configuration[at] >= 2:
        found.append(configuration[at : at + configuration[at]])
        at += configuration[at]
    return found


def request(kind: int, number: int, value: int = 0, index: int = 0, length: int = 0) -> bytes:
    """Return the 8 bytes of a request (USB 2.0, 9.3)."""
    return bytes([kind, number]) + b"".join(n.to_bytes(2, "little") for n in (value, index, length))


def enumerate_device(host: Host, address: int = 1) -> Steps[Description]:
    """Give the device that was reset `address`, read its descriptors and choose its first configuration.

    Raises LinkError for a device that does not answer as it must.
    """
    head = yield from _read(host, 0, 8, request(IN, _GET_DESCRIPTOR, DEVICE << 8, 0, 8), 8)
    size = head[7]
    if size not in (8, 16, 32, 64):
        raise LinkError(f"USB device: packets of {size} bytes at endpoint 0, expected 8, 16, 32 or 64")
    yield from _ask(host, 0, size, request(0, _SET_ADDRESS, address))
    later = host.engine.cycle + _RECOVERY
    asked = request(IN, _GET_DESCRIPTOR, DEVICE << 8, 0, 18)
    device = yield from _read(host, address, size, asked, 18, not_before=later)
    asked = request(IN, _GET_DESCRIPTOR, CONFIGURATION << 8, 0, 9)
    head = yield from _read(host, address, size, asked, 9)
    length = int.from_bytes(head[2:4], "little")
    if not 9 <= length <= CONFIGURATION_MAX:
        raise LinkError(f"USB device: a configuration of {length} bytes, expected 9 to {CONFIGURATION_MAX}")
    asked = request(IN, _GET_DESCRIPTOR, CONFIGURATION << 8, 0, length)
    configuration = yield from _read(host, address, size, asked, length)
    yield from _ask(host, address, size, request(0, _SET_CONFIGURATION, configuration[5]))
    return Description(address, device, configuration)


def _read(
    host: Host, address: int, size: int, asked: bytes, length: int, *, not_before: int = 0
) -> Steps[bytes]:
    transfer = yield from _ask(host, address, size, asked, not_before=not_before)
    if len(transfer.received) != length:
        raise LinkError(
            f"USB device: {len(transfer.received)} bytes to request {asked.hex()}, expected {length}"
        )
    return transfer.received


def _ask(host: Host, address: int, size: int, asked: bytes, *, not_before: int = 0) -> Steps[Transfer]:
    transfer = host.control(asked, address=address, packet_size=size, not_before=not_before)
    yield transfer
    if transfer.status is not Status.DONE:
        raise LinkError(f"USB device: request {asked.hex()} {transfer.status.value}, expected an answer")
    return transfer


def complete(host: Host, steps: Steps[T], run_to: Callable[[int], None], seconds: float = 2.0) -> T:
    """Take all steps, running the board in between. Raises LinkError if they take longer than `seconds`."""
    end = host.engine.cycle + round(seconds * 1000) * FRAME
    try:
        while True:
            step = next(steps)
            while not step.done:
                if host.engine.cycle >= end:
                    raise LinkError(f"USB device: not ready after {seconds:g} s, expected it to answer")
                run_to(host.engine.cycle + FRAME // 10)
    except StopIteration as stop:
        value: T = stop.value
        return value


def transfer_to(
    host: Host, description: Description, endpoint: int, data: bytes = b"", length: int = 0
) -> Transfer:
    """Begin a bulk or interrupt transfer with `endpoint` of a configured device: `data`, or `length` bytes.

    Raises LinkError where the device has no such endpoint.
    """
    found = description.endpoints.get(endpoint)
    if found is None or found.kind not in (Kind.BULK.value, Kind.INTERRUPT.value):
        raise LinkError(f"USB device: no bulk or interrupt endpoint 0x{endpoint:02X}")
    return host.submit(
        Transfer(
            description.address,
            endpoint & 15,
            Kind(found.kind),
            bool(endpoint & IN),
            data,
            length,
            packet_size=found.packet_size,
            interval=found.interval,
        )
    )
