"""Reading the fields of a reply's payload one after the other."""

from __future__ import annotations

import struct
from enum import IntEnum
from typing import Any, TypeVar

from neuroflight.toolchain.contract import Msp
from neuroflight.toolchain.errors import LinkError

Kind = TypeVar("Kind", bound=IntEnum)


class Reader:
    """Takes fields off the front of a payload; a payload that ends too early is a LinkError."""

    def __init__(self, command: Msp, payload: bytes) -> None:
        self.command = command
        self.payload = payload
        self.at = 0

    def bytes(self, count: int) -> bytes:
        """The next `count` bytes."""
        end = self.at + count
        if end > len(self.payload):
            raise LinkError(
                f"MSP {self.command.name} reply has {len(self.payload)} bytes, expected at least {end}; "
                "the firmware speaks another layout: bring it and this tool to the same version"
            )
        field = self.payload[self.at : end]
        self.at = end
        return field

    def check(self, holds: bool, got: str, expected: str) -> None:
        """Raise LinkError unless what was read makes sense."""
        if not holds:
            raise LinkError(
                f"MSP {self.command.name} reply tells of {got}, expected {expected}; "
                "the firmware is newer: bring it and this tool to the same version"
            )

    def one_of(self, kind: type[Kind]) -> Kind:
        """The next byte as a member of `kind`."""
        (value,) = self.fields("B")
        try:
            return kind(value)
        except ValueError:
            raise LinkError(
                f"MSP {self.command.name} reply names {kind.__name__} {value}, expected "
                f"{', '.join(str(int(member)) for member in kind)}; "
                "the firmware is newer: bring it and this tool to the same version"
            ) from None

    def fields(self, layout: str) -> tuple[Any, ...]:
        """The next fields, of the struct format `layout` without its byte order."""
        form = struct.Struct("<" + layout)
        return form.unpack(self.bytes(form.size))

    def text(self, count: int) -> str:
        """The next `count` bytes as text; whatever is not printable ASCII shows as `?`."""
        characters = self.bytes(count).rstrip(b"\0").decode("latin-1")
        return "".join(c if " " <= c <= "~" else "?" for c in characters)

    def counted_text(self) -> str:
        """A text behind a byte that gives its length."""
        (count,) = self.fields("B")
        return self.text(count)

    def shorts(self) -> tuple[int, ...]:
        """All the rest as u16."""
        rest = len(self.payload) - self.at
        return self.fields(f"{(rest + 1) // 2}H")  # an odd byte lacks its other half: refused
