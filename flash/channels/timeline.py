"""Channels at a fixed rate with silences, such as a scenario's; behind a lead-in at rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from neuroflight.flash.channels.layout import Channels
from neuroflight.flash.channels.source import Instead


@dataclass(frozen=True)
class Timeline:
    """A Source: at rest for a while, then armed with the throttle low, then `rate_hz` rows a second."""

    rest: Channels
    lead_s: float  # of rest, until the board accepts the receiver's link
    armed: Channels  # sticks as in `rest`, the arm switch on
    armed_s: float  # so long, before the first row
    rate_hz: float
    rows: Sequence[Channels | None]  # None: the transmitter is silent

    def at(self, elapsed_s: float) -> Channels | Instead:
        """See Source."""
        if elapsed_s < self.lead_s:
            return self.rest
        if elapsed_s < self.lead_s + self.armed_s:
            return self.armed
        index = int((elapsed_s - self.lead_s - self.armed_s) * self.rate_hz)
        if index >= len(self.rows):
            return Instead.END
        row = self.rows[index]
        return Instead.SILENCE if row is None else row
