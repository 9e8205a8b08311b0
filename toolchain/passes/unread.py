"""The pass that drops what cannot reach the output: nodes, and single elements of values."""

from __future__ import annotations

from collections.abc import Sequence
from typing import assert_never

import numpy as np
from numpy.typing import NDArray

from neuroflight.toolchain.ir import operations as op
from neuroflight.toolchain.ir.network import OBSERVATION, Network, Node, sweep

Mask = NDArray[np.bool_]  # (n,): which elements of a value are kept


def drop_unread(network: Network) -> Network:
    """Drop nodes, and rows of matrices, that cannot reach the output.

    An element counts as read unless every weight applied to it is exactly 0. The observation keeps its width;
    recurrent cells, norms and Softmax keep all their elements.
    """
    network = sweep(network)
    kept = kept_elements(network)
    if all(mask.all() for mask in kept):
        return network
    nodes, renamed = list[Node](), {OBSERVATION: OBSERVATION}
    for number, node in enumerate(network.nodes, 1):
        if kept[number].any():
            inputs = node.inputs
            if isinstance(node.operation, op.Concat):
                parts = _parts(kept[number], [kept[value].size for value in inputs])
                inputs = tuple(value for value, part in zip(inputs, parts, strict=True) if part.any())
            operation = _cut(node.operation, kept[number], kept[inputs[0]])
            nodes.append(Node(operation, tuple(renamed[value] for value in inputs), node.name))
            renamed[number] = len(nodes)
    return Network(network.inputs, tuple(nodes))


def kept_elements(network: Network) -> list[Mask]:
    """Return, for every value, the elements that something reads; masks of elementwise operations agree."""
    kept: list[Mask] = [np.zeros(width, np.bool_) for width in network.widths]
    kept[OBSERVATION][:] = True
    kept[-1][:] = True
    backwards, before = range(len(network.nodes), 0, -1), -1
    while (now := sum(int(mask.sum()) for mask in kept)) != before:
        before = now
        for number in (*backwards, *reversed(backwards)):
            node = network.nodes[number - 1]
            _mark(node.operation, kept[number], [kept[value] for value in node.inputs])
    return kept


def _mark(operation: op.Operation, result: Mask, taken: Sequence[Mask]) -> None:
    """Mark the elements of `taken` that `result` needs, and those of `result` that have to stay with them."""
    if not result.any():
        return
    if isinstance(operation, op.Elementwise):
        for mask in taken:
            result |= mask
        for mask in taken:
            mask |= result
        return
    match operation:
        case op.Linear(weight, _):
            taken[0] |= (weight[result] != 0).any(axis=0)
            taken[0][0] |= not taken[0].any()  # a value has at least one element
        case op.Gru() | op.Lstm() | op.LayerNorm() | op.RmsNorm() | op.Softmax():
            result[:] = True
            taken[0][:] = True
        case op.Concat():
            for mask, part in zip(taken, _parts(result, [mask.size for mask in taken]), strict=True):
                if part.any():
                    mask |= part
                    part |= mask
        case op.Slice():
            _mark_slice(operation, result, taken[0])
        case never:
            assert_never(never)


def _parts(result: Mask, widths: Sequence[int]) -> list[Mask]:
    """Split the mask of a Concat into its parts; they are views: writing to one writes to `result`."""
    return np.split(result, np.cumsum(widths)[:-1])


def _mark_slice(cut: op.Slice, result: Mask, taken: Mask) -> None:
    places = cut.start + cut.step * np.arange(cut.count)
    taken[places[result]] = True
    if _progression(cut, result, taken) is None:
        result[:] = True
        taken[:] = True


def _progression(cut: op.Slice, result: Mask, taken: Mask) -> op.Slice | None:
    """Return the slice that takes the kept elements of `result` from those `taken`, None if there is none."""
    places = cut.start + cut.step * np.arange(cut.count)
    new = (np.cumsum(taken) - 1)[places[result]]
    steps = np.unique(np.diff(new))
    if steps.size > 1:
        return None
    return op.Slice(int(new[0]), int(new.size), int(steps[0]) if steps.size else 1)


def _cut(operation: op.Operation, result: Mask, taken: Mask) -> op.Operation:
    """Reduce `operation` to the kept elements."""
    match operation:
        case op.Linear(weight, bias):
            return op.Linear(np.ascontiguousarray(weight[result][:, taken]), bias[result])
        case op.Affine(scale, offset):
            return op.Affine(scale[result], offset[result])
        case op.Slice():
            cut = _progression(operation, result, taken)
            assert cut is not None
            return cut
    return operation
