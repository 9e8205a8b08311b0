"""Motor commands on their way to the rotors: N aircraft, each with a delay of whole samples."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class CommandDelay:
    """The last commands of N aircraft with M motors; one call of `step` is one sample."""

    def __init__(self, count: int, motors: int, delay: int) -> None:
        """delay: of all aircraft [samples], at least 1; `vary` gives each its own."""
        self._commands = np.zeros((delay + 1, count, motors))  # by sample modulo length
        self._sample = 0
        self._checked = b""  # the last commands that were found in range
        self._delays: NDArray[np.intp] | None = None  # (N,) [samples]; None: all have the oldest slot's
        self._everyone = np.arange(count)

    def vary(self, delays: NDArray[np.intp]) -> None:
        """Delay of each aircraft from now on, (N,) [samples], at least 1; commands under way still arrive."""
        self._delays = delays
        old, last = self._commands, self._sample - 1
        if (longest := int(delays.max())) < len(old):
            return
        self._commands = np.zeros((longest + 1, *old.shape[1:]))
        ages = last - np.arange(len(old))
        self._commands[ages % len(self._commands)] = old[ages % len(old)]

    def reset(self, index: NDArray[np.intp]) -> None:
        """Commands of the aircraft of `index` to zero."""
        self._commands[:, index] = 0.0

    def step(self, motors: NDArray[np.floating]) -> Array:
        """Take the commands (N, M) computed from this sample; return those that act from it to the next.

        Raises ValueError on a wrong shape or a command that is not in 0..1 (NaN included).
        """
        commands = self._commands
        if motors.shape != commands.shape[1:]:
            raise ValueError(f"motor commands have shape {motors.shape}, expected {commands.shape[1:]}")
        values = motors.tobytes()
        if values != self._checked:  # often the same for several samples
            if not (motors.min() >= 0.0 and motors.max() <= 1.0):
                raise ValueError(f"motor commands are {motors.min()}..{motors.max()}, expected 0..1")
            self._checked = values
        slots = len(commands)
        commands[self._sample % slots] = motors
        self._sample += 1
        acting: Array
        if self._delays is None:
            acting = commands[self._sample % slots]
        else:
            acting = commands[(self._sample - 1 - self._delays) % slots, self._everyone]
        return acting
