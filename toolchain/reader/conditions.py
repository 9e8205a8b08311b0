"""Readers of comparisons, and of Where, which chooses between two values by one.

A comparison is kept as the value that is above 0 where it holds, or, negated, where it does not.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from neuroflight.toolchain.ir.operations import Add, Affine, Operation, Select, Softplus
from neuroflight.toolchain.reader.arithmetic import constant_row, mapped
from neuroflight.toolchain.reader.values import Array, Call, Condition, RowValue, Value, joint_shape

# Above it log(1 + e^x) rounds to x: the difference e^-16 is 1 / 9 of a float32's last place at 16.
SOFTPLUS_STRAIGHT = 16.0


def read_where(call: Call) -> RowValue:
    """Read Where on a comparison."""
    condition = call.input(0)
    if isinstance(condition, np.ndarray) and condition.dtype == np.bool_:
        return _mixed(call, condition)
    if not isinstance(condition, Condition):
        raise call.error("chooses by what is no comparison of values, which is not supported")
    chosen = [call.input(1), call.input(2)]
    first, second = reversed(chosen) if condition.negated else chosen
    if (row := _softplus(call, condition, first, second)) is not None:
        return row
    shapes = [value.shape for value in (first, second) if isinstance(value, RowValue | np.ndarray)]
    shape = joint_shape(call, condition.row.shape, *shapes)
    rows = [call.broadcast(condition.row, shape)]
    rows += [_row(call, value, rows[0], shape) for value in (first, second)]
    return call.append(Select(), *rows, shape=shape)


def _mixed(call: Call, chosen: Array) -> RowValue:
    """Read Where with a constant condition: the sum of each side times 1 where it is chosen, else 0."""
    values = (call.input(1), call.input(2))
    like = next(value for value in values if isinstance(value, RowValue))
    shape = joint_shape(
        call, chosen.shape, *(v.shape for v in values if isinstance(v, RowValue | np.ndarray))
    )
    like = call.broadcast(like, shape)
    taken = np.broadcast_to(chosen, shape).ravel().astype(np.float64)
    if (taken == taken[0]).all():
        return _row(call, values[0] if taken[0] else values[1], like, shape)
    first, second = (_row(call, value, like, shape) for value in values)
    parts = (mapped(call, row, kept, 0.0, shape) for row, kept in ((first, taken), (second, 1 - taken)))
    return call.append(Add(), *parts, shape=shape)


def read_mask(call: Call, condition: Condition) -> RowValue:
    """Read a Cast of a comparison to float32: 1 where it holds, else 0."""
    row = condition.row
    first, second = (0.0, 1.0) if condition.negated else (1.0, 0.0)
    constants = (constant_row(call, row, np.full(row.width, value)) for value in (first, second))
    return call.append(Select(), row, *constants, shape=row.shape)


def _row(call: Call, value: Value | None, like: RowValue, shape: tuple[int, ...]) -> RowValue:
    """Return a value or constant that Where takes, as a value of `shape`."""
    if isinstance(value, RowValue):
        return call.broadcast(value, shape)
    if not isinstance(value, np.ndarray) or value.dtype.kind != "f" or not np.isfinite(value).all():
        raise call.error("chooses between others than values and finite float32 constants")
    return constant_row(call, like, np.broadcast_to(value, shape).ravel().astype(np.float64))


def _softplus(call: Call, condition: Condition, first: Value | None, second: Value | None) -> RowValue | None:
    """Return log(1 + e^x) of `x where x > 20, else log(1 + e^x)`, as torch's exporter writes it."""
    match first, second:
        case RowValue() as x, RowValue() as soft if (node := call.build.operation(soft)) is not None:
            compared = call.build.operation(condition.row)
            straight = (
                node.operation == Softplus()
                and node.inputs == (x.number,)
                and compared is not None
                and compared.inputs == (x.number,)
                and _least(compared.operation) >= SOFTPLUS_STRAIGHT
            )
            return soft if straight and x.shape == soft.shape else None
    return None


def _least(operation: Operation) -> float:
    """Return the smallest x for which `operation`, x - bound, is positive; -inf for any other operation."""
    match operation:
        case Affine(scale, offset) if (scale == 1).all():
            return float(-offset.max())
    return -np.inf


def _above(call: Call, places: tuple[int, int], negated: bool) -> Condition:
    """Return the condition that the first of two inputs exceeds the second, as their difference."""
    first, second = (call.input(place) for place in places)
    match first, second:
        case RowValue(), RowValue():
            shape = joint_shape(call, first.shape, second.shape)
            rows = [call.broadcast(row, shape) for row in (first, second)]
            less = mapped(call, rows[1], -1.0, 0.0, shape)
            return Condition(call.append(Add(), rows[0], less, shape=shape), negated)
        case RowValue() as row, np.ndarray():
            return Condition(_moved(call, row, places[1], 1.0), negated)
        case np.ndarray(), RowValue() as row:
            return Condition(_moved(call, row, places[0], -1.0), negated)
    raise call.error("compares others than values and constants")


def _moved(call: Call, row: RowValue, place: int, sign: float) -> RowValue:
    """Append `sign` (row - the constant at `place`)."""
    bound: Array | None = call.floats(place)
    assert bound is not None
    shape = joint_shape(call, row.shape, bound.shape)
    row = call.broadcast(row, shape)
    if sign == 1 and not bound.any():
        return row
    offset = -sign * np.broadcast_to(bound, shape).ravel().astype(np.float64)
    return mapped(call, row, sign, offset, shape)


def _read_not(call: Call) -> Condition:
    condition = call.input(0)
    if not isinstance(condition, Condition):
        raise call.error("negates what is no comparison of values, which is not supported")
    return Condition(condition.row, not condition.negated)


CONDITIONS: dict[str, Callable[[Call], Condition]] = {
    "Greater": partial(_above, places=(0, 1), negated=False),
    "GreaterOrEqual": partial(_above, places=(1, 0), negated=True),
    "Less": partial(_above, places=(1, 0), negated=False),
    "LessOrEqual": partial(_above, places=(0, 1), negated=True),
    "Not": _read_not,
}
