"""The policy network in numpy."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from neuroflight.training.learners.network.shape import Shape

Floats = NDArray[np.float32]


class Network:
    """A network; a GRU or an LSTM in it is torch's."""

    def __init__(self, shape: Shape, parameters: Floats) -> None:
        self._shape, self._parts = shape, shape.split(parameters)
        self._cell = None if shape.recurrent == "none" else _cell(shape, self._parts)
        self._state: Any = None

    def __call__(self, value: Floats) -> Floats:
        """Motor fractions before the clip, (N, M), of scaled observations (N, n)."""
        parts = self._parts
        if self._cell is not None:
            value, parts = self._remember(self._cell, value), parts[4:]
        *hidden, (weight, bias) = zip(parts[::2], parts[1::2], strict=True)
        for own, offset in hidden:
            value = value @ own.T + offset
            value = np.tanh(value) if self._shape.activation == "tanh" else np.maximum(value, 0.0)
        value = value @ weight.T + bias
        if self._shape.output.squash:
            value = np.tanh(value)
        return self._shape.output.unclipped(value)

    def _remember(self, cell: torch.nn.RNNCellBase, value: Floats) -> Floats:
        with torch.inference_mode():
            self._state = cell(torch.from_numpy(np.asarray(value, np.float32)), self._state)
        after = self._state[0] if isinstance(self._state, tuple) else self._state
        return np.asarray(after.numpy(), np.float32)


def _cell(shape: Shape, parts: Sequence[Floats]) -> torch.nn.RNNCellBase:
    """torch's own cell with the first four parts of a network's parameters."""
    inputs, units, *_ = shape.widths
    made: torch.nn.RNNCellBase
    made = {"gru": torch.nn.GRUCell, "lstm": torch.nn.LSTMCell}[shape.recurrent](inputs, units)
    names = ("weight_ih", "bias_ih", "weight_hh", "bias_hh")
    made.load_state_dict({name: torch.from_numpy(part) for name, part in zip(names, parts, strict=False)})
    return made
