"""Motor commands on their way to the rotors: N aircraft, each with a delay of whole samples."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.physics.library import assign, library, pointer, struct

Array = NDArray[np.float64]


class CommandDelay:
    """The last commands of N aircraft with M motors; one call of `step` is one sample."""

    def __init__(self, count: int, motors: int, delay: int) -> None:
        """delay: of all aircraft [samples], at least 1; `vary` sets each its own."""
        self._commands = np.zeros((delay + 1, count, motors))  # by sample modulo length
        self._delays = np.full(count, delay, np.int64)
        self._acting = np.zeros((count, motors))
        self.state = struct(
            "delay", motors=motors, slots=delay + 1, commands=self._commands, delays=self._delays
        )

    def vary(self, delays: NDArray[np.intp]) -> None:
        """Set each aircraft's delay from now on, (N,) [samples] >= 1; commands under way still arrive."""
        self._delays[:] = delays
        old, last = self._commands, int(self.state.sample) - 1
        if (longest := int(delays.max())) < len(old):
            return
        self._commands = np.zeros((longest + 1, *old.shape[1:]))
        ages = last - np.arange(len(old))
        self._commands[ages % len(self._commands)] = old[ages % len(old)]
        assign(self.state, commands=self._commands, slots=longest + 1)

    def reset(self, index: NDArray[np.intp]) -> None:
        """Set the commands of the aircraft of `index` to zero."""
        self._commands[:, index] = 0.0

    def step(self, motors: NDArray[np.floating]) -> Array:
        """Take the commands (N, M) computed from this sample; return those that act from it to the next.

        The array returned is overwritten by the next call. Raises ValueError on a wrong shape or
        a command that is not in 0..1 (NaN included).
        """
        given = np.ascontiguousarray(motors, np.float64)
        self.check_shape(given)
        if not library().lib.delay_step(self.state, len(given), pointer(given), pointer(self._acting)):
            raise bad_command(given)
        return self._acting

    def check_shape(self, motors: NDArray[np.floating]) -> None:
        """Raise ValueError unless commands have the shape (N, M)."""
        if motors.shape != self._acting.shape:
            raise ValueError(f"motor commands have shape {motors.shape}, expected {self._acting.shape}")


def bad_command(motors: NDArray[np.floating]) -> ValueError:
    """Return the error of commands that are not all in 0..1, NaN included."""
    return ValueError(f"motor commands are {motors.min()}..{motors.max()}, expected 0..1")
