"""Patterns of nodes that make one operation: what exporters write where an older opset lacks the operator.

    Softsign    x / (1 + |x|)
    LayerNorm   (x - mean) / sqrt(mean((x - mean)^2) + epsilon), scale and offset as arithmetic after it
                x i - mean i + offset with i = scale / deviation, as TensorFlow has it
                with mean(x^2) - mean^2 for the variance, as Flax has it
    RMSNorm     x / sqrt(mean(x^2) + epsilon), likewise

A value inside a pattern is a `Part`; each rule below takes parts to the next part or to the operation. A part
that the rules do not lead on is computed after all, if operations for it are known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from neuroflight.toolchain.ir.operations import LayerNorm, Multiply, Norm, RmsNorm, Select, Softsign
from neuroflight.toolchain.reader.arithmetic import Float64, linear, mapped, reduced_axes
from neuroflight.toolchain.reader.values import Array, Call, Part, RowValue, Value

ABSOLUTE, ABSOLUTE_AND_ONE = "|x|", "1 + |x|"
MEAN, DISTANCE, SQUARE, VARIANCE = "the mean", "x - mean", "(x - mean)^2", "the variance"
VARIANCE_AND_EPSILON, DEVIATION, INVERSE = "variance + epsilon", "the deviation", "1 / deviation"
MEAN_SQUARE, SQUARE_AND_EPSILON = "the mean of x^2", "mean of x^2 + epsilon"
ROOT, INVERSE_ROOT = "the root of the mean of x^2", "1 / that root"
MEAN_SQUARED, NEGATIVE_MEAN = "mean^2", "-mean"
SCALED, MEAN_SCALED, SHIFT = "x / deviation", "mean / deviation", "-mean / deviation"
WITH_EPSILON = {VARIANCE: VARIANCE_AND_EPSILON, MEAN_SQUARE: SQUARE_AND_EPSILON}
ROOTS = {VARIANCE_AND_EPSILON: DEVIATION, SQUARE_AND_EPSILON: ROOT}
INVERSES = {DEVIATION: INVERSE, ROOT: INVERSE_ROOT}
# Parts that may be values of their own.
COMPUTED = (ABSOLUTE, MEAN, DISTANCE, MEAN_SQUARE, MEAN_SQUARED, NEGATIVE_MEAN)
STARTS = ("Abs", "ReduceMean")  # operators that may begin a pattern
ONLY_INSIDE = ("Sqrt", "Reciprocal")


def read_pattern(call: Call) -> Value | None:
    """Return the next part of a pattern, or the finished operation; None where no rule applies.

    A part may be the input of another pattern, as in the norm of |x|: then it is computed first.
    """
    part = _next(call)
    if part is None and any(isinstance(value, Part) and value.kind in COMPUTED for value in call.inputs):
        part = _next(_with_values(call))
    return part


def computed(call: Call) -> Call:
    """Return `call` with its parts as computed values. Raises PolicyError for parts with no meaning alone."""
    call = _with_values(call)
    if any(isinstance(value, Part) for value in call.inputs):
        raise call.error(
            f"takes {_listed(call)}: parts of no pattern that is known, which are x / (1 + |x|), "
            "(x - mean) / sqrt(variance + epsilon) and x / sqrt(mean(x^2) + epsilon) over all values of a row"
        )
    return call


def _next(call: Call) -> Value | None:
    match call.operator, *_ordered(call):
        case "Abs", RowValue() as row:
            return Part(ABSOLUTE, row, call.label)
        case "Add", Part(kind=kind) as part, np.ndarray() as more if kind == SHIFT and _fits(part, more):
            offset = more if part.offset is None else part.offset + more
            return replace(part, label=call.label, offset=offset)
        case "Add", Part(kind=kind) as part, np.ndarray() as constant if (
            value := _scalar(constant)
        ) is not None:
            if kind == ABSOLUTE and value == 1:
                return Part(ABSOLUTE_AND_ONE, part.row, call.label)
            if kind in WITH_EPSILON and value > 0:
                return Part(WITH_EPSILON[kind], part.row, call.label, value)
        case "Div", RowValue() as row, Part(kind=kind, row=same) if (kind, row) == (ABSOLUTE_AND_ONE, same):
            return call.append(Softsign(), row, shape=row.shape)
        case "ReduceMean", RowValue() as row, *_ if _over_all(call, row):
            if (squared := _squared(call, row)) is not None:
                return Part(MEAN_SQUARE, squared, call.label, shape=_mean_shape(call, row))
            return Part(MEAN, row, call.label, shape=_mean_shape(call, row))
        case "ReduceMean", Part(kind=kind, row=row), *_ if kind == SQUARE and _over_all(call, row):
            return Part(VARIANCE, row, call.label)
        case "Sub", RowValue() as row, Part(kind=kind, row=same) if (kind, row) == (MEAN, same):
            return Part(DISTANCE, row, call.label)
        case "Pow", Part(kind=kind, row=row) as part, np.ndarray() as power:
            if kind in (DISTANCE, MEAN) and _scalar(power) == 2:
                return replace(part, kind=SQUARE if kind == DISTANCE else MEAN_SQUARED, label=call.label)
            if kind in ROOTS and _scalar(power) in (0.5, -0.5):
                root = ROOTS[kind] if _scalar(power) == 0.5 else INVERSES[ROOTS[kind]]
                return Part(root, row, call.label, part.epsilon)
        case "Sqrt", Part(kind=kind) as part if kind in ROOTS:
            return Part(ROOTS[kind], part.row, call.label, part.epsilon)
        case "Reciprocal", Part(kind=kind) as part if kind in INVERSES:
            return Part(INVERSES[kind], part.row, call.label, part.epsilon)
        case "Div", np.ndarray() as one, Part(kind=kind) as part if kind in INVERSES and _scalar(one) == 1:
            return Part(INVERSES[kind], part.row, call.label, part.epsilon)
        case (("Div" | "Mul"), RowValue() as row, Part(row=same) as part) if row == same:
            return _of_row(call, part)
        case "Mul", Part() as part, np.ndarray() as values:
            if part.kind in (INVERSE, INVERSE_ROOT) and _fits(part, values):
                return replace(
                    part, label=call.label, scale=values if part.scale is None else part.scale * values
                )
        case "Neg", Part(kind=kind) as part if kind == MEAN:
            return replace(part, kind=NEGATIVE_MEAN, label=call.label)
        case "Sub", np.ndarray() as values, Part(kind=kind) as part if kind == MEAN_SCALED and _fits(
            part, values
        ):
            return replace(part, kind=SHIFT, label=call.label, offset=values)
        case "Max", Part(kind=kind) as part, np.ndarray() as bound if (
            kind == VARIANCE and _scalar(bound) == 0
        ):
            return part
        case ("Add" | "Sub") as operator, Part() as first, Part() as second if first.row == second.row:
            order = first.kind, second.kind
            if (operator, *order) == ("Sub", MEAN_SQUARE, MEAN_SQUARED):
                return Part(VARIANCE, first.row, call.label)
            first, second = (first, second) if first.kind == SCALED else (second, first)
            ends = second.kind == (SHIFT if operator == "Add" else MEAN_SCALED) and order[0] != MEAN_SCALED
            if first.kind == SCALED and ends and np.array_equal(_factors(first), _factors(second)):
                return _norm(call, LayerNorm, replace(second, scale=first.scale))
        case ("Mul" | "Div") as operator, Part() as first, Part() as second if first.row == second.row:
            kinds = {first.kind, second.kind}
            if operator == "Mul" and kinds == {DISTANCE}:
                return Part(SQUARE, first.row, call.label)
            if operator == "Mul" and kinds == {MEAN}:
                return replace(first, kind=MEAN_SQUARED, label=call.label)
            inner, outer = (first, second) if second.kind in (DEVIATION, INVERSE) else (second, first)
            if (operator, inner.kind, second.kind) == ("Div", DISTANCE, DEVIATION) or (
                operator == "Mul" and kinds == {DISTANCE, INVERSE}
            ):
                return _norm(call, LayerNorm, outer)
            if operator == "Mul" and outer.kind == INVERSE and inner.kind in (MEAN, NEGATIVE_MEAN):
                return replace(outer, kind=MEAN_SCALED if inner.kind == MEAN else SHIFT, label=call.label)
    return None


def _ordered(call: Call) -> Sequence[Value | None]:
    """Return the inputs; where their order says nothing, values, then parts, then constants."""
    if call.operator not in ("Add", "Mul", "Max"):
        return call.inputs
    return sorted(call.inputs, key=lambda value: isinstance(value, Part) + 2 * isinstance(value, np.ndarray))


def _with_values(call: Call) -> Call:
    """Return `call` with those parts that are operations of their own as values, each computed once."""
    inputs = []
    for value in call.inputs:
        if isinstance(value, Part) and value.kind in COMPUTED:
            if value not in call.build.computed:
                call.build.computed[value] = _computed(call, value)
            value = call.build.computed[value]
        inputs.append(value)
    return replace(call, inputs=tuple(inputs))


def _computed(call: Call, part: Part) -> RowValue:
    row, width = part.row, part.row.width
    if part.kind == ABSOLUTE:
        negative = mapped(call, row, -1.0, 0.0, row.shape)
        return call.append(Select(), row, row, negative, shape=row.shape)
    if part.kind == DISTANCE:
        return linear(call, row, np.eye(width) - 1 / width, np.zeros(width), row.shape)
    if part.kind == MEAN_SQUARE:
        row = call.append(Multiply(), row, row, shape=row.shape)
    weight = np.full((1, width), (-1 if part.kind == NEGATIVE_MEAN else 1) / width)
    mean = linear(call, row, weight, np.zeros(1), part.shape)
    if part.kind == MEAN_SQUARED:
        return call.append(Multiply(), mean, mean, shape=part.shape)
    return mean


def _of_row(call: Call, part: Part) -> Value | None:
    """Divide or multiply a row by a part that was computed from this row."""
    if (call.operator, part.kind) in (("Div", ROOT), ("Mul", INVERSE_ROOT)):
        return _norm(call, RmsNorm, part)
    if (call.operator, part.kind) == ("Mul", INVERSE):
        return replace(part, kind=SCALED, label=call.label)
    return None


def _norm(call: Call, kind: type[Norm], part: Part) -> RowValue:
    """Append the norm of a part's row, with the scale and offset that the part has collected."""
    row, one, zero = part.row, np.ones(part.row.width, np.float32), np.zeros(part.row.width, np.float32)
    norm = call.append(kind(part.epsilon, one, zero), row, shape=row.shape)
    if part.scale is None and part.offset is None:
        return norm
    offset = np.zeros(row.width) if part.offset is None else np.broadcast_to(part.offset, row.shape).ravel()
    return mapped(call, norm, _factors(part), offset.astype(np.float64), row.shape)


