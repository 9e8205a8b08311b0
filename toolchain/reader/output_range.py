"""Every policy ends with a Clip within [0, 1], motor fractions.

An export that ends with an activation of that range, such as a sigmoid, gets such a Clip here, which
changes no value. Any other model without one is rejected.
"""

from __future__ import annotations

import math

import numpy as np

from toolchain.errors import PolicyError
from toolchain.ir.network import Network, Node
from toolchain.ir.operations import (
    Add,
    Affine,
    Clip,
    Concat,
    Gru,
    Lstm,
    Multiply,
    Operation,
    Relu,
    Sigmoid,
    Slice,
    Softsign,
    Tanh,
)

Range = tuple[float, float]
ANY: Range = (-math.inf, math.inf)


class UnboundedError(PolicyError):
    """A policy whose motor fractions may leave [0, 1]."""


def bounded(network: Network) -> Network:
    """`network` with a Clip within [0, 1] at its end. Raises UnboundedError otherwise."""
    match network.nodes[-1].operation if network.nodes else None:
        case Clip(low=float(low), high=float(high)) if 0 <= low <= high <= 1:
            return network
        case last:
            low, high = _ranges(network)[-1]
            if not 0 <= low <= high <= 1:
                raise UnboundedError(
                    f"the policy ends with {_short(last)}, expected Clip within [0, 1]; clip the motor "
                    "fractions, or let `neuroflight freeze --clip` do it"
                )
    clip = Node(Clip(0.0, 1.0), (len(network.nodes),), "clip")
    return Network(network.inputs, (*network.nodes, clip))


def _ranges(network: Network) -> list[Range]:
    """Bounds of every value for finite observations, the observation's first."""
    ranges = [ANY]
    for node in network.nodes:
        with np.errstate(invalid="ignore"):
            ends = _range(node.operation, [ranges[number] for number in node.inputs])
        ranges.append(ANY if any(map(math.isnan, ends)) else (min(ends), max(ends)))
    return ranges


def _range(operation: Operation, inputs: list[Range]) -> tuple[float, ...]:
    """Values that the operation stays between; NaN where it cannot be told."""
    low, high = inputs[0]
    match operation:
        case Sigmoid():
            return 0.0, 1.0
        case Tanh() | Softsign() | Gru() | Lstm():
            return -1.0, 1.0
        case Relu():
            return max(low, 0.0), max(high, 0.0)
        case Clip():
            floor = -math.inf if operation.low is None else operation.low
            ceiling = math.inf if operation.high is None else operation.high
            return min(max(low, floor), ceiling), min(max(high, floor), ceiling)
        case Affine(scale, offset):
            return (*(scale * low + offset), *(scale * high + offset))
        case Slice():
            return low, high
        case Concat():
            return min(low for low, _ in inputs), max(high for _, high in inputs)
        case Add():
            return low + inputs[1][0], high + inputs[1][1]
        case Multiply():
            return tuple(first * second for first in inputs[0] for second in inputs[1])
    return ANY


def _short(operation: Operation | None) -> str:
    match operation:
        case None:
            return "nothing"
        case Clip(low, high):
            return f"Clip from {low} to {high}"
    return type(operation).__name__
