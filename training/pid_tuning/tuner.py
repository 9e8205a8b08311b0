"""Search methods: CMA-ES, or a tuner of a user's own file, FILE.py:CLASS, with the same ask and tell."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np

from neuroflight.sim.arrays import Array
from neuroflight.toolchain.errors import TrainingError
from neuroflight.training.pid_tuning.trial import Settings, Trial, Tuning
from neuroflight.training.plugins import blaming, users_class

POPULATION = 12  # candidates of a generation; the usual number for 11 settings
CANDIDATES_MAX = 1000  # of an `ask`


class Tuner(Protocol):
    """A search for the point of least cost."""

    def ask(self) -> Array:
        """Return points to try, (n, d)."""
        ...

    def tell(self, candidates: Array, costs: Array) -> None:
        """Learn the costs (n,) of the points of the last `ask`."""
        ...


# Made from the first point (d,), its spread (d,), the usual number of candidates, and random numbers.
MakeTuner = Callable[[Array, Array, int, np.random.Generator], Tuner]


def search(
    tuner: Tuner,
    fly: Callable[[Array], Sequence[Trial[Settings]]],
    first: Trial[Settings],
    budget: int,
    progress: Callable[[int, Trial[Settings]], None],
) -> Tuning[Settings]:
    """Search about `budget` candidates, in whole generations.

    fly: points (n, d) to what was flown; first: what the best must beat; progress: is told the number flown
    so far and the best of them. An interruption (KeyboardInterrupt) ends the search and keeps the best.
    """
    flown: list[Trial[Settings]] = []
    best, interrupted = first, False
    try:
        while not flown or len(flown) + POPULATION / 2 < budget:
            points = tuner.ask()
            generation = fly(points)
            tuner.tell(points, np.array([each.cost for each in generation]))
            flown += generation
            best = min([best, *generation], key=lambda each: each.cost)
            progress(len(flown), best)
    except KeyboardInterrupt:
        interrupted = True
    return Tuning(first, tuple(flown), best, interrupted)


def load_tuner(name: str) -> MakeTuner:
    """Return the tuner of a user's file. Raises TrainingError, one line, on anything wrong."""
    kind, where, _ = users_class(name, ("ask", "tell"))

    def make(start: Array, spread: Array, population: int, rng: np.random.Generator) -> Tuner:
        with blaming(where):
            made = kind(start.copy(), spread.copy(), population, rng)
        return _Checked(where, made, len(start))

    return make


class _Checked:
    """A user's tuner, whose points are checked."""

    def __init__(self, where: str, made: Any, dimensions: int) -> None:  # noqa: ANN401 - of any class
        self._where, self._made, self._dimensions = where, made, dimensions

    def ask(self) -> Array:
        """See Tuner."""
        with blaming(self._where):
            points = np.array(self._made.ask(), np.float64)
        asked = f"1 to {CANDIDATES_MAX} points of {self._dimensions} finite numbers"
        if points.ndim != 2 or points.shape[1] != self._dimensions or not 1 <= len(points) <= CANDIDATES_MAX:
            raise TrainingError(f"{self._where}: ask() returned shape {points.shape}, expected {asked}")
        if not np.isfinite(points).all():
            raise TrainingError(
                f"{self._where}: ask() returned numbers that are not finite, expected {asked}"
            )
        return points

    def tell(self, candidates: Array, costs: Array) -> None:
        """See Tuner."""
        with blaming(self._where):
            self._made.tell(candidates.copy(), costs.copy())
