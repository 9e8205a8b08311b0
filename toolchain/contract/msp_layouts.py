"""Layouts of MSP messages: whose payload has which fields."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from neuroflight.toolchain.contract.msp_fields import Fields, MspField
from neuroflight.toolchain.contract.msp_table import Msp

__all__ = ["Configuration", "Direction", "MspLayout"]


class Direction(Enum):
    """Directions of a message."""

    REQUEST = "request"
    REPLY = "reply"


@dataclass(frozen=True)
class MspLayout:
    """The payload of a message. `required`: so many of its fields must be there, newer versions have the
    rest."""

    message: Msp
    direction: Direction
    fields: Fields = ()
    required: int | None = None  # None: all

    @property
    def needed(self) -> int:
        """Fields that must be there."""
        return len(self.fields) if self.required is None else self.required


@dataclass(frozen=True)
class Configuration:
    """A configuration message with its counterpart that changes it; every field of both is bound."""

    reply: MspLayout
    request: MspLayout | None = None
    read_first: bool = False  # a SET needs that its peer was told: all its zeros mean something


def reply(message: Msp, *fields: MspField) -> MspLayout:
    """Describe the reply of a message."""
    return MspLayout(message, Direction.REPLY, fields)


def request(message: Msp, *fields: MspField, required: int | None = None) -> MspLayout:
    """Describe the request of a message."""
    return MspLayout(message, Direction.REQUEST, fields, required)


def pair(
    get: Msp, set_: Msp, *fields: MspField, required: int = 1, read_first: bool = False
) -> Configuration:
    """Describe a message and the SET that brings the same fields."""
    return Configuration(reply(get, *fields), request(set_, *fields, required=required), read_first)


def read_only(get: Msp, *fields: MspField) -> Configuration:
    """Describe a message that nothing sets."""
    return Configuration(reply(get, *fields))