def _factors(part: Part) -> Float64:
    scale = np.ones(()) if part.scale is None else part.scale
    return np.broadcast_to(scale, part.row.shape).ravel().astype(np.float64)


def _fits(part: Part, values: Array) -> bool:
    """Return True if `values` are finite and broadcast to the part's row."""
    shape = part.row.shape
    fits = values.ndim <= len(shape) and all(
        size in (1, full) for size, full in zip(values.shape[::-1], shape[::-1], strict=False)
    )
    return fits and values.dtype.kind == "f" and bool(np.isfinite(values).all())


def _squared(call: Call, row: RowValue) -> RowValue | None:
    """Return x if `row` is x * x; else None."""
    node = call.build.operation(row)
    if node is None or node.operation != Multiply() or len(set(node.inputs)) != 1:
        return None
    return RowValue(node.inputs[0], row.shape)


def _mean_shape(call: Call, row: RowValue) -> tuple[int, ...]:
    axes = reduced_axes(call, row)
    if call.attributes.get("keepdims", 1):
        return (1,) * len(row.shape)
    return tuple(size for axis, size in enumerate(row.shape) if axis not in axes)


def _over_all(call: Call, row: RowValue) -> bool:
    """Return True if a ReduceMean takes the mean of all values of `row`."""
    axes = reduced_axes(call, row)
    return all(size == 1 or axis in axes for axis, size in enumerate(row.shape))


def _scalar(values: Array) -> float | None:
    return float(values.flat[0]) if values.size == 1 else None


def _listed(call: Call) -> str:
    kinds = {RowValue: "a value", np.ndarray: "a constant"}
    words = [v.kind if isinstance(v, Part) else kinds.get(type(v), "nothing") for v in call.inputs]
    return " and ".join(words)
