"""Control requests to a USB device, behind a small interface: what a client of the ROM's DFU device needs."""

from __future__ import annotations

from typing import Protocol

from neuroflight.toolchain.errors import LinkError


class StalledError(LinkError):
    """The device refused a request."""


class ControlLine(Protocol):
    """A claimed interface of a USB device, for requests of its class.

    Methods raise StalledError, and LinkError once the device is gone.
    """

    @property
    def name(self) -> str:
        """The device as the user would write it."""

    @property
    def alternates(self) -> tuple[str, ...]:
        """The interface's name in each of its alternate settings."""

    def read(self, request: int, value: int, size: int, timeout: float) -> bytes:
        """Read at most `size` bytes; timeout [s]."""

    def write(self, request: int, value: int, data: bytes, timeout: float) -> None:
        """Send a request with `data`; timeout [s]."""

    def close(self) -> None:
        """Give the device back; may be called twice."""
