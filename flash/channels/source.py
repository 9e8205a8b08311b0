"""Where channels come from: a script, a gamepad, a scenario. Each tells them for a moment of its time."""

from __future__ import annotations

from enum import Enum
from typing import Protocol

from neuroflight.flash.channels.layout import Channels
from neuroflight.toolchain.errors import LinkError


class Instead(Enum):
    """What a source tells instead of channels."""

    SILENCE = "nothing is sent, as by a transmitter that is switched off"
    END = "it has told all"


class SourceLostError(LinkError):
    """A source that was there and is gone, such as a gamepad that was unplugged."""


class Source(Protocol):
    """Channels over time."""

    def at(self, elapsed_s: float) -> Channels | Instead:
        """What the sticks do so long after the begin. Raises SourceLostError; never what was true before."""
