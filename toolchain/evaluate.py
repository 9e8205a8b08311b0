"""Evaluates a policy's layers exactly as the emitted C does, bit for bit, on many observations at once.

The order of every operation is the law that `toolchain.emit`'s kernels follow too: a linear layer starts
from the bias and adds inputs in ascending order, each by one fused multiply-add; comparisons choose, so
that a NaN passes through hidden layers and becomes the lower bound at the output.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from toolchain.float32 import Float32, fma
from toolchain.layers import Affine, Clip, Layer, Linear, Relu, Tanh
from toolchain.tanh import tanh


def evaluate(layers: Sequence[Layer], observation: Float32, *, exact: bool = True) -> Float32:
    """Actions (N, outputs) of observations (N, inputs), both float32. The last layer is the output's Clip.

    exact: give the emitted C's bits; otherwise linear layers go through BLAS and tanh through numpy, many
    times as fast and a few ulp away, which is for statistics over many flights.
    Any observation gives actions within the Clip's bounds; one with a NaN in it gives the lower bound.
    """
    *hidden, door = layers
    if not isinstance(door, Clip) or door.low is None or door.high is None:
        raise ValueError(f"the last layer is {door}, expected a Clip with both bounds")
    values = np.ascontiguousarray(observation, np.float32)
    for layer in hidden:
        values = _apply(layer, values) if exact else _approximate(layer, values)
    low, high = np.float32(door.low), np.float32(door.high)
    values = np.where(values > low, values, low)
    return np.where(values < high, values, high)


def _apply(layer: Layer, x: Float32) -> Float32:
    match layer:
        case Linear():
            return _linear(layer, x)
        case Affine():
            return fma(x, layer.scale.astype(np.float32), layer.offset.astype(np.float32))
        case Tanh():
            return tanh(x)
        case Relu():
            return np.where(x < 0, np.float32(0), x)
        case Clip():
            if layer.low is not None:
                x = np.where(x < np.float32(layer.low), np.float32(layer.low), x)
            if layer.high is not None:
                x = np.where(x > np.float32(layer.high), np.float32(layer.high), x)
            return x


def _approximate(layer: Layer, x: Float32) -> Float32:
    match layer:
        case Linear():
            return x @ layer.weight.T + layer.bias
        case Tanh():
            return np.tanh(x)
        case _:
            return _apply(layer, x)


def _linear(layer: Linear, x: Float32) -> Float32:
    total = np.broadcast_to(layer.bias, (x.shape[0], layer.outputs))
    for index in range(layer.inputs):
        total = fma(x[:, index, None], layer.weight[:, index], total)
    return total
