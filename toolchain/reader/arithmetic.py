"""Readers of matrices and arithmetic: Gemm, MatMul, ReduceMean, ReduceSum, Add, Sub, Mul, Div and Neg."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from neuroflight.toolchain.ir.operations import Add, Affine, Clip, Linear, Multiply, Sigmoid, Silu, Tanh
from neuroflight.toolchain.reader.constants import CONSTANT_STATE
from neuroflight.toolchain.reader.values import Array, Call, RowValue, joint_shape

Float64 = NDArray[np.float64]


def read_gemm(call: Call) -> RowValue:
    """Read Gemm: alpha x W + beta b."""
    row, options = call.row(0), call.attributes
    shape = row.shape[::-1] if options.get("transA", 0) else row.shape
    flat = len(shape) == 1  # which ONNX forbids and jax2onnx writes
    if not flat and (len(shape) != 2 or shape[0] != 1):
        raise call.error(f"multiplies a value of shape {list(row.shape)}, expected one row")
    with np.errstate(all="ignore"):
        weight = _weights(call, 1, (2,)) * options.get("alpha", 1.0)
    weight = weight if options.get("transB", 0) else weight.T
    bias = np.zeros(weight.shape[0])
    given = call.floats(2)
    if given is not None:
        if joint_shape(call, given.shape, (1, bias.size)) != (1, bias.size):
            raise call.error(f"adds a constant of shape {list(given.shape)}, expected [{bias.size}]")
        with np.errstate(all="ignore"):
            bias = np.broadcast_to(given, (1, bias.size))[0] * np.float64(options.get("beta", 1.0))
    return linear(call, row, weight, bias, (bias.size,) if flat else (1, bias.size))


def read_matmul(call: Call) -> RowValue:
    """Read MatMul: x W or W x, if every axis but the summed one has size 1."""
    first = isinstance(call.input(0), RowValue)
    row, constant = call.row(0 if first else 1), call.floats(1 if first else 0)
    weight = _weights(call, 1).T if first else _weights(call, 0)
    flat = len(row.shape) == 1
    summed = row.shape[-1 if first or flat else -2] if row.shape else 0
    if summed != row.width or constant is None:
        raise call.error(f"multiplies a value of shape {list(row.shape)}, expected one row")
    lead = (1,) * max(len(row.shape) - 2, constant.ndim - 2)
    outer = () if flat else (1,)
    shape = (*lead, *outer, weight.shape[0]) if first else (*lead, weight.shape[0], *outer)
    return linear(call, row, weight, np.zeros(weight.shape[0]), shape)


def _weights(call: Call, place: int, ranks: tuple[int, ...] = (2, 3, 4)) -> Float64:
    weight = call.floats(place)
    if weight is None or weight.ndim not in ranks or math.prod(weight.shape[:-2]) != 1:
        shape = "none" if weight is None else f"shape {list(weight.shape)}"
        raise call.error(f"has weights of {shape}, expected a matrix")
    return weight.reshape(weight.shape[-2:]).astype(np.float64)


def linear(call: Call, row: RowValue, weight: Float64, bias: Float64, shape: tuple[int, ...]) -> RowValue:
    """Append W x + b, rounded to float32. Raises PolicyError if that overflows or does not fit the value."""
    if weight.shape[1] != row.width or not weight.size:
        raise call.error(f"has weights for {weight.shape[1]} inputs, expected {row.width}")
    with np.errstate(over="ignore"):
        layer = Linear(np.ascontiguousarray(weight, np.float32), bias.astype(np.float32))
    if not (np.isfinite(layer.weight).all() and np.isfinite(layer.bias).all()):
        raise call.error("scales its weights beyond the range of float32")
    return call.append(layer, row, shape=shape)


def read_arithmetic(call: Call) -> RowValue:
    """Add, Sub, Mul and Div: of a value and a constant, or of two values."""
    if len(call.inputs) == 2 and all(isinstance(value, RowValue) for value in call.inputs):
        return _of_two(call, call.row(0), call.row(1))
    first = isinstance(call.input(0), RowValue)
    row, constant = call.row(0 if first else 1), call.numbers(1 if first else 0)
    assert constant is not None
    shape = joint_shape(call, row.shape, constant.shape)
    row = call.broadcast(row, shape)
    values = np.broadcast_to(constant, shape).ravel()
    _reject_constant_state(call, row, constant)
    match call.operator:
        case "Add":
            return mapped(call, row, 1.0, values, shape)
        case "Sub":
            return mapped(call, row, 1.0 if first else -1.0, -values if first else values, shape)
        case "Mul":
            return mapped(call, row, values, 0.0, shape)
    if not first:
        raise call.error("divides a constant by a value, expected a constant divisor")
    if not values.all():
        raise call.error("divides by zero, expected a divisor without zeros")
    return mapped(call, row, 1 / values, 0.0, shape)


def mapped(
    call: Call, row: RowValue, scale: Float64 | float, offset: Float64 | float, shape: tuple[int, ...]
) -> RowValue:
    """Append scale row + offset, value by value."""
    factors, summands = (np.broadcast_to(np.float64(values), row.width).copy() for values in (scale, offset))
    if max(np.abs(factors).max(), np.abs(summands).max()) > np.finfo(np.float32).max:
        raise call.error("scales its value beyond the range of float32")
    return call.append(Affine(factors, summands), row, shape=shape)


def _of_two(call: Call, first: RowValue, second: RowValue) -> RowValue:
    shape = joint_shape(call, first.shape, second.shape)
    if call.operator == "Mul" and (row := _gated_by_itself(call, first, second)):
        return call.append(Silu(), row, shape=row.shape)
    first, second = (call.broadcast(row, shape) for row in (first, second))
    match call.operator:
        case "Add":
            return call.append(Add(), first, second, shape=shape)
        case "Sub":
            negative = mapped(call, second, -1.0, 0.0, shape)
            return call.append(Add(), first, negative, shape=shape)
        case "Mul":
            return call.append(Multiply(), first, second, shape=shape)
    raise call.error("divides a value by another, expected a constant divisor")


def _gated_by_itself(call: Call, first: RowValue, second: RowValue) -> RowValue | None:
    """Append x sigmoid(x) as SiLU, as exporters write it before opset 24; None for any other product."""
    for row, gate in ((first, second), (second, first)):
        node = call.build.operation(gate)
        if node and node.operation == Sigmoid() and node.inputs == (row.number,) and row.shape == gate.shape:
            call.build.absorbed.add(gate.number)
            return row
    return None


def _reject_constant_state(call: Call, row: RowValue, constant: Array) -> None:
    """Reject what is left of a recurrent cell whose state the exporter took for a constant."""
    if constant.any():
        return
    node = call.build.operation(row)
    after_tanh = node is not None and node.operation == Tanh()
    if call.operator == "Mul" or (call.operator == "Sub" and constant.size > 1 and after_tanh):
        raise call.error(f"computes with zeros only; {CONSTANT_STATE}")


def read_reduction(call: Call) -> RowValue:
    """Read ReduceMean and ReduceSum over any axes, as a matrix of ones or of 1 / n."""
    row, kept = call.row(), call.attributes.get("keepdims", 1)
    axes = reduced_axes(call, row)
    places = np.moveaxis(row.places, axes, range(len(axes))).reshape(
        math.prod(row.shape[axis] for axis in axes), -1
    )
    weight = np.zeros((places.shape[1], row.width))
    for output, taken in enumerate(places.T):
        weight[output, taken] = 1 / len(taken) if call.operator == "ReduceMean" else 1
    sizes = ((1 if axis in axes else size) for axis, size in enumerate(row.shape) if kept or axis not in axes)
    return linear(call, row, weight, np.zeros(len(weight)), tuple(sizes))


def reduced_axes(call: Call, row: RowValue) -> list[int]:
    """Return the axes of `row` that a reduction covers, in ascending order."""
    given = call.constant(1)  # from opset 13 (ReduceSum) and 18 (ReduceMean) on the axes are an input
    axes = call.attributes.get("axes") if given is None else [int(axis) for axis in given.ravel()]
    if not axes:
        return [] if call.attributes.get("noop_with_empty_axes", 0) else list(range(len(row.shape)))
    if not all(-len(row.shape) <= axis < len(row.shape) for axis in axes):
        raise call.error(f"reduces axes {list(axes)} of a value of shape {list(row.shape)}")
    return sorted({axis % len(row.shape) for axis in axes})


def constant_row(call: Call, like: RowValue, values: Float64) -> RowValue:
    """Append constants in the shape of `like`: a Clip with equal bounds, and what differs is added.

    A product with zeros would be refused when the policy is read back: exporters write one where the state
    of a recurrent cell has become a constant.
    """
    same = bool((values == values[0]).all())
    bound = float(np.float32(values[0])) if same else 0.0
    row = call.append(Clip(bound, bound), like, shape=like.shape)
    return row if same else mapped(call, row, 1.0, values, like.shape)


def read_negative(call: Call) -> RowValue:
    """Read Neg."""
    return mapped(call, call.row(), -1.0, 0.0, call.row().shape)


def read_sum(call: Call) -> RowValue:
    """Read Sum and Mean of any number of values and constants."""
    rows = [value for value in call.inputs if isinstance(value, RowValue)]
    constants = [
        call.numbers(place) for place, value in enumerate(call.inputs) if not isinstance(value, RowValue)
    ]
    arrays = [array for array in constants if array is not None]
    shapes = [row.shape for row in rows] + [array.shape for array in arrays]
    shape = joint_shape(call, *shapes)
    total, *others = (call.broadcast(row, shape) for row in rows)
    for row in others:
        total = call.append(Add(), total, row, shape=shape)
    offset = np.zeros(shape)
    for array in arrays:
        offset += array
    share = 1 / len(call.inputs) if call.operator == "Mean" else 1.0
    return mapped(call, total, share, share * offset.ravel(), shape)
