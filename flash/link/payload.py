"""Reading of a reply's fields one after the other."""

from __future__ import annotations

import struct
from enum import IntEnum
from typing import Any, TypeVar

from neuroflight.toolchain.contract import Msp
from neuroflight.toolchain.errors import LinkError

Kind = TypeVar("Kind", bound=IntEnum)


def one_of(kind: type[Kind], value: int, command: Msp) -> Kind:
    """Return `value` as a member of `kind`. Raises LinkError: a reply to `command` names none."""
    try:
        return kind(value)
    except ValueError:
        raise LinkError(
            f"MSP {command.name} reply names {kind.__name__} {value}, expected "
            f"{', '.join(str(int(member)) for member in kind)}; "
            "the firmware is newer: bring it and this tool to the same version"
        ) from None


class Reader:
    """A reader of fields from the front of a payload; raises LinkError if the payload ends too early."""

    def __init__(self, command: Msp, payload: bytes) -> None:
        self.command = command
        self.payload = payload
        self.at = 0

    def bytes(self, count: int) -> bytes:
        """Read the next `count` bytes."""
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
        """Raise LinkError unless the values read are plausible."""
        if not holds:
            raise LinkError(
                f"MSP {self.command.name} reply tells of {got}, expected {expected}; "
                "the firmware is newer: bring it and this tool to the same version"
            )

    def one_of(self, kind: type[Kind]) -> Kind:
        """Read the next byte as a member of `kind`."""
        (value,) = self.fields("B")
        return one_of(kind, value, self.command)

    def fields(self, layout: str) -> tuple[Any, ...]:
        """Read the next fields, of the struct format `layout` without its byte order."""
        form = struct.Struct("<" + layout)
        return form.unpack(self.bytes(form.size))

    def text(self, count: int) -> str:
        """Read the next `count` bytes as text; anything but printable ASCII becomes `?`."""
        characters = self.bytes(count).rstrip(b"\0").decode("latin-1")
        return "".join(c if " " <= c <= "~" else "?" for c in characters)

    def counted_text(self) -> str:
        """Read a text that follows its length, one byte."""
        (count,) = self.fields("B")
        return self.text(count)

    def shorts(self) -> tuple[int, ...]:
        """Read all the rest as u16."""
        rest = len(self.payload) - self.at
        return self.fields(f"{(rest + 1) // 2}H")  # an odd byte lacks its other half: refused
