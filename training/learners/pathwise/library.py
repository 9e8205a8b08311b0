"""The flights and their derivatives in C (`c/`)."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from neuroflight.sim import compiled
from neuroflight.training.learners.network import library as network
from neuroflight.training.learners.network.library import aligned

__all__ = ["aligned", "library", "pointer"]


def library(number: str = "float32") -> compiled.Library:
    """Load the flights in C; number: float32 for training, float64 for tests. Raises BuildError, one line."""
    return network.load("pathwise", number)


def pointer(array: NDArray[Any] | None) -> Any:  # noqa: ANN401 - a pointer of cffi
    """See `training.learners.network.library.pointer`."""
    return network.pointer(library(), array)
