"""Networks of random weights, put together operation by operation."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from neuroflight.toolchain.ir.network import Network, Node
from neuroflight.toolchain.ir.operations import Affine, Clip, Gru, LayerNorm, Linear, Lstm, Operation

if TYPE_CHECKING:
    from tests.toolchain.conftest import Float32


class Maker:
    """A network under construction; every method gives the number of the value it adds."""

    def __init__(self, inputs: int, seed: int) -> None:
        self.inputs, self.nodes = inputs, list[Node]()
        self._rng = np.random.default_rng(seed)

    def add(self, operation: Operation, *values: int) -> int:
        """A node on `values`, by default on the last one."""
        self.nodes.append(Node(operation, values or (len(self.nodes),)))
        return len(self.nodes)

    def linear(self, outputs: int, *values: int) -> int:
        """A linear layer whose sums stay near 1."""
        value = values[0] if values else len(self.nodes)
        inputs = Network(self.inputs, tuple(self.nodes)).widths[value]
        return self.add(Linear(self.weights(outputs, inputs), 0.1 * self.weights(outputs)), value)

    def weights(self, *shape: int) -> Float32:
        """Random values of a size that keeps sums near 1."""
        return np.asarray(self._rng.normal(size=shape) / np.sqrt(shape[-1]), np.float32)

    def clipped(self, actions: int = 4) -> Network:
        """The network, ending in actions that mostly lie inside the bounds."""
        self.linear(actions)
        self.add(Affine(np.full(actions, 0.3), np.full(actions, 0.4)))
        self.add(Clip(0.0, 1.0))
        return Network(self.inputs, tuple(self.nodes))


def perceptron(inputs: int, *layers: int | Operation, seed: int = 0) -> Network:
    """Linear layers of the given widths and other operations, one after the other."""
    make = Maker(inputs, seed)
    for layer in layers:
        if isinstance(layer, int):
            make.linear(layer)
        else:
            make.add(layer)
    return make.clipped()


def gru(make: Maker, inputs: int, units: int) -> Gru:
    """A cell of random weights."""
    shapes = ((3 * units, inputs), (3 * units, units), (3 * units,), (3 * units,))
    return Gru(*(make.weights(*shape) for shape in shapes))


def lstm(make: Maker, inputs: int, units: int) -> Lstm:
    """A cell of random weights."""
    return Lstm(*(make.weights(*shape) for shape in ((4 * units, inputs), (4 * units, units), (4 * units,))))


def norm(make: Maker, width: int) -> LayerNorm:
    """A norm whose scale is near 1."""
    return LayerNorm(1e-5, 1 + 0.1 * make.weights(width), make.weights(width))
