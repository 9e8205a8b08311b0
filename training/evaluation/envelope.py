"""Flight envelope of a controller: its error, and the share that it holds, by command (Koch 2019, ch. 5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.arrays import Array
from neuroflight.training.evaluation.comparison import Entry

EDGES_DEG_S = (0.0, 200.0, 400.0, 600.0, 800.0, 1000.0, 2000.0)  # of the magnitude of a command


@dataclass(frozen=True, eq=False)
class Envelope:
    """Each of E held commands, and how a controller followed it."""

    commands: Array  # (E, 3) [deg/s]
    mae: Array  # (E,) [deg/s], mean of the axes
    held: NDArray[np.bool_]  # (E,), in the band with the floor at every sample from 500 ms on
    held_bare: NDArray[np.bool_]  # (E,), the same without the floor

    @property
    def magnitude(self) -> Array:
        """Length of each command as a vector (E,) [deg/s]."""
        return np.asarray(np.linalg.norm(self.commands, axis=1))


def envelope(entry: Entry) -> Envelope | None:
    """Return the envelope of an entry; None where its task holds no command for a second."""
    response = entry.scores.response
    if entry.commands is None or response is None:
        return None
    mae = np.asarray(entry.scores.tracking.mae.mean(axis=1))
    return Envelope(entry.commands, mae, response.steady, response.steady_bare)


def by_magnitude(found: Envelope) -> tuple[NDArray[np.intp], Array, Array]:
    """Return commands, mean error [deg/s] and share held in each interval of EDGES_DEG_S; NaN for none.

    Each is (B,).
    """
    interval = np.clip(np.digitize(found.magnitude, EDGES_DEG_S) - 1, 0, len(EDGES_DEG_S) - 2)
    count = np.bincount(interval, minlength=len(EDGES_DEG_S) - 1)
    number = np.where(count > 0, count, np.nan)
    error, held = (np.bincount(interval, each, len(count)) / number for each in (found.mae, found.held))
    return count, error, held
