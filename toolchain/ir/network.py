"""A policy's network as a typed graph: nodes in order of computation, each naming the values it takes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, assert_never

import numpy as np
from numpy.typing import NDArray

from neuroflight.toolchain.ir import operations as op

OBSERVATION = 0  # the number of the first value


@dataclass(frozen=True, eq=False)
class Node:
    """One operation. Value 0 is the observation, value i + 1 the result of node i."""

    operation: op.Operation
    inputs: tuple[int, ...]  # numbers of earlier values
    name: str = ""  # of the ONNX node it comes from, for people


@dataclass(frozen=True, eq=False)
class Network:
    """A pure function of one observation (and of the recurrent state): the last node gives the action."""

    inputs: int  # width of the observation
    nodes: tuple[Node, ...]

    def __post_init__(self) -> None:
        """Raise ValueError for a node that takes a later value or values whose widths do not fit."""
        for index, node in enumerate(self.nodes):
            if not all(0 <= value <= index for value in node.inputs):
                raise ValueError(f"node {index} takes the values {node.inputs}")
        _ = self.widths

    @cached_property
    def widths(self) -> tuple[int, ...]:
        """Width of every value, the observation's first."""
        widths = [self.inputs]
        for node in self.nodes:
            widths.append(output_width(node.operation, [widths[value] for value in node.inputs]))
        return tuple(widths)

    @property
    def outputs(self) -> int:
        """Width of the action."""
        return self.widths[-1]

    @property
    def recurrent(self) -> bool:
        """True if an action depends on earlier observations."""
        return any(isinstance(node.operation, op.Recurrent) for node in self.nodes)

    @property
    def multiply_adds(self) -> int:
        """Multiply-accumulates of the matrices in one evaluation: what no compiler can save."""
        return sum(multiply_adds(node.operation) for node in self.nodes)

    @property
    def text(self) -> str:
        """The network in a few characters: `6-64-64-4 tanh`."""
        widths, hidden = [str(self.inputs)], set()
        for node in self.nodes[:-1]:
            match node.operation:
                case op.Linear() as layer:
                    widths.append(str(layer.outputs))
                case op.Gru() | op.Lstm() as cell:
                    widths.append(f"{type(cell).__name__.lower()}{cell.units}")
                case op.Affine() | op.Concat() | op.Slice():
                    pass
                case other:
                    hidden.add(type(other).__name__.lower())
        return " ".join(["-".join(widths), *sorted(hidden)])


def chain(inputs: int, operations: Iterable[op.Operation]) -> Network:
    """Return the network in which every operation takes the value before it."""
    return Network(inputs, tuple(Node(each, (index,)) for index, each in enumerate(operations)))


def output_width(operation: op.Operation, widths: Sequence[int]) -> int:
    """Return the width of the result of `operation`. Raises ValueError if `widths` do not fit it."""
    same = widths[0] if widths else 0
    if isinstance(operation, op.Activation):
        expected, result = [same], same
    else:
        match operation:
            case op.Add() | op.Multiply():
                expected, result = [same, same], same
            case op.Softmax():
                expected, result = [same], same
            case op.Select():
                expected, result = [same, same, same], same
            case op.Affine() | op.LayerNorm() | op.RmsNorm():
                expected, result = [operation.scale.size], operation.scale.size
            case op.Linear():
                expected, result = [operation.inputs], operation.outputs
            case op.Gru() | op.Lstm():
                expected, result = [int(operation.input_weight.shape[1])], operation.units
            case op.Concat():
                expected, result = list(widths), sum(widths)
            case op.Slice(start, count, step):
                last = start + (count - 1) * step
                if count < 1 or step == 0 or not (0 <= start < same and 0 <= last < same):
                    raise ValueError(f"{operation} of {same} values")
                expected, result = [same], count
            case never:
                assert_never(never)
    if list(widths) != expected:
        raise ValueError(f"{type(operation).__name__} takes values of widths {expected}, got {list(widths)}")
    return result


def multiply_adds(operation: op.Operation) -> int:
    """Count the multiply-accumulates of the operation's matrices."""
    return sum(array.size for array in arrays(operation) if array.ndim == 2)


def arrays(operation: op.Operation) -> list[NDArray[np.floating[Any]]]:
    """List the operation's constants that are arrays."""
    return [value for value in vars(operation).values() if isinstance(value, np.ndarray)]


def sweep(network: Network) -> Network:
    """Return `network` without nodes that do not reach its last one; the same object if there are none."""
    uses = use_counts(network)
    kept = [number for number in range(1, len(uses)) if uses[number]]
    if len(kept) == len(network.nodes):
        return network
    renamed = {OBSERVATION: OBSERVATION} | {number: place for place, number in enumerate(kept, 1)}
    nodes = (network.nodes[number - 1] for number in kept)
    return Network(
        network.inputs,
        tuple(replace(node, inputs=tuple(renamed[value] for value in node.inputs)) for node in nodes),
    )


def use_counts(network: Network) -> list[int]:
    """Return how many inputs of nodes that reach the last one take each value; 1 for the last."""
    uses = [0] * (len(network.nodes) + 1)
    uses[-1] = 1
    for number in range(len(network.nodes), 0, -1):
        if uses[number]:
            for value in network.nodes[number - 1].inputs:
                uses[value] += 1
    return uses
