"""One reader for each ONNX operator: what a node that takes computed values adds to the network."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from onnx import TensorProto

from neuroflight.toolchain.ir import operations as op
from neuroflight.toolchain.reader import activations, arithmetic
from neuroflight.toolchain.reader.conditions import CONDITIONS, read_mask, read_where
from neuroflight.toolchain.reader.constants import FOLDED, MOVES, apply
from neuroflight.toolchain.reader.convolution import read_conv
from neuroflight.toolchain.reader.patterns import ONLY_INSIDE, STARTS
from neuroflight.toolchain.reader.recurrent import read_gru, read_lstm, read_rnn
from neuroflight.toolchain.reader.values import (
    WIDTH_MAX,
    Call,
    Condition,
    RowValue,
    Unread,
    Value,
    joint_shape,
)

Reader = Callable[[Call], Value | tuple[Value, ...]]


def _activation(operation: op.Operation) -> Reader:
    def read(call: Call) -> RowValue:
        return call.append(operation, call.row(), shape=call.row().shape)

    return read


def _parameter(make: Callable[[float], op.Operation], default: float) -> Reader:
    def read(call: Call) -> RowValue:
        alpha = call.attributes.get("alpha", default)
        if not math.isfinite(alpha):
            raise call.error(f"has alpha {alpha}, expected a finite number")
        return call.append(make(alpha), call.row(), shape=call.row().shape)

    return read


def _clip(call: Call) -> RowValue:
    return _clipped(call, call.row(), call.scalar(1), call.scalar(2))


def _min_or_max(call: Call) -> RowValue:
    """Read Min and Max: with one number a Clip with one bound, of two values or many numbers a Select."""
    places = [place for place, value in enumerate(call.inputs) if isinstance(value, RowValue)]
    if len(call.inputs) != 2:
        raise call.error(f"takes {len(call.inputs)} values, expected two")
    if len(places) == 2:
        shape = joint_shape(call, call.row(0).shape, call.row(1).shape)
        first, second = (call.broadcast(call.row(place), shape) for place in (0, 1))
        negative = arithmetic.mapped(call, second, -1.0, 0.0, shape)
        above = call.append(op.Add(), first, negative, shape=shape)
        ordered = (first, second) if call.operator == "Max" else (second, first)
        return call.append(op.Select(), above, *ordered, shape=shape)
    row, constant = call.row(places[0]), call.constant(1 - places[0])
    assert constant is not None
    row = call.broadcast(row, shape := joint_shape(call, row.shape, constant.shape))
    if np.unique(constant).size > 1:
        bounds = call.numbers(1 - places[0])
        assert bounds is not None
        return _bounded_each(call, row, np.broadcast_to(bounds, shape).ravel())
    bound = call.scalar(1 - places[0])
    low, high = (None, bound) if call.operator == "Min" else (bound, None)
    return _clipped(call, row, low, high)


def _bounded_each(call: Call, row: RowValue, bounds: NDArray[np.float64]) -> RowValue:
    """Read Min or Max with a bound of its own for each value, such as limits of each motor."""
    bounds = bounds.astype(np.float32).astype(np.float64)
    held = arithmetic.constant_row(call, row, bounds)
    above = arithmetic.mapped(call, row, 1.0, -bounds, row.shape)
    ordered = (row, held) if call.operator == "Max" else (held, row)
    return call.append(op.Select(), above, *ordered, shape=row.shape)


def _clipped(call: Call, row: RowValue, low: float | None, high: float | None) -> RowValue:
    low = None if low == -math.inf else low
    high = None if high == math.inf else high
    given = [bound for bound in (low, high) if bound is not None]
    if not all(map(math.isfinite, given)) or given != sorted(given):
        raise call.error(f"has the bounds {low} and {high}, expected finite ones, the lower one first")
    return call.append(op.Clip(low, high), row, shape=row.shape)


def _softmax(call: Call) -> RowValue:
    """Read Softmax over all values, or over each group along an axis."""
    row, axis = call.row(), call.attributes.get("axis", -1)
    if not -len(row.shape) <= axis < len(row.shape):
        raise call.error(f"shares out axis {axis} of a value of shape {list(row.shape)}")
    if row.shape[axis] == row.width:
        return call.append(op.Softmax(), row, shape=row.shape)
    groups = np.moveaxis(row.places, axis, -1).reshape(-1, row.shape[axis])
    parts = [call.arranged(row, group) for group in groups]
    shares = [call.append(op.Softmax(), part, shape=part.shape) for part in parts]
    joined = call.append(op.Concat(), *shares, shape=(row.width,))
    return call.arranged(joined, np.argsort(groups.ravel()).reshape(row.shape))


def _norm(call: Call) -> tuple[Value, ...]:
    """Read LayerNormalization, and RMSNormalization, which has no offset."""
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
    kind = op.LayerNorm if call.operator == "LayerNormalization" else op.RmsNorm
    norm = call.append(kind(epsilon, rows[0], rows[1]), row, shape=row.shape)
    return norm, *(Unread(f"an inner value of {call.label}") for _ in range(call.outputs - 1))


def _batch_norm(call: Call) -> RowValue:
    """Read BatchNormalization in inference: an affine map of each value."""
    row = call.row()
    if call.attributes.get("training_mode", 0) or call.outputs > 1:
        raise call.error("is in training mode, expected inference; export after model.eval()")
    if len(row.shape) < 2 or row.shape[1] != row.width:
        raise call.error(f"takes a value of shape {list(row.shape)}, expected [1, n]")
    constants = [call.numbers(place) for place in (1, 2, 3, 4)]
    if any(values is None or values.shape != (row.width,) for values in constants):
        raise call.error(f"has constants of other shapes than [{row.width}]")
    scale, offset, mean, variance = (np.asarray(values, np.float64) for values in constants)
    spread = variance + call.attributes.get("epsilon", 1e-5)
    if not (spread > 0).all():
        raise call.error("has a variance that is not above 0")
    factor = scale / np.sqrt(spread)
    return arithmetic.mapped(call, row, factor, offset - mean * factor, row.shape)


def _dropout(call: Call) -> tuple[Value, ...]:
    training = call.constant(2)
    if training is not None and training.any():
        raise call.error("is in training mode, expected inference; export after model.eval()")
    return call.row(), Unread(f"the mask of {call.label}")


def _cast(call: Call) -> RowValue:
    kind = call.attributes.get("to", 0)
    if kind not in (TensorProto.FLOAT, TensorProto.DOUBLE):  # the policy computes in float32 all the same
        known = kind in TensorProto.DataType.values()
        name = TensorProto.DataType.Name(kind).lower() if known else str(kind)
        raise call.error(f"converts to {name}, expected float32; export in float32")
    value = call.input(0)
    return read_mask(call, value) if isinstance(value, Condition) else call.row()


def _concat(call: Call) -> RowValue:
    """Read Concat along any axis."""
    rows = [call.row(place) for place in range(len(call.inputs))]
    starts = np.cumsum([0, *(row.width for row in rows)])
    if starts[-1] > WIDTH_MAX:
        raise call.error(f"joins {starts[-1]} values, expected at most {WIDTH_MAX}")
    parts = [row.places + start for row, start in zip(rows, starts, strict=False)]
    places = apply(call, FOLDED["Concat"], parts)
    joined = call.append(op.Concat(), *rows, shape=(int(starts[-1]),)) if len(rows) > 1 else rows[0]
    assert not isinstance(places, tuple)
    return call.arranged(joined, places)


def _move(call: Call) -> Value | tuple[Value, ...]:
    """Read a node that only moves values: a renamed row if they stay in order, otherwise slices."""
    row = call.row()
    constants = [call.constant(place) for place in range(1, len(call.inputs))]
    moved = apply(call, MOVES[call.operator], [row.places, *constants])
    if isinstance(moved, tuple):
        return tuple(call.arranged(row, places) for places in moved)
    return call.arranged(row, moved)


OPERATORS: dict[str, Reader] = {
    **dict.fromkeys(MOVES, _move),
    **dict.fromkeys(("Add", "Sub", "Mul", "Div"), arithmetic.read_arithmetic),
    **dict.fromkeys(("Min", "Max"), _min_or_max),
    **dict.fromkeys(("Sum", "Mean"), arithmetic.read_sum),
    **CONDITIONS,
    "BatchNormalization": _batch_norm,
    "Cast": _cast,
    "Celu": activations.read_celu,
    "Clip": _clip,
    "Concat": _concat,
    "Conv": read_conv,
    "Dropout": _dropout,
    "Elu": _parameter(op.Elu, 1.0),
    "Erf": _activation(op.Erf()),
    "GRU": read_gru,
    "Gelu": activations.read_gelu,
    "Gemm": arithmetic.read_gemm,
    "HardSigmoid": activations.read_hard_sigmoid,
    "HardSwish": activations.read_hard_swish,
    "LSTM": read_lstm,
    "LayerNormalization": _norm,
    "LeakyRelu": _parameter(op.LeakyRelu, 0.01),
    "Log": activations.read_log,
    "MatMul": arithmetic.read_matmul,
    "Mish": activations.read_mish,
    "Neg": arithmetic.read_negative,
    "PRelu": activations.read_prelu,
    "Pow": activations.read_power,
    "RMSNormalization": _norm,
    "ReduceMean": arithmetic.read_reduction,
    "ReduceSum": arithmetic.read_reduction,
    "RNN": read_rnn,
    "Relu": _activation(op.Relu()),
    "Selu": activations.read_selu,
    "Sigmoid": _activation(op.Sigmoid()),
    "Softmax": _softmax,
    "Softplus": _activation(op.Softplus()),
    "Softsign": _activation(op.Softsign()),
    "Swish": activations.read_swish,
    "Tanh": _activation(op.Tanh()),
    "ThresholdedRelu": activations.read_thresholded,
    "Where": read_where,
}
COMPUTING = sorted(OPERATORS.keys() - MOVES.keys())
KNOWN = frozenset({*OPERATORS, *STARTS, *ONLY_INSIDE, *FOLDED, "Constant", "Shape"})
