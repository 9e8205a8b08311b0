"""The reader's view of ONNX values, and the network that grows from it.

An ONNX value of any rank is a row of float32 in C order, so that a reshape, a squeeze or a transpose that
leaves the order alone costs nothing, and whatever else moves values becomes slices.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray

from neuroflight.toolchain.errors import PolicyError
from neuroflight.toolchain.ir.float32 import Float32
from neuroflight.toolchain.ir.network import Node, multiply_adds, output_width
from neuroflight.toolchain.ir.operations import Concat, Operation, Slice

NODES_MAX = 1024  # a policy has some tens
WIDTH_MAX = 4096
MULTIPLY_ADDS_MAX = 216_000  # what 216 MHz does in 1 ms, the longest control period, at one a cycle
PIECES_MAX = 64  # slices that one node may cut its value into
NAME_MAX = 60  # characters of a name in a message
STANDARD_DOMAINS = ("", "ai.onnx")  # two spellings of one

Array = NDArray[Any]  # a constant: float32, float64, int64, int32 or bool


@dataclass(frozen=True)
class RowValue:
    """A value of the network: its number there and the shape that ONNX gives it, values in C order."""

    number: int
    shape: tuple[int, ...]

    @property
    def width(self) -> int:
        """Number of values."""
        return math.prod(self.shape)

    @property
    def places(self) -> NDArray[np.int64]:
        """The place of each value in the row, in the shape of the value."""
        return np.arange(self.width).reshape(self.shape)


@dataclass(frozen=True, eq=False)
class Part:
    """A value inside a pattern of nodes that makes one operation, such as the mean within a layer norm."""

    kind: str
    row: RowValue  # what the pattern works on
    label: str  # of the node that computes it
    epsilon: float = 0.0
    shape: tuple[int, ...] = ()  # that ONNX gives it, of a mean
    scale: Array | None = None  # of each value, that the pattern has multiplied in
    offset: Array | None = None  # likewise added


@dataclass(frozen=True)
class Condition:
    """A comparison of values: it holds where `row` is above 0, or, `negated`, where it is not."""

    row: RowValue
    negated: bool


@dataclass(frozen=True)
class Unread:
    """An output that the reader cannot compute, such as a Dropout's mask; an error only if it is used."""

    label: str
    error: PolicyError | None = None  # why it could not be read
    shape: tuple[int, ...] | None = None  # None if unknown


Value = Array | RowValue | Part | Condition | Unread


@dataclass
class Builder:
    """The network under construction."""

    inputs: int
    nodes: list[Node] = field(default_factory=list)
    widths: list[int] = field(default_factory=list)
    multiply_adds: int = 0
    multiply_adds_max: int = MULTIPLY_ADDS_MAX
    absorbed: set[int] = field(default_factory=set)  # values that an operation read later contains
    computed: dict[Part, RowValue] = field(default_factory=dict)  # parts that are used outside a pattern

    def __post_init__(self) -> None:
        """Begin with value 0, the observation."""
        self.widths.append(self.inputs)

    def operation(self, row: RowValue) -> Node | None:
        """Return the node that computes `row`, None for the observation."""
        return self.nodes[row.number - 1] if row.number else None


