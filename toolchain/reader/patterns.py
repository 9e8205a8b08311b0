"""Patterns of nodes that make one operation: what exporters write where an older opset lacks the operator.

    Softsign    x / (1 + |x|)
    LayerNorm   (x - mean) / sqrt(mean((x - mean)^2) + epsilon), scale and offset as arithmetic after it

A value inside a pattern is a `Part`; each rule below takes parts to the next part or to the operation.
"""

from __future__ import annotations

import numpy as np

from toolchain.ir.operations import LayerNorm, Softsign
from toolchain.reader.values import Array, Builder, Call, Part, Row, Value

ABSOLUTE, ABSOLUTE_AND_ONE = "|x|", "1 + |x|"
MEAN, DISTANCE, SQUARE, VARIANCE = "the mean", "x - mean", "(x - mean)^2", "the variance"
VARIANCE_AND_EPSILON, DEVIATION, INVERSE = "variance + epsilon", "the deviation", "1 / deviation"
STARTS = ("Abs", "ReduceMean")  # operators that only begin a pattern
ONLY_INSIDE = ("Pow", "Sqrt", "Reciprocal")


def read_part(build: Builder, call: Call) -> Value:
    """The next part, or the operation that the pattern makes. Raises PolicyError where no rule applies."""
    match call.operator, *call.inputs:
        case "Abs", Row() as row:
            return Part(ABSOLUTE, row, call.label)
        case ("Add", Part(kind=kind) as part, np.ndarray() as constant) | (
            "Add",
            np.ndarray() as constant,
            Part(kind=kind) as part,
        ) if (value := _scalar(constant)) is not None:
            if kind == ABSOLUTE and value == 1:
                return Part(ABSOLUTE_AND_ONE, part.row, call.label)
            if kind == VARIANCE and value > 0:
                return Part(VARIANCE_AND_EPSILON, part.row, call.label, value)
        case "Div", Row() as row, Part(kind=kind, row=same) if (kind, row) == (ABSOLUTE_AND_ONE, same):
            return build.append(call, Softsign(), row, shape=row.shape)
        case "ReduceMean", Row() as row, *_ if _over_all(call, row):
            return Part(MEAN, row, call.label)
        case "ReduceMean", Part(kind=kind, row=row), *_ if kind == SQUARE and _over_all(call, row):
            return Part(VARIANCE, row, call.label)
        case "Sub", Row() as row, Part(kind=kind, row=same) if (kind, row) == (MEAN, same):
            return Part(DISTANCE, row, call.label)
        case "Pow", Part(kind=kind, row=row), np.ndarray() as power if kind == DISTANCE:
            if _scalar(power) == 2:
                return Part(SQUARE, row, call.label)
        case "Sqrt", Part(kind=kind) as part if kind == VARIANCE_AND_EPSILON:
            return Part(DEVIATION, part.row, call.label, part.epsilon)
        case "Reciprocal", Part(kind=kind) as part if kind == DEVIATION:
            return Part(INVERSE, part.row, call.label, part.epsilon)
        case ("Mul" | "Div") as operator, Part() as first, Part() as second if first.row == second.row:
            kinds = {first.kind, second.kind}
            if operator == "Mul" and kinds == {DISTANCE}:
                return Part(SQUARE, first.row, call.label)
            ends = (operator, first.kind, second.kind) == ("Div", DISTANCE, DEVIATION)
            if ends or (operator == "Mul" and kinds == {DISTANCE, INVERSE}):
                return _layer_norm(build, call, first.row, max(first.epsilon, second.epsilon))
    raise call.error(
        f"takes {_listed(call)}: parts of no pattern that is known, which are x / (1 + |x|) and "
        "(x - mean) / sqrt(variance + epsilon) over all values of a row"
    )


def _layer_norm(build: Builder, call: Call, row: Row, epsilon: float) -> Row:
    one, zero = np.ones(row.width, np.float32), np.zeros(row.width, np.float32)
    return build.append(call, LayerNorm(epsilon, one, zero), row, shape=row.shape)


def _over_all(call: Call, row: Row) -> bool:
    """Whether a ReduceMean takes the mean of all values of `row`."""
    given = call.constant(1)  # from opset 18 on the axes are an input
    axes = call.attributes.get("axes") if given is None else [int(axis) for axis in given.ravel()]
    if not axes:
        return not call.attributes.get("noop_with_empty_axes", 0)
    reduced = {axis + len(row.shape) if axis < 0 else axis for axis in axes}
    return all(size == 1 or axis in reduced for axis, size in enumerate(row.shape))


def _scalar(values: Array) -> float | None:
    return float(values.flat[0]) if values.size == 1 else None


def _listed(call: Call) -> str:
    kinds = {Row: "a value", np.ndarray: "a constant"}
    words = [v.kind if isinstance(v, Part) else kinds.get(type(v), "nothing") for v in call.inputs]
    return " and ".join(words)
