"""A network without memory, computed in C for observations in rows."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim import compiled
from neuroflight.training.learners.network.library import aligned, pointer
from neuroflight.training.learners.network.normalization import Normalization
from neuroflight.training.learners.network.shape import Shape

Numbers = NDArray[np.floating]

DECAYS = 0.9, 0.999  # Adam's


class Computed:
    """A network of `shape`; number: float32 for training, float64 for tests. All arrays are of it.

    Its output is tanh of the last sum if `squash`, else the sum: the shape's own map of outputs is not used.
    """

    def __init__(self, library: compiled.Library, shape: Shape, number: str, *, squash: bool = False) -> None:
        self._library, self._shape, self._number = library, shape, number
        self.described = described(library, shape, squash=squash)
        self._size = library.lib.network_memory(self.described)

    def acting(
        self, parameters: Numbers, normalization: Normalization, count: int
    ) -> Callable[[Numbers], Numbers]:
        """Return a function from observations (count, n) to outputs (count, M) with these parameters.

        The caller keeps `normalization`. Each call overwrites the last result.
        """
        number, widths = self._number, self._shape.widths
        memory = aligned(self._size, number)
        observations, found = np.empty((count, widths[0]), number), np.empty((count, widths[-1]), number)
        given = observed(self._library, normalization, observations)
        weights, result, space = map(pointer, (parameters, found, memory))
        compute, loaded = self._library.lib.network_outputs, False

        def outputs(rows: Numbers) -> Numbers:
            nonlocal loaded
            observations[:] = rows
            compute(self.described, weights, loaded, count, given, result, space)
            loaded = True
            return found

        return outputs

    def outputs(self, parameters: Numbers, normalization: Normalization, observations: Numbers) -> Numbers:
        """Compute outputs (N, M) for observations (N, n)."""
        return self.acting(parameters, normalization, len(observations))(observations)


def described(library: compiled.Library, shape: Shape, *, squash: bool = False) -> Any:  # noqa: ANN401
    """Return `struct network *`, a struct of cffi."""
    made = library.ffi.new("struct network *")
    made.layers = len(shape.widths) - 1
    for index, width in enumerate(shape.widths):
        made.width[index] = width
    made.activation = getattr(library.lib, f"ACTIVATION_{shape.activation.upper()}")
    made.scale, made.squash = 1.0, squash
    return made


def observed(library: compiled.Library, normalization: Normalization, rows: Numbers) -> Any:  # noqa: ANN401 - a struct of cffi
    """Return `struct observed *` of rows (N, stride), each an observation first; the caller keeps them."""
    made = library.ffi.new("struct observed *")
    made.values, made.stride = pointer(rows), rows.shape[1]
    made.mean, made.factor = pointer(normalization.mean), pointer(normalization.factor)
    return made


def set_adam(adam: Any, means: tuple[Numbers, Numbers], eps: float) -> None:  # noqa: ANN401
    """Fill in a `struct adam` but for its rate and its updates; means: of the gradient and of its square."""
    adam.eps, adam.decay = eps, DECAYS
    adam.first, adam.second = map(pointer, means)
