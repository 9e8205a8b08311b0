"""Folds the part of a graph that depends on no observation: shapes, axes, slices, zero states.

A short list of operators, each a few lines of numpy. Those of `MOVES` only move values about; the reader
applies them to a constant or to the places of a computed value alike.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, numpy_helper

from neuroflight.toolchain.errors import PolicyError
from neuroflight.toolchain.reader.values import Array, Call, RowValue, Unread

ELEMENTS_MAX = 1 << 18  # of a folded constant: more than a policy has weights
TYPES: dict[int, type[np.generic]] = {
    TensorProto.FLOAT: np.float32,
    TensorProto.DOUBLE: np.float64,  # of normalizers; what is computed from them is float32
    TensorProto.INT64: np.int64,
    TensorProto.INT32: np.int32,
    TensorProto.BOOL: np.bool_,
}
CONSTANT_STATE = (
    "a recurrent cell exported with a constant state forgets at every step: use torch.nn.GRU or LSTM, whose "
    "state the compiled policy carries"
)
Attributes = Mapping[str, Any]  # of the node, and its number of `outputs`
Move = Callable[[Sequence[Any], Attributes], Array | tuple[Array, ...]]


def array(tensor: onnx.TensorProto, label: str) -> Array:
    """Return the values of a tensor, which the checks found to be of a known type and in the file itself."""
    try:
        return np.asarray(numpy_helper.to_array(tensor), TYPES[tensor.data_type])
    except (ValueError, TypeError, KeyError) as error:
        raise PolicyError(f"{label} does not hold the values of its shape: {error}") from error


def fold(call: Call) -> Array | tuple[Array, ...]:
    """Compute a node of constants. Raises PolicyError if its operator is not in the list."""
    if call.operator == "Shape":
        value = call.input(0)
        shape = value.shape if isinstance(value, RowValue | Unread | np.ndarray) else None
        if shape is None:
            raise call.error("asks for the shape of a value whose shape is not known")
        end = call.attributes.get("end")
        return np.array(shape[call.attributes.get("start", 0) : end], np.int64)
    function = FOLDED.get(call.operator)
    if function is None and call.operator in ("Gemm", "MatMul"):
        raise call.error(f"multiplies constants only; {CONSTANT_STATE}")
    if function is None:
        raise call.error("computes from constants only, which is not supported; export with constants folded")
    return apply(call, function, call.inputs)


def apply(call: Call, function: Move, inputs: Sequence[Any]) -> Array | tuple[Array, ...]:
    """Apply `function` to `inputs`; numpy's errors about shapes and indices become refusals."""
    try:
        with np.errstate(all="ignore"):
            return function(inputs, {**call.attributes, "outputs": call.outputs})
    except (ValueError, IndexError, TypeError, OverflowError, ZeroDivisionError) as error:
        first = str(error).partition("\n")[0]
        raise call.error(f"does not fit the values it takes: {first}") from error


def _bounded(shape: Sequence[int]) -> tuple[int, ...]:
    """Return `shape`; raise ValueError before too much memory is allocated for it."""
    if any(size < 0 for size in shape) or math.prod(shape) > ELEMENTS_MAX:
        raise ValueError(f"shape {list(shape)}, expected at most {ELEMENTS_MAX} values")
    return tuple(shape)


def _integers(values: Array | None) -> list[int] | None:
    if values is None:
        return None
    if values.dtype.kind != "i":
        raise TypeError(f"{values.dtype} where integers are expected")
    return [int(value) for value in values.ravel()]


def _reshape(inputs: Sequence[Any], attributes: Attributes) -> Array:
    data, wanted = inputs[0], _integers(inputs[1]) or []
    if not attributes.get("allowzero", 0):
        wanted = [data.shape[axis] if size == 0 else size for axis, size in enumerate(wanted)]
    if min(wanted, default=0) < -1:
        raise ValueError(f"shape {wanted}")  # numpy takes any negative size for an unknown one
    return np.reshape(data, wanted)


def _flatten(inputs: Sequence[Any], attributes: Attributes) -> Array:
    data, axis = inputs[0], attributes.get("axis", 1)
    if not -data.ndim <= axis <= data.ndim:
        raise ValueError(f"axis {axis} of {data.ndim}")
    axis = axis + data.ndim if axis < 0 else axis
    return np.reshape(data, (math.prod(data.shape[:axis]), math.prod(data.shape[axis:])))


def _squeeze(inputs: Sequence[Any], _: Attributes) -> Array:
    axes = _integers(inputs[1]) if len(inputs) > 1 else None
    squeezed: Array = np.squeeze(inputs[0], None if axes is None else tuple(axes))
    return squeezed


def _unsqueeze(inputs: Sequence[Any], _: Attributes) -> Array:
    return np.expand_dims(inputs[0], tuple(_integers(inputs[1]) or ()))


def _transpose(inputs: Sequence[Any], attributes: Attributes) -> Array:
    return np.transpose(inputs[0], attributes.get("perm"))


def _expand(inputs: Sequence[Any], _: Attributes) -> Array:
    shape = np.broadcast_shapes(inputs[0].shape, tuple(_integers(inputs[1]) or ()))
    return np.broadcast_to(inputs[0], _bounded(shape))


