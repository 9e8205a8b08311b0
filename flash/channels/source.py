"""A source of channels over time: a script, a gamepad, a scenario."""

from __future__ import annotations

from enum import Enum
from typing import Protocol

from neuroflight.flash.channels.layout import Channels
from neuroflight.toolchain.errors import LinkError


class Instead(Enum):
    """Signals of a source that has no channels to send."""

    SILENCE = "nothing is sent, as by a transmitter that is switched off"
    END = "it has told all"


class SourceLostError(LinkError):
    """A source that was there and is gone, such as a gamepad that was unplugged."""


class Source(Protocol):
    """Channels over time."""

    def at(self, elapsed_s: float) -> Channels | Instead:
        """Return the channels at that time since the start, never older ones. Raises SourceLostError."""
