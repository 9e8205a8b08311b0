"""The policy network with forward and backward pass, float32: an MLP and the map of its outputs to motors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from training.config.training_config import OutputMap

Array = NDArray[np.float32]
HIDDEN_GAIN = 1.4  # of the initial orthogonal matrices
LAST_GAIN = 0.02  # small: the outputs of an untrained policy hardly depend on the observation


@dataclass(frozen=True, eq=False)
class Layer:
    """y = W x + b."""

    weight: Array  # (outputs, inputs)
    bias: Array  # (outputs,)


@dataclass(frozen=True, eq=False)
class Passed:
    """The values of a forward pass of N observations."""

    hidden: list[Array]  # (N, width) each, after the activation
    output: Array  # (N, M), squashed where the map says so
    unclipped: Array  # (N, M), motor fractions before the clip to 0..1


@dataclass(frozen=True, eq=False)
class Network:
    """An MLP: hidden layers with `activation`, the last one with `map`."""

    layers: tuple[Layer, ...]
    activation: str  # "tanh" or "relu"
    map: OutputMap

    @staticmethod
    def fresh(
        widths: Sequence[int],
        activation: str,
        output: OutputMap,
        start_output: float,
        rng: np.random.Generator,
    ) -> Network:
        """An untrained network.

        widths: of observation, hidden layers, motors; start_output: motor fraction of its outputs.
        """
        layers: list[Layer] = []
        for inputs, outputs in pairwise(widths):
            last = len(layers) == len(widths) - 2
            weight = _orthogonal(outputs, inputs, rng) * (LAST_GAIN if last else HIDDEN_GAIN)
            bias = np.zeros(outputs)
            if last:
                start = (start_output - output.offset) / output.scale
                bias += np.arctanh(np.clip(start, -0.99, 0.99)) if output.squash else start
            layers.append(Layer(weight.astype(np.float32), bias.astype(np.float32)))
        return Network(tuple(layers), activation, output)

    def forward(self, observation: Array) -> Passed:
        """The outputs for scaled observations (N, n)."""
        value, hidden = observation, []
        for layer in self.layers[:-1]:
            value = value @ layer.weight.T + layer.bias
            value = np.tanh(value) if self.activation == "tanh" else np.maximum(value, np.float32(0.0))
            hidden.append(value)
        last = self.layers[-1]
        output = value @ last.weight.T + last.bias
        if self.map.squash:
            output = np.tanh(output)
        return Passed(hidden, output, self.map.unclipped(output))

    def backward(self, passed: Passed, unclipped: Array) -> tuple[Array, list[Array]]:
        """From derivatives by `unclipped` (N, M) to those by the observation, and by each layer's sums.

        `gradient` needs the latter: (N, outputs) of each layer, in order.
        """
        sums = np.multiply(unclipped, self.map.scale, dtype=np.float32)
        if self.map.squash:
            sums *= np.float32(1.0) - np.square(passed.output)
        all_sums: list[Array] = [sums]
        for layer, hidden in zip(self.layers[:0:-1], passed.hidden[::-1], strict=True):
            slope = np.float32(1.0) - hidden * hidden if self.activation == "tanh" else hidden > 0.0
            sums = np.multiply(sums @ layer.weight, slope, dtype=np.float32)
            all_sums.append(sums)
        return sums @ self.layers[0].weight, all_sums[::-1]

    def gradient(self, observation: Array, hidden: Sequence[Array], sums: Sequence[Array]) -> list[Array]:
        """Derivatives by each layer's weight and bias, in order, of the N passes of `backward` together."""
        gradient = []
        for value, layer_sums in zip((observation, *hidden), sums, strict=True):
            gradient += [layer_sums.T @ value, layer_sums.sum(axis=0)]
        return gradient

    @property
    def parameters(self) -> list[Array]:
        """Weight and bias of each layer, in order; the arrays themselves."""
        return [array for layer in self.layers for array in (layer.weight, layer.bias)]


def _orthogonal(rows: int, columns: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """A matrix with orthonormal rows or columns, uniformly distributed (Mezzadri 2007)."""
    wide = rows < columns
    q, r = np.linalg.qr(rng.standard_normal((columns, rows) if wide else (rows, columns)))
    q = q * np.sign(np.diag(r))
    return q.T if wide else q