def _gather(inputs: Sequence[Any], attributes: Attributes) -> Array:
    data, places, axis = inputs[0], inputs[1], attributes.get("axis", 0)
    rest = data.size // max(data.shape[axis], 1)
    _bounded([rest, places.size])
    return np.asarray(np.take(data, places, axis))


def _gather_nd(inputs: Sequence[Any], attributes: Attributes) -> Array:
    data, places = inputs[0], inputs[1]
    if attributes.get("batch_dims", 0):
        raise ValueError("batch_dims, expected 0")
    _bounded([places[..., 0].size, *data.shape[places.shape[-1] :]])
    return np.asarray(data[tuple(np.moveaxis(places, -1, 0))])


def _slice(inputs: Sequence[Any], _: Attributes) -> Array:
    data, starts, ends = inputs[0], _integers(inputs[1]) or [], _integers(inputs[2]) or []
    axes = _integers(inputs[3]) if len(inputs) > 3 else None
    steps = _integers(inputs[4]) if len(inputs) > 4 else None
    cut = [slice(None)] * data.ndim
    axes, steps = axes or list(range(len(starts))), steps or [1] * len(starts)
    if not len(starts) == len(ends) == len(axes) == len(steps):
        raise ValueError("starts, ends, axes and steps of different lengths")
    for start, end, axis, step in zip(starts, ends, axes, steps, strict=True):
        size = data.shape[axis]
        # a negative bound counts from the end once; one beyond it stays at the edge
        first = max(start + size, 0) if start < 0 else start
        last = end + size if end < 0 else end
        cut[axis] = slice(first, None if step < 0 and last < 0 else max(last, 0), step)
    result: Array = data[tuple(cut)]
    return result


def _split(inputs: Sequence[Any], attributes: Attributes) -> tuple[Array, ...]:
    data, axis = inputs[0], attributes.get("axis", 0)
    sizes = _integers(inputs[1]) if len(inputs) > 1 else None
    if sizes is None:
        count = attributes["outputs"]
        if attributes.get("num_outputs", count) != count:
            raise ValueError(f"num_outputs {attributes['num_outputs']} of {count} outputs")
        size = -(-data.shape[axis] // count)
        sizes = [size] * (count - 1) + [data.shape[axis] - size * (count - 1)]
    if sum(sizes) != data.shape[axis] or min(sizes) < 1 or len(sizes) != attributes["outputs"]:
        raise ValueError(f"{sizes} of {data.shape[axis]} values")
    return tuple(np.split(data, np.cumsum(sizes)[:-1], axis))


def _identity(inputs: Sequence[Any], _: Attributes) -> Array:
    data: Array = inputs[0]
    return data


MOVES: dict[str, Move] = {
    "Expand": _expand,
    "Flatten": _flatten,
    "Gather": _gather,
    "GatherND": _gather_nd,
    "Identity": _identity,
    "Reshape": _reshape,
    "Slice": _slice,
    "Split": _split,
    "Squeeze": _squeeze,
    "Transpose": _transpose,
    "Unsqueeze": _unsqueeze,
}


def _constant_of_shape(inputs: Sequence[Any], attributes: Attributes) -> Array:
    value = attributes.get("value")
    filling = np.zeros(1, np.float32) if value is None else array(value, "its value")
    return np.broadcast_to(filling.reshape(()), _bounded(_integers(inputs[0]) or []))


def _cast(inputs: Sequence[Any], attributes: Attributes) -> Array:
    if attributes["to"] not in TYPES:
        raise TypeError("a type that no policy needs")
    data: Array = inputs[0]
    return data.astype(TYPES[attributes["to"]])


def _concat(inputs: Sequence[Any], attributes: Attributes) -> Array:
    _bounded([sum(value.size for value in inputs)])
    return np.concatenate(inputs, attributes["axis"])


def _range(inputs: Sequence[Any], _: Attributes) -> Array:
    start, limit, delta = (value.reshape(()).item() for value in inputs)
    _bounded([max(math.ceil((limit - start) / delta), 0)])
    return np.arange(start, limit, delta, dtype=inputs[0].dtype)


def _divide(inputs: Sequence[Any], _: Attributes) -> Array:
    first, second = inputs
    if first.dtype.kind == "f":
        return np.asarray(first / second)
    if not second.all():
        raise ZeroDivisionError("an integer by zero")
    return np.asarray(np.sign(first) * np.sign(second) * (np.abs(first) // np.abs(second)), first.dtype)


def _elementwise(function: Callable[..., Any]) -> Move:
    def apply(inputs: Sequence[Any], _: Attributes) -> Array:
        _bounded(np.broadcast_shapes(*(value.shape for value in inputs)))
        return np.asarray(function(*inputs))

    return apply


FOLDED: dict[str, Move] = MOVES | {
    "Abs": _elementwise(np.abs),
    "Add": _elementwise(np.add),
    "Cast": _cast,
    "Concat": _concat,
    "ConstantOfShape": _constant_of_shape,
    "Div": _divide,
    "Equal": _elementwise(np.equal),
    "Exp": _elementwise(np.exp),
    "Mul": _elementwise(np.multiply),
    "Neg": _elementwise(np.negative),
    "Pow": _elementwise(np.power),
    "Range": _range,
    "Reciprocal": _elementwise(np.reciprocal),
    "Sqrt": _elementwise(np.sqrt),
    "Sub": _elementwise(np.subtract),
    "Where": _elementwise(np.where),
}
