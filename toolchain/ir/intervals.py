"""Bounds of each value of a network by interval arithmetic, exact in real arithmetic."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import assert_never

import numpy as np

from neuroflight.toolchain.ir import operations as op
from neuroflight.toolchain.ir.float64_functions import Float64, erf, softplus
from neuroflight.toolchain.ir.network import Network

Interval = tuple[Float64, Float64]  # lowest and highest value, each (n,)

SILU_LOWEST = -0.2784645427610739  # at x = -1.2784645


def value_intervals(network: Network, *, by_weights: bool = True) -> list[Interval]:
    """Return the bounds of each value, whatever the observation and the observations before.

    by_weights: bounds follow through layers' weights as well; otherwise only from activations and maps of
    single values, which gives the range that the designer had in mind, such as -1 to 1 of a Tanh.
    """
    unbounded = np.full(network.inputs, np.inf)
    intervals: list[Interval] = [(-unbounded, unbounded)]
    with np.errstate(all="ignore"):
        for node, width in zip(network.nodes, network.widths[1:], strict=True):
            low, high = _interval(node.operation, [intervals[value] for value in node.inputs], width)
            if not by_weights and isinstance(node.operation, op.Linear | op.LayerNorm | op.RmsNorm):
                low, high = np.full(width, -np.inf), np.full(width, np.inf)
            # Infinity times 0 is NaN: no bound is known.
            intervals.append((np.where(np.isnan(low), -np.inf, low), np.where(np.isnan(high), np.inf, high)))
    return intervals


def _interval(operation: op.Operation, taken: Sequence[Interval], width: int) -> Interval:
    low, high = taken[0]
    one = np.ones(width)
    match operation:
        case op.Linear(weight, bias):
            ends = [np.where(weight == 0, 0, weight * end) for end in (low, high)]
            return np.minimum(*ends).sum(axis=1) + bias, np.maximum(*ends).sum(axis=1) + bias
        case op.Affine(scale, offset):
            ends = [np.where(scale == 0, 0, scale * end) for end in (low, high)]
            return np.minimum(*ends) + offset, np.maximum(*ends) + offset
        case op.Tanh() | op.Sigmoid() | op.Softsign() | op.Erf() | op.Softplus():
            rising = RISING[type(operation)]
            return rising(low), rising(high)
        case op.Silu():
            return np.where(low < 0, SILU_LOWEST, _silu(low)), np.maximum(0, _silu(high))
        case op.Relu() | op.Clip():
            bounds = clip_bounds(operation)
            return np.clip(low, *bounds), np.clip(high, *bounds)
        case op.LeakyRelu(slope):
            return _bent(lambda x: np.where(x < 0, slope * x if slope else 0, x), low, high)
        case op.Elu(alpha):
            return _bent(lambda x: np.where(x < 0, alpha * np.expm1(x), x), low, high)
        case op.LayerNorm(_, scale, offset):  # one value as far from the mean as it can be
            reach = np.abs(scale) * np.sqrt(width - 1)
            return offset - reach, offset + reach
        case op.RmsNorm(_, scale, offset):  # one value alone
            reach = np.abs(scale) * np.sqrt(width)
            return offset - reach, offset + reach
        case op.Softmax():
            return 0 * one, one
        case op.Gru() | op.Lstm():
            return -one, one
        case op.Add():
            return low + taken[1][0], high + taken[1][1]
        case op.Multiply():
            ends = [np.where((a == 0) | (b == 0), 0, a * b) for a in taken[0] for b in taken[1]]
            return np.minimum.reduce(ends), np.maximum.reduce(ends)
        case op.Select():
            known = [low > 0, high <= 0]  # which of the two is taken
            lows, highs = zip(*taken[1:], strict=True)
            return np.select(known, lows, np.minimum(*lows)), np.select(known, highs, np.maximum(*highs))
        case op.Concat():
            return np.concatenate([low for low, _ in taken]), np.concatenate([high for _, high in taken])
        case op.Slice(start, count, step):
            places = start + step * np.arange(count)
            return low[places], high[places]
        case never:
            assert_never(never)


def _bent(function: Callable[[Float64], Float64], low: Float64, high: Float64) -> Interval:
    """Return the range of a function that is monotone on either side of 0, where it is 0."""
    ends = [function(low), function(high), np.where((low < 0) & (high > 0), 0, function(low))]
    return np.minimum.reduce(ends), np.maximum.reduce(ends)


def _sigmoid(x: Float64) -> Float64:
    result: Float64 = 0.5 + 0.5 * np.tanh(0.5 * x)
    return result


def _silu(x: Float64) -> Float64:
    return np.where(np.isinf(x), np.maximum(x, 0), x * _sigmoid(x))


def _softsign(x: Float64) -> Float64:
    return np.where(np.isinf(x), np.sign(x), x / (1 + np.abs(x)))


RISING: dict[type[op.Operation], Callable[[Float64], Float64]] = {
    op.Tanh: np.tanh,
    op.Sigmoid: _sigmoid,
    op.Softsign: _softsign,
    op.Erf: erf,
    op.Softplus: softplus,
}


def clip_bounds(operation: op.Operation) -> tuple[float, float]:
    """Return the bounds of a Relu or Clip, infinite where it has none."""
    match operation:
        case op.Relu():
            return 0.0, np.inf
        case op.Clip(low, high):
            return -np.inf if low is None else low, np.inf if high is None else high
    raise TypeError(f"{operation} has no bounds")