@dataclass(frozen=True, eq=False)
class Call:
    """One ONNX node, what it takes (None: an input that is left out), and the network that it adds to."""

    build: Builder
    operator: str
    name: str
    label: str  # for messages: name and operator
    names: tuple[str, ...]  # of the inputs
    inputs: tuple[Value | None, ...]
    attributes: Mapping[str, Any]
    outputs: int

    def input(self, place: int) -> Value | None:
        """Return input number `place`, None if the node leaves it out."""
        return self.inputs[place] if place < len(self.inputs) else None

    def numbers(self, place: int) -> NDArray[np.float64] | None:
        """Return the float constant at `place`. Raises PolicyError for other types, NaN or infinity."""
        values = self.constant(place)
        if values is not None and values.dtype == np.float64 and np.isfinite(values).all():
            return values
        given = self.floats(place)
        return None if given is None else given.astype(np.float64)

    def row(self, place: int = 0) -> RowValue:
        """Return the computed value at input `place`. Raises PolicyError for a constant there."""
        value = self.input(place)
        if isinstance(value, RowValue):
            return value
        raise self.error(f"takes a constant as input {place}, expected a value computed from the observation")

    def constant(self, place: int) -> Array | None:
        """Return the constant at input `place`, of any type. Raises PolicyError for a computed value."""
        value = self.input(place)
        if value is None or isinstance(value, np.ndarray):
            return value
        raise self.error(f"takes {shown(self.names[place])} where a constant is expected")

    def floats(self, place: int) -> Float32 | None:
        """Return the constant at `place` in float32. Raises PolicyError for another type, NaN or infinity."""
        values = self.constant(place)
        if values is None:
            return None
        if values.dtype == np.float64:
            with np.errstate(over="ignore"):
                values = values.astype(np.float32)
        if values.dtype != np.float32:
            raise self.error(f"takes {shown(self.names[place])} of type {values.dtype}, expected float32")
        if bad := int((~np.isfinite(values)).sum()):
            raise self.error(
                f"takes {shown(self.names[place])}, which holds {bad} NaN or infinite values, expected finite"
            )
        return values

    def scalar(self, place: int) -> float | None:
        """Return the one value at `place`, which may be repeated, in float32. Infinity is allowed."""
        values = self.constant(place)
        if values is None:
            return None
        if values.dtype == np.float64:
            with np.errstate(over="ignore"):
                values = values.astype(np.float32)
        if values.dtype != np.float32 or values.size == 0 or not (values == values.flat[0]).all():
            kind = f"{values.dtype} {list(values.shape)}"
            raise self.error(f"takes {shown(self.names[place])} of {kind}, expected one float32 value")
        return float(values.flat[0])

    def error(self, message: str) -> PolicyError:
        """Return a refusal that names the node."""
        return PolicyError(f"{self.label} {message}")

    def append(self, operation: Operation, *rows: RowValue, shape: tuple[int, ...]) -> RowValue:
        """Append `operation` on `rows`, which the node computes; return its result of `shape`."""
        self.afford(multiply_adds(operation))
        self.build.multiply_adds += multiply_adds(operation)
        if len(self.build.nodes) >= NODES_MAX:
            raise self.error(f"is one too many: a policy may have {NODES_MAX} operations")
        width = output_width(operation, [self.build.widths[row.number] for row in rows])
        if width != math.prod(shape) or width > WIDTH_MAX:
            raise self.error(f"gives {width} values of shape {list(shape)}, expected at most {WIDTH_MAX}")
        self.build.nodes.append(Node(operation, tuple(row.number for row in rows), self.name))
        self.build.widths.append(width)
        return RowValue(len(self.build.nodes), shape)

    def afford(self, more: int) -> None:
        """Raise PolicyError where `more` multiply-adds are too many."""
        total, most = self.build.multiply_adds + more, self.build.multiply_adds_max
        if total > most:
            raise self.error(
                f"brings the policy to {total} multiply-adds, expected at most {most}: what the processor "
                "does in a millisecond; train a smaller network"
            )

    def arranged(self, row: RowValue, places: NDArray[np.int64]) -> RowValue:
        """Return the value whose item i is item places[i] of `row`, by slices unless nothing moves."""
        shape, flat = places.shape, places.ravel()
        if flat.size == 0 or flat.size > WIDTH_MAX:
            raise self.error(f"gives {flat.size} values, expected 1 to {WIDTH_MAX}")
        if np.array_equal(flat, np.arange(row.width)):
            return RowValue(row.number, shape)
        slices = _slices(flat)
        if len(slices) > PIECES_MAX:
            raise self.error(
                f"cuts its value into {len(slices)} pieces, expected at most {PIECES_MAX}; "
                "sort the weights before or after it instead"
            )
        pieces = [self.append(piece, row, shape=(piece.count,)) for piece in slices]
        if len(pieces) == 1:
            return RowValue(pieces[0].number, shape)
        return self.append(Concat(), *pieces, shape=shape)

    def broadcast(self, row: RowValue, shape: tuple[int, ...]) -> RowValue:
        """Repeat `row` along the axes where `shape` is larger, as ONNX's arithmetic does."""
        if math.prod(shape) > WIDTH_MAX:
            raise self.error(f"gives values of shape {list(shape)}, expected at most {WIDTH_MAX}")
        return self.arranged(row, np.broadcast_to(row.places, shape))


def joint_shape(call: Call, *shapes: tuple[int, ...]) -> tuple[int, ...]:
    """Return the shape that ONNX's arithmetic gives values of `shapes`."""
    try:
        return np.broadcast_shapes(*shapes)
    except ValueError as error:
        listed = " and ".join(str(list(shape)) for shape in shapes)
        raise call.error(f"joins values of shapes {listed}, which do not fit each other") from error


def shown(name: str) -> str:
    """Quote a name for messages: one line, not too long."""
    return repr(name if len(name) <= NAME_MAX else name[: NAME_MAX - 3] + "...")


def printable(name: str) -> str:
    """Replace characters of a name that may not stand in a table or a C comment."""
    return "".join(c if c.isalnum() or c in "/._:-" else "_" for c in name[:NAME_MAX])


def label(node: onnx.NodeProto) -> str:
    """Format a node's name and operator."""
    operator = node.op_type if node.domain in STANDARD_DOMAINS else f"{node.domain}::{node.op_type}"
    operator = operator if operator.isprintable() and len(operator) <= NAME_MAX else shown(operator)
    return f"node {shown(node.name or ', '.join(node.output))} ({operator})"


def _slices(flat: NDArray[np.int64]) -> list[Slice]:
    """Return slices, chosen greedily, that give the places `flat` one after the other."""
    slices, start = list[Slice](), 0
    while start < flat.size:
        step = int(flat[start + 1] - flat[start]) if start + 1 < flat.size else 0
        count = 1
        while step and start + count < flat.size and flat[start + count] - flat[start + count - 1] == step:
            count += 1
        slices.append(Slice(int(flat[start]), count, step or 1))
        start += count
    return slices
