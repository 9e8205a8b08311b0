"""Motor commands on their way to the rotors (delay.c): N aircraft, each with a delay of whole samples."""

from __future__ import annotations

import numpy as np

from neuroflight.sim.arrays import Indices
from neuroflight.sim.physics.library import assign, struct


class CommandDelay:
    """The last commands of N aircraft with M motors."""

    def __init__(self, count: int, motors: int, delay: int) -> None:
        """delay: of all aircraft [samples], at least 1; `vary` sets each its own."""
        self._commands = np.zeros((delay + 1, count, motors))  # by sample modulo length
        self._delays = np.full(count, delay, np.int64)
        self.state = struct(
            "delay", motors=motors, slots=delay + 1, commands=self._commands, delays=self._delays
        )

    def vary(self, delays: Indices) -> None:
        """Set each aircraft's delay from now on, (N,) [samples] >= 1; commands under way still arrive."""
        self._delays[:] = delays
        old, last = self._commands, int(self.state.sample) - 1
        if (longest := int(delays.max())) < len(old):
            return
        self._commands = np.zeros((longest + 1, *old.shape[1:]))
        ages = last - np.arange(len(old))
        self._commands[ages % len(self._commands)] = old[ages % len(old)]
        assign(self.state, commands=self._commands, slots=longest + 1)

    def reset(self, index: Indices) -> None:
        """Set the commands of the aircraft of `index` to zero."""
        self._commands[:, index] = 0.0
