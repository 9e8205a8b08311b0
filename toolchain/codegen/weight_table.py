"""The policy's one table of floats, part by part, in the order in which kernels read it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from neuroflight.toolchain.ir.float32 import Float32
from neuroflight.toolchain.ir.lanes import padded


def lanes_part(values: Float32 | NDArray[np.float64]) -> Float32:
    """Pad parameters, one for each value, to whole lanes."""
    room = np.zeros(padded(values.size), np.float32)
    room[: values.size] = values
    return room


def block_part(weight: Float32, bias: Float32, first: int, width: int) -> Float32:
    """Arrange biases, then weights by input, of `width` outputs from `first` on; missing outputs are 0."""
    rows = slice(first, first + width)
    block = np.zeros((1 + weight.shape[1], width), np.float32)
    block[0, : len(bias[rows])] = bias[rows]
    block[1:, : len(bias[rows])] = weight[rows].T
    return block.ravel()


def padded_gates(array: Float32, units: int) -> Float32:
    """Pad the rows of each gate to whole lanes with rows of 0."""
    gates = array.reshape(-1, units, *array.shape[1:])
    room = np.zeros((len(gates), padded(units), *array.shape[1:]), np.float32)
    room[:, :units] = gates
    return room.reshape(-1, *array.shape[1:])
