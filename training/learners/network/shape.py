"""Shape of a network, and its weights as one array; c/network.c computes it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.arrays import Array32
from neuroflight.training.config.training_config import OutputMap

HIDDEN_GAIN = 1.4  # of the initial orthogonal matrices
LAST_GAIN = 0.02  # small: the outputs of an untrained policy hardly depend on the observation
GATES = {"gru": 3, "lstm": 4}  # of a recurrent unit: reset, update and new; input, forget, cell and output


@dataclass(frozen=True)
class Shape:
    """An MLP: hidden layers with `activation`, of which the first may have memory, and one with `output`."""

    widths: tuple[int, ...]  # of observation, hidden layers, motors
    activation: str  # "tanh" or "relu"
    output: OutputMap
    recurrent: str = "none"  # the first hidden layer: "gru" or "lstm", by PyTorch's convention

    @property
    def parts(self) -> tuple[tuple[int, ...], ...]:
        """Shapes of the parameters in their order: weight (outputs, inputs) and bias of each layer.

        A layer with memory has those of its input, then those of its state, by gates.
        """
        parts: list[tuple[int, ...]] = []
        for index, (inputs, outputs) in enumerate(pairwise(self.widths)):
            if index == 0 and self.recurrent != "none":
                gates = GATES[self.recurrent] * outputs
                parts += [(gates, inputs), (gates,), (gates, outputs), (gates,)]
            else:
                parts += [(outputs, inputs), (outputs,)]
        return tuple(parts)

    @property
    def count(self) -> int:
        """Number of parameters."""
        return sum(int(np.prod(part)) for part in self.parts)

    def split(self, parameters: Array32) -> list[Array32]:
        """Return views of an array of parameters, one for each of `parts`."""
        ends = np.cumsum([int(np.prod(part)) for part in self.parts])[:-1]
        return [view.reshape(part) for view, part in zip(np.split(parameters, ends), self.parts, strict=True)]

    def fresh(self, start_output: float, rng: np.random.Generator) -> Array32:
        """Draw parameters of an untrained network; start_output: motor fraction of its outputs."""
        parameters = np.zeros(self.count, np.float32)
        *hidden, weight, bias = self.split(parameters)
        for part in (each for each in hidden if each.ndim == 2):
            part[:] = HIDDEN_GAIN * _orthogonal(part, rng)
        weight[:] = LAST_GAIN * _orthogonal(weight, rng)
        start = (start_output - self.output.offset) / self.output.scale
        bias[:] = np.arctanh(np.clip(start, -0.99, 0.99)) if self.output.squash else start
        if self.recurrent != "none":
            self._slow_down(hidden, rng)
        return parameters

    def _slow_down(self, hidden: list[Array32], rng: np.random.Generator) -> None:
        """Let units forget at different paces at first: within two to some hundred steps.

        The second gate says what a unit keeps. An LSTM takes in as much less as it keeps more, by its first
        gate, so that its sums stay of one size (Tallec and Ollivier 2018).
        """
        units, bias = self.widths[1], hidden[1]
        bias[units : 2 * units] = np.log(np.exp(rng.uniform(0.0, np.log(200.0), units)) + 1e-3)
        if self.recurrent == "lstm":
            bias[:units] = -bias[units : 2 * units]
        for gate in range(GATES[self.recurrent]):
            own = hidden[2][gate * units : (gate + 1) * units]
            own[:] = _orthogonal(own, rng)


def _orthogonal(like: Array32, rng: np.random.Generator) -> NDArray[np.float64]:
    """Draw a matrix of this shape with orthonormal rows or columns, uniformly distributed (Mezzadri 2007)."""
    rows, columns = like.shape
    wide = rows < columns
    q, r = np.linalg.qr(rng.standard_normal((columns, rows) if wide else (rows, columns)))
    q = q * np.sign(np.diag(r))
    return q.T if wide else q
