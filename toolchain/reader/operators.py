"""One reader an operator: what a node that takes computed values adds to the network."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from onnx import TensorProto

from toolchain.operations import (
    Add,
    Affine,
    Clip,
    Concat,
    Elu,
    LayerNorm,
    LeakyRelu,
    Linear,
    Multiply,
    Operation,
    Relu,
    Sigmoid,
    Silu,
    Softsign,
    Tanh,
)
from toolchain.reader.constants import CONSTANT_STATE, FOLDED, MOVES, apply
from toolchain.reader.patterns import ONLY_INSIDE, STARTS
from toolchain.reader.recurrent import read_gru, read_lstm
from toolchain.reader.values import WIDTH_MAX, Array, Builder, Call, Row, Unread, Value, joint_shape

Reader = Callable[[Builder, Call], Value | tuple[Value, ...]]
Float64 = NDArray[np.float64]


def _gemm(build: Builder, call: Call) -> Row:
    row, options = call.row(0), call.attributes
    shape = row.shape[::-1] if options.get("transA", 0) else row.shape
    if len(shape) != 2 or shape[0] != 1:
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
    return _linear(build, call, row, weight, bias, (1, bias.size))


def _matmul(build: Builder, call: Call) -> Row:
    """x W or W x, where every axis but the one that is summed over has size 1."""
    first = isinstance(call.input(0), Row)
    row, constant = call.row(0 if first else 1), call.floats(1 if first else 0)
    weight = _weights(call, 1).T if first else _weights(call, 0)
    flat = len(row.shape) == 1
    inner = row.shape[-1] if first or flat else row.shape[-2]
    if inner != row.width or constant is None:
        raise call.error(f"multiplies a value of shape {list(row.shape)}, expected one row")
    lead = (1,) * max(len(row.shape) - 2, constant.ndim - 2)
    outer = () if flat else (1,)
    shape = (*lead, *outer, weight.shape[0]) if first else (*lead, weight.shape[0], *outer)
    return _linear(build, call, row, weight, np.zeros(weight.shape[0]), shape)


def _weights(call: Call, place: int, ranks: tuple[int, ...] = (2, 3, 4)) -> Float64:
    weight = call.floats(place)
    if weight is None or weight.ndim not in ranks or math.prod(weight.shape[:-2]) != 1:
        shape = "none" if weight is None else f"shape {list(weight.shape)}"
        raise call.error(f"has weights of {shape}, expected a matrix")
    return weight.reshape(weight.shape[-2:]).astype(np.float64)


def _linear(
    build: Builder, call: Call, row: Row, weight: Float64, bias: Float64, shape: tuple[int, ...]
) -> Row:
    if weight.shape[1] != row.width or not weight.size:
        raise call.error(f"has weights for {weight.shape[1]} inputs, expected {row.width}")
    with np.errstate(over="ignore"):
        layer = Linear(np.ascontiguousarray(weight, np.float32), bias.astype(np.float32))
    if not (np.isfinite(layer.weight).all() and np.isfinite(layer.bias).all()):
        raise call.error("scales its weights beyond the range of float32")
    return build.append(call, layer, row, shape=shape)


def _arithmetic(build: Builder, call: Call) -> Row:
    """Add, Sub, Mul and Div: of a value and a constant, or of two values."""
    if len(call.inputs) == 2 and all(isinstance(value, Row) for value in call.inputs):
        return _of_two(build, call, call.row(0), call.row(1))
    first = isinstance(call.input(0), Row)
    row, constant = call.row(0 if first else 1), call.floats(1 if first else 0)
    assert constant is not None
    shape = joint_shape(call, row.shape, constant.shape)
    row = build.broadcast(call, row, shape)
    values = np.broadcast_to(constant, shape).ravel().astype(np.float64)
    _refuse_constant_state(build, call, row, constant)
    return build.append(call, _affine(call, values, first), row, shape=shape)


def _affine(call: Call, values: Float64, first: bool) -> Affine:
    one, zero = np.ones(values.size), np.zeros(values.size)
    match call.operator:
        case "Add":
            return Affine(one, values)
        case "Sub":
            return Affine(one, -values) if first else Affine(-one, values)
        case "Mul":
            return Affine(values, zero)
    if not first:
        raise call.error("divides a constant by a value, expected a constant divisor")
    if not values.all():
        raise call.error("divides by zero, expected a divisor without zeros")
    if np.abs(1 / values).max() > np.finfo(np.float32).max:
        raise call.error("divides by a value so small that its inverse leaves the range of float32")
    return Affine(1 / values, zero)


def _of_two(build: Builder, call: Call, first: Row, second: Row) -> Row:
    shape = joint_shape(call, first.shape, second.shape)
    if call.operator == "Mul" and (row := _gated_by_itself(build, first, second)):
        return build.append(call, Silu(), row, shape=row.shape)
    first, second = (build.broadcast(call, row, shape) for row in (first, second))
    match call.operator:
        case "Add":
            return build.append(call, Add(), first, second, shape=shape)
        case "Sub":
            minus = Affine(-np.ones(second.width), np.zeros(second.width))
            negative = build.append(call, minus, second, shape=shape)
            return build.append(call, Add(), first, negative, shape=shape)
        case "Mul":
            return build.append(call, Multiply(), first, second, shape=shape)
    raise call.error("divides a value by another, expected a constant divisor")


def _gated_by_itself(build: Builder, first: Row, second: Row) -> Row | None:
    """x of x sigmoid(x), as exporters write SiLU before opset 24."""
    for row, gate in ((first, second), (second, first)):
        node = build.operation(gate)
        if node and node.operation == Sigmoid() and node.inputs == (row.number,) and row.shape == gate.shape:
            build.absorbed.add(gate.number)
            return row
    return None


def _refuse_constant_state(build: Builder, call: Call, row: Row, constant: Array) -> None:
    """Refuse what is left of a recurrent cell whose state the exporter took for a constant."""
    if constant.any():
        return
    node = build.operation(row)
    after_tanh = node is not None and node.operation == Tanh()
    if call.operator == "Mul" or (call.operator == "Sub" and constant.size > 1 and after_tanh):
        raise call.error(f"computes with zeros only; {CONSTANT_STATE}")


def _negative(build: Builder, call: Call) -> Row:
    row = call.row()
    return build.append(call, Affine(-np.ones(row.width), np.zeros(row.width)), row, shape=row.shape)


def _activation(operation: Operation) -> Reader:
    def read(build: Builder, call: Call) -> Row:
        return build.append(call, operation, call.row(), shape=call.row().shape)

    return read


def _parameter(make: Callable[[float], Operation], default: float) -> Reader:
    def read(build: Builder, call: Call) -> Row:
        alpha = call.attributes.get("alpha", default)
        if not math.isfinite(alpha):
            raise call.error(f"has alpha {alpha}, expected a finite number")
        return build.append(call, make(alpha), call.row(), shape=call.row().shape)

    return read


def _swish(build: Builder, call: Call) -> Row:
    if call.attributes.get("alpha", 1.0) != 1:
        raise call.error(f"has alpha {call.attributes['alpha']:g}, expected 1")
    return build.append(call, Silu(), call.row(), shape=call.row().shape)


def _clip(build: Builder, call: Call) -> Row:
    return _clipped(build, call, call.row(), call.scalar(1), call.scalar(2))


def _min_or_max(build: Builder, call: Call) -> Row:
    """Min or Max of a value and constants: a Clip with one bound."""
    places = [place for place, value in enumerate(call.inputs) if isinstance(value, Row)]
    if len(places) != 1 or len(call.inputs) != 2:
        raise call.error("takes more than one value, expected one value and one constant")
    bound = call.scalar(1 - places[0])
    row = call.row(places[0])
    constant = call.constant(1 - places[0])
    assert constant is not None
    row = build.broadcast(call, row, joint_shape(call, row.shape, constant.shape))
    low, high = (None, bound) if call.operator == "Min" else (bound, None)
    return _clipped(build, call, row, low, high)


def _clipped(build: Builder, call: Call, row: Row, low: float | None, high: float | None) -> Row:
    low = None if low == -math.inf else low
    high = None if high == math.inf else high
    given = [bound for bound in (low, high) if bound is not None]
    if not all(map(math.isfinite, given)) or given != sorted(given):
        raise call.error(f"has the bounds {low} and {high}, expected finite ones, the lower one first")
    return build.append(call, Clip(low, high), row, shape=row.shape)


def _layer_norm(build: Builder, call: Call) -> tuple[Value, ...]:
    row, axis = call.row(), call.attributes.get("axis", -1)
    axis = axis + len(row.shape) if axis < 0 else axis
    epsilon = call.attributes.get("epsilon", 1e-5)
    if not 0 <= axis < len(row.shape) or math.prod(row.shape[axis:]) != row.width:
        raise call.error(f"normalizes part of a value of shape {list(row.shape)}, expected all of it")
    if not (math.isfinite(epsilon) and epsilon > 0):
        raise call.error(f"has epsilon {epsilon}, expected more than 0")
    scale, offset = call.floats(1), call.floats(2)
    rows = []
    for given, default in ((scale, 1.0), (offset, 0.0)):
        values = np.full(1, default, np.float32) if given is None else given
        if joint_shape(call, values.shape, row.shape) != row.shape:
            raise call.error(
                f"has a constant of shape {list(values.shape)}, expected {list(row.shape[axis:])}"
            )
        rows.append(np.broadcast_to(values, row.shape).ravel().copy())
    norm = build.append(call, LayerNorm(epsilon, rows[0], rows[1]), row, shape=row.shape)
    return norm, *(Unread(f"an inner value of {call.label}") for _ in range(call.outputs - 1))


def _batch_norm(build: Builder, call: Call) -> Row:
    """In inference an affine map of each value."""
    row = call.row()
    if call.attributes.get("training_mode", 0) or call.outputs > 1:
        raise call.error("is in training mode, expected inference; export after model.eval()")
    if len(row.shape) < 2 or row.shape[1] != row.width:
        raise call.error(f"takes a value of shape {list(row.shape)}, expected [1, n]")
    constants = [call.floats(place) for place in (1, 2, 3, 4)]
    if any(values is None or values.shape != (row.width,) for values in constants):
        raise call.error(f"has constants of other shapes than [{row.width}]")
    scale, offset, mean, variance = (np.asarray(values, np.float64) for values in constants)
    spread = variance + call.attributes.get("epsilon", 1e-5)
    if not (spread > 0).all():
        raise call.error("has a variance that is not above 0")
    factor = scale / np.sqrt(spread)
    return build.append(call, Affine(factor, offset - mean * factor), row, shape=row.shape)


def _dropout(build: Builder, call: Call) -> tuple[Value, ...]:
    training = call.constant(2)
    if training is not None and training.any():
        raise call.error("is in training mode, expected inference; export after model.eval()")
    return call.row(), Unread(f"the mask of {call.label}")


def _cast(build: Builder, call: Call) -> Row:
    kind = call.attributes.get("to", 0)
    if kind != TensorProto.FLOAT:
        known = kind in TensorProto.DataType.values()
        name = TensorProto.DataType.Name(kind).lower() if known else str(kind)
        raise call.error(f"converts to {name}, expected float32; export in float32")
    return call.row()


def _concat(build: Builder, call: Call) -> Row:
    """Values one after the other along any axis."""
    rows = [call.row(place) for place in range(len(call.inputs))]
    starts = np.cumsum([0, *(row.width for row in rows)])
    if starts[-1] > WIDTH_MAX:
        raise call.error(f"joins {starts[-1]} values, expected at most {WIDTH_MAX}")
    parts = [row.places + start for row, start in zip(rows, starts, strict=False)]
    places = apply(call, FOLDED["Concat"], parts)
    joined = build.append(call, Concat(), *rows, shape=(int(starts[-1]),)) if len(rows) > 1 else rows[0]
    assert not isinstance(places, tuple)
    return build.arranged(call, joined, places)


def _move(build: Builder, call: Call) -> Value | tuple[Value, ...]:
    """Whatever only moves values: a renamed row where they stay in order, slices where they do not."""
    row = call.row()
    constants = [call.constant(place) for place in range(1, len(call.inputs))]
    moved = apply(call, MOVES[call.operator], [row.places, *constants])
    if isinstance(moved, tuple):
        return tuple(build.arranged(call, row, places) for places in moved)
    return build.arranged(call, row, moved)


OPERATORS: dict[str, Reader] = {
    **dict.fromkeys(MOVES, _move),
    **dict.fromkeys(("Add", "Sub", "Mul", "Div"), _arithmetic),
    **dict.fromkeys(("Min", "Max"), _min_or_max),
    "BatchNormalization": _batch_norm,
    "Cast": _cast,
    "Clip": _clip,
    "Concat": _concat,
    "Dropout": _dropout,
    "Elu": _parameter(Elu, 1.0),
    "GRU": read_gru,
    "Gemm": _gemm,
    "LSTM": read_lstm,
    "LayerNormalization": _layer_norm,
    "LeakyRelu": _parameter(LeakyRelu, 0.01),
    "MatMul": _matmul,
    "Neg": _negative,
    "Relu": _activation(Relu()),
    "Sigmoid": _activation(Sigmoid()),
    "Softsign": _activation(Softsign()),
    "Swish": _swish,
    "Tanh": _activation(Tanh()),
}
COMPUTING = sorted(OPERATORS.keys() - MOVES.keys())
KNOWN = frozenset({*OPERATORS, *STARTS, *ONLY_INSIDE, *FOLDED, "Constant", "Shape"})
