"""The policy network in numpy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from training.learners.network.shape import Shape

Floats = NDArray[np.float32]


class Network:
    """A network for `count` samples at a time; it remembers what a GRU remembers."""

    def __init__(self, shape: Shape, parameters: Floats, count: int) -> None:
        self._shape, self._parts = shape, shape.split(parameters)
        self._memory = np.zeros((count, shape.widths[1]), np.float32)

    def __call__(self, value: Floats) -> Floats:
        """Motor fractions before the clip, (count, M), of scaled observations (count, n)."""
        parts = self._parts
        if self._shape.recurrent:
            value, parts = self._remember(value), parts[4:]
        *hidden, (weight, bias) = zip(parts[::2], parts[1::2], strict=True)
        for own, offset in hidden:
            value = value @ own.T + offset
            value = np.tanh(value) if self._shape.activation == "tanh" else np.maximum(value, 0.0)
        value = value @ weight.T + bias
        if self._shape.output.squash:
            value = np.tanh(value)
        return self._shape.output.unclipped(value)

    def _remember(self, value: Floats) -> Floats:
        weight, bias, state_weight, state_bias = self._parts[:4]
        of_input = np.split(value @ weight.T + bias, 3, axis=1)
        of_state = np.split(self._memory @ state_weight.T + state_bias, 3, axis=1)
        reset, update = (1.0 / (1.0 + np.exp(-of_input[i] - of_state[i])) for i in range(2))
        new = np.tanh(of_input[2] + reset * of_state[2])
        self._memory = ((1.0 - update) * new + update * self._memory).astype(np.float32)
        return self._memory
