"""Passes that use the range of each value: bounds that cannot bind go, values that cannot vary are folded.

What a value can be is found by interval arithmetic from any observation on, exact in real arithmetic.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import assert_never

import numpy as np
from numpy.typing import NDArray

from toolchain.ir.network import Network, Node
from toolchain.ir.operations import (
    Add,
    Affine,
    Clip,
    Concat,
    Elu,
    Gru,
    LayerNorm,
    LeakyRelu,
    Linear,
    Lstm,
    Multiply,
    Operation,
    Relu,
    Sigmoid,
    Silu,
    Slice,
    Softsign,
    Tanh,
)
from toolchain.passes.affine import input_matrix, with_input
from toolchain.passes.rewrite import Draft, rewrite

Interval = tuple[NDArray[np.float64], NDArray[np.float64]]  # lowest and highest value, each (n,)

SILU_LOWEST = -0.2784645427610739  # at x = -1.2784645


def drop_bounds(network: Network) -> Network:
    """A Clip, ReLU, LeakyReLU or ELU that cannot bind is dropped; two bounds in a row become one."""
    intervals = value_intervals(network)

    def rule(draft: Draft, node: Node, number: int) -> Node | int | None:
        last = number == len(network.nodes)
        low, high = intervals[draft.roles[node.inputs[0]][0]]
        match node.operation:
            case Relu() | LeakyRelu() | Elu() if (low >= 0).all():
                return node.inputs[0]
            case Relu() | Clip():
                bounds = _bounds(node.operation)
                before = draft.sole(node.inputs[0])
                if before is not None and isinstance(before.operation, Relu | Clip):
                    joined = _join(_bounds(before.operation), bounds)
                    # The last Clip's lower bound is also what a NaN gives: it stays as it is.
                    if not last or joined[0] == bounds[0]:
                        return Node(_bound(*joined), before.inputs, node.name)
                if last:
                    return None
                free_low, free_high = (low >= bounds[0]).all(), (high <= bounds[1]).all()
                if free_low and free_high:
                    return node.inputs[0]
                kept = (-np.inf if free_low else bounds[0], np.inf if free_high else bounds[1])
                if kept != bounds:
                    return Node(_bound(*kept), node.inputs, node.name)
        return None

    return rewrite(network, rule)


def fold_constants(network: Network) -> Network:
    """What a matrix takes that no observation changes moves into the bias; its weight becomes 0."""
    intervals = value_intervals(network)

    def rule(draft: Draft, node: Node, _number: int) -> Node | None:
        if (matrix := input_matrix(node.operation)) is None:
            return None
        weight, bias = matrix
        low, high = intervals[draft.roles[node.inputs[0]][0]]
        constant = (low == high) & np.isfinite(low) & weight.any(axis=0)
        if not constant.any():
            return None
        folded = bias + weight[:, constant] @ low[constant]
        return Node(with_input(node.operation, np.where(constant, 0, weight), folded), node.inputs, node.name)

    return rewrite(network, rule)


def value_intervals(network: Network) -> list[Interval]:
    """Between which bounds each value lies, whatever the observation and the observations before."""
    unbounded = np.full(network.inputs, np.inf)
    intervals: list[Interval] = [(-unbounded, unbounded)]
    with np.errstate(all="ignore"):
        for node, width in zip(network.nodes, network.widths[1:], strict=True):
            low, high = _interval(node.operation, [intervals[value] for value in node.inputs], width)
            # Infinity times nothing: nothing is known.
            intervals.append(
                (
                    np.nan_to_num(low, nan=-np.inf, neginf=-np.inf, posinf=np.inf),
                    np.nan_to_num(high, nan=np.inf, neginf=-np.inf, posinf=np.inf),
                )
            )
    return intervals


def _interval(operation: Operation, taken: Sequence[Interval], width: int) -> Interval:
    low, high = taken[0]
    one = np.ones(width)
    match operation:
        case Linear(weight, bias):
            ends = [np.where(weight == 0, 0, weight * end) for end in (low, high)]
            return np.minimum(*ends).sum(axis=1) + bias, np.maximum(*ends).sum(axis=1) + bias
        case Affine(scale, offset):
            ends = [np.where(scale == 0, 0, scale * end) for end in (low, high)]
            return np.minimum(*ends) + offset, np.maximum(*ends) + offset
        case Tanh():
            return np.tanh(low), np.tanh(high)
        case Sigmoid():
            return _sigmoid(low), _sigmoid(high)
        case Softsign():
            return _softsign(low), _softsign(high)
        case Silu():
            return np.where(low < 0, SILU_LOWEST, _silu(low)), np.maximum(0, _silu(high))
        case Relu() | Clip():
            bounds = _bounds(operation)
            return np.clip(low, *bounds), np.clip(high, *bounds)
        case LeakyRelu(slope):
            return _bent(lambda x: np.where(x < 0, slope * x if slope else 0, x), low, high)
        case Elu(alpha):
            return _bent(lambda x: np.where(x < 0, alpha * np.expm1(x), x), low, high)
        case LayerNorm(_, scale, offset):  # one value as far from the mean as it can be
            reach = np.abs(scale) * np.sqrt(width - 1)
            return offset - reach, offset + reach
        case Gru() | Lstm():
            return -one, one
        case Add():
            return low + taken[1][0], high + taken[1][1]
        case Multiply():
            ends = [np.where((a == 0) | (b == 0), 0, a * b) for a in taken[0] for b in taken[1]]
            return np.minimum.reduce(ends), np.maximum.reduce(ends)
        case Concat():
            return np.concatenate([low for low, _ in taken]), np.concatenate([high for _, high in taken])
        case Slice(start, count, step):
            places = start + step * np.arange(count)
            return low[places], high[places]
        case never:
            assert_never(never)


def _bent(
    function: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    low: NDArray[np.float64],
    high: NDArray[np.float64],
) -> Interval:
    """The range of a function that is monotone on either side of f(0) = 0."""
    ends = [function(low), function(high), np.where((low < 0) & (high > 0), 0, function(low))]
    return np.minimum.reduce(ends), np.maximum.reduce(ends)


def _sigmoid(x: NDArray[np.float64]) -> NDArray[np.float64]:
    result: NDArray[np.float64] = 0.5 + 0.5 * np.tanh(0.5 * x)
    return result


def _silu(x: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.where(np.isinf(x), np.maximum(x, 0), x * _sigmoid(x))


def _softsign(x: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.where(np.isinf(x), np.sign(x), x / (1 + np.abs(x)))


def _bounds(operation: Operation) -> tuple[float, float]:
    """Of a Relu or Clip, infinite where it has none."""
    match operation:
        case Relu():
            return 0.0, np.inf
        case Clip(low, high):
            return -np.inf if low is None else low, np.inf if high is None else high
    raise TypeError(f"{operation} has no bounds")


def _bound(low: float, high: float) -> Clip | Relu:
    if (low, high) == (0, np.inf):
        return Relu()
    return Clip(None if low == -np.inf else low, None if high == np.inf else high)


def _join(first: tuple[float, float], second: tuple[float, float]) -> tuple[float, float]:
    """The bounds that do the work of two: the first's, bounded by the second."""
    low, high = (min(max(bound, second[0]), second[1]) for bound in first)
    return low, high
