"""One reader for each ONNX operator: what a node that takes computed values adds to the network."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from onnx import TensorProto

from neuroflight.toolchain.ir.operations import (
    Add,
    Clip,
    Concat,
    Elu,
    Erf,
    LayerNorm,
    LeakyRelu,
    Operation,
    Relu,
    RmsNorm,
    Select,
    Sigmoid,
    Softmax,
    Softplus,
    Softsign,
    Tanh,
)
from neuroflight.toolchain.reader.activations import (
    read_celu,
    read_gelu,
    read_hard_sigmoid,
    read_hard_swish,
    read_log,
    read_mish,
    read_power,
    read_prelu,
    read_selu,
    read_swish,
    read_thresholded,
)
from neuroflight.toolchain.reader.arithmetic import (
    constant_row,
    mapped,
    read_arithmetic,
    read_gemm,
    read_matmul,
    read_negative,
    read_reduction,
    read_sum,
)
from neuroflight.toolchain.reader.conditions import CONDITIONS, read_mask, read_where
from neuroflight.toolchain.reader.constants import FOLDED, MOVES, apply
from neuroflight.toolchain.reader.convolution import read_conv
from neuroflight.toolchain.reader.patterns import ONLY_INSIDE, STARTS
from neuroflight.toolchain.reader.recurrent import read_gru, read_lstm, read_rnn
from neuroflight.toolchain.reader.values import (
    WIDTH_MAX,
    Builder,
    Call,
    Condition,
    RowValue,
    Unread,
    Value,
    joint_shape,
)

Reader = Callable[[Builder, Call], Value | tuple[Value, ...]]


def _activation(operation: Operation) -> Reader:
    def read(build: Builder, call: Call) -> RowValue:
        return build.append(call, operation, call.row(), shape=call.row().shape)

    return read


def _parameter(make: Callable[[float], Operation], default: float) -> Reader:
    def read(build: Builder, call: Call) -> RowValue:
        alpha = call.attributes.get("alpha", default)
        if not math.isfinite(alpha):
            raise call.error(f"has alpha {alpha}, expected a finite number")
        return build.append(call, make(alpha), call.row(), shape=call.row().shape)

    return read


def _clip(build: Builder, call: Call) -> RowValue:
    return _clipped(build, call, call.row(), call.scalar(1), call.scalar(2))


def _min_or_max(build: Builder, call: Call) -> RowValue:
    """Read Min and Max: with one number a Clip with one bound, of two values or many numbers a Select."""
    places = [place for place, value in enumerate(call.inputs) if isinstance(value, RowValue)]
    if len(call.inputs) != 2:
        raise call.error(f"takes {len(call.inputs)} values, expected two")
    if len(places) == 2:
        shape = joint_shape(call, call.row(0).shape, call.row(1).shape)
        first, second = (build.broadcast(call, call.row(place), shape) for place in (0, 1))
        negative = mapped(build, call, second, -1.0, 0.0, shape)
        above = build.append(call, Add(), first, negative, shape=shape)
        ordered = (first, second) if call.operator == "Max" else (second, first)
        return build.append(call, Select(), above, *ordered, shape=shape)
    row, constant = call.row(places[0]), call.constant(1 - places[0])
    assert constant is not None
    row = build.broadcast(call, row, shape := joint_shape(call, row.shape, constant.shape))
    if np.unique(constant).size > 1:
        bounds = call.numbers(1 - places[0])
        assert bounds is not None
        return _bounded_each(build, call, row, np.broadcast_to(bounds, shape).ravel())
    bound = call.scalar(1 - places[0])
    low, high = (None, bound) if call.operator == "Min" else (bound, None)
    return _clipped(build, call, row, low, high)


def _bounded_each(build: Builder, call: Call, row: RowValue, bounds: NDArray[np.float64]) -> RowValue:
    """Read Min or Max with a bound of its own for each value, such as limits of each motor."""
    bounds = bounds.astype(np.float32).astype(np.float64)
    held = constant_row(build, call, row, bounds)
    above = mapped(build, call, row, 1.0, -bounds, row.shape)
    ordered = (row, held) if call.operator == "Max" else (held, row)
    return build.append(call, Select(), above, *ordered, shape=row.shape)


def _clipped(build: Builder, call: Call, row: RowValue, low: float | None, high: float | None) -> RowValue:
    low = None if low == -math.inf else low
    high = None if high == math.inf else high
    given = [bound for bound in (low, high) if bound is not None]
    if not all(map(math.isfinite, given)) or given != sorted(given):
        raise call.error(f"has the bounds {low} and {high}, expected finite ones, the lower one first")
    return build.append(call, Clip(low, high), row, shape=row.shape)


def _softmax(build: Builder, call: Call) -> RowValue:
    """Read Softmax over all values, or over each group along an axis."""
    row, axis = call.row(), call.attributes.get("axis", -1)
    if not -len(row.shape) <= axis < len(row.shape):
        raise call.error(f"shares out axis {axis} of a value of shape {list(row.shape)}")
    if row.shape[axis] == row.width:
        return build.append(call, Softmax(), row, shape=row.shape)
    groups = np.moveaxis(row.places, axis, -1).reshape(-1, row.shape[axis])
    parts = [build.arranged(call, row, group) for group in groups]
    shares = [build.append(call, Softmax(), part, shape=part.shape) for part in parts]
    joined = build.append(call, Concat(), *shares, shape=(row.width,))
    return build.arranged(call, joined, np.argsort(groups.ravel()).reshape(row.shape))


def _norm(build: Builder, call: Call) -> tuple[Value, ...]:
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
    kind = LayerNorm if call.operator == "LayerNormalization" else RmsNorm
    norm = build.append(call, kind(epsilon, rows[0], rows[1]), row, shape=row.shape)
    return norm, *(Unread(f"an inner value of {call.label}") for _ in range(call.outputs - 1))


def _batch_norm(build: Builder, call: Call) -> RowValue:
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
    return mapped(build, call, row, factor, offset - mean * factor, row.shape)


def _dropout(build: Builder, call: Call) -> tuple[Value, ...]:
    training = call.constant(2)
    if training is not None and training.any():
        raise call.error("is in training mode, expected inference; export after model.eval()")
    return call.row(), Unread(f"the mask of {call.label}")


def _cast(build: Builder, call: Call) -> RowValue:
    kind = call.attributes.get("to", 0)
    if kind not in (TensorProto.FLOAT, TensorProto.DOUBLE):  # the policy computes in float32 all the same
        known = kind in TensorProto.DataType.values()
        name = TensorProto.DataType.Name(kind).lower() if known else str(kind)
        raise call.error(f"converts to {name}, expected float32; export in float32")
    value = call.input(0)
    return read_mask(build, call, value) if isinstance(value, Condition) else call.row()


def _concat(build: Builder, call: Call) -> RowValue:
    """Read Concat along any axis."""
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
    """Read a node that only moves values: a renamed row if they stay in order, otherwise slices."""
    row = call.row()
    constants = [call.constant(place) for place in range(1, len(call.inputs))]
    moved = apply(call, MOVES[call.operator], [row.places, *constants])
    if isinstance(moved, tuple):
        return tuple(build.arranged(call, row, places) for places in moved)
    return build.arranged(call, row, moved)


OPERATORS: dict[str, Reader] = {
    **dict.fromkeys(MOVES, _move),
    **dict.fromkeys(("Add", "Sub", "Mul", "Div"), read_arithmetic),
    **dict.fromkeys(("Min", "Max"), _min_or_max),
    **dict.fromkeys(("Sum", "Mean"), read_sum),
    **CONDITIONS,
    "BatchNormalization": _batch_norm,
    "Cast": _cast,
    "Celu": read_celu,
    "Clip": _clip,
    "Concat": _concat,
    "Conv": read_conv,
    "Dropout": _dropout,
    "Elu": _parameter(Elu, 1.0),
    "Erf": _activation(Erf()),
    "GRU": read_gru,
    "Gelu": read_gelu,
    "Gemm": read_gemm,
    "HardSigmoid": read_hard_sigmoid,
    "HardSwish": read_hard_swish,
    "LSTM": read_lstm,
    "LayerNormalization": _norm,
    "LeakyRelu": _parameter(LeakyRelu, 0.01),
    "Log": read_log,
    "MatMul": read_matmul,
    "Mish": read_mish,
    "Neg": read_negative,
    "PRelu": read_prelu,
    "Pow": read_power,
    "RMSNormalization": _norm,
    "ReduceMean": read_reduction,
    "ReduceSum": read_reduction,
    "RNN": read_rnn,
    "Relu": _activation(Relu()),
    "Selu": read_selu,
    "Sigmoid": _activation(Sigmoid()),
    "Softmax": _softmax,
    "Softplus": _activation(Softplus()),
    "Softsign": _activation(Softsign()),
    "Swish": read_swish,
    "Tanh": _activation(Tanh()),
    "ThresholdedRelu": read_thresholded,
    "Where": read_where,
}
COMPUTING = sorted(OPERATORS.keys() - MOVES.keys())
KNOWN = frozenset({*OPERATORS, *STARTS, *ONLY_INSIDE, *FOLDED, "Constant", "Shape"})
