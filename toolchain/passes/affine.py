"""Passes that fold affine maps: into each other, into matrices, and through Concat and Slice between."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from neuroflight.toolchain.errors import PolicyError
from neuroflight.toolchain.ir import operations as op
from neuroflight.toolchain.ir.float32 import Float32
from neuroflight.toolchain.ir.network import Network, Node
from neuroflight.toolchain.passes.rewrite import Draft, absorbed, rewrite


def merge_affine(network: Network) -> Network:
    """Join two consecutive affine maps into one."""

    def rule(draft: Draft, node: Node, _number: int) -> Node | None:
        match node, draft.sole(node.inputs[0]):
            case Node(operation=op.Affine() as second), Node(operation=op.Affine() as first) as before:
                return Node(_before(second, first), before.inputs, node.name)
        return None

    return rewrite(network, rule)


def fold_affine(network: Network) -> Network:
    """Move affine maps into the weights of the linear layers, recurrent cells and norms beside them.

    A map moves into the layers that follow it only if all its readers are such layers, so that it vanishes.
    """
    vanishes = absorbed(network)

    def rule(draft: Draft, node: Node, _number: int) -> Node | None:
        taken = node.inputs[0]
        match node.operation, draft.producer(taken):
            case op.Linear() | op.Gru() | op.Lstm(), Node(operation=op.Affine() as first) as before:
                if all(vanishes[role] for role in draft.roles[taken]):
                    return Node(_before(node.operation, first), before.inputs, node.name)
            case op.Affine() as second, Node() as before if isinstance(
                before.operation, op.Linear | op.Norm
            ) and draft.sole(taken):
                return replace(before, operation=_after(before.operation, second))
        return None

    return rewrite(network, rule)


def move_affine(network: Network) -> Network:
    """Move affine maps through Concat and Slice to layers that can absorb them."""
    vanishes = absorbed(network)

    def movable(draft: Draft, value: int) -> Node | None:
        before = draft.producer(value)
        if before is None or not isinstance(before.operation, op.Affine):
            return None
        return before if all(vanishes[role] for role in draft.roles[value]) else None

    def rule(draft: Draft, node: Node, number: int) -> Node | None:
        match node.operation:
            case op.Slice() as cut:
                before = movable(draft, node.inputs[0]) or draft.sole(node.inputs[0])
                if before is not None and isinstance(first := before.operation, op.Affine):
                    taken = [cut.start + cut.step * place for place in range(cut.count)]
                    part = draft.add(cut, before.inputs, node.name)
                    return Node(op.Affine(first.scale[taken], first.offset[taken]), (part,), before.name)
            case op.Concat() if vanishes[number]:
                parts = [movable(draft, value) for value in node.inputs]
                if any(parts):
                    return _below_concat(draft, node, parts)
            case op.Affine() as second:
                before = draft.sole(node.inputs[0])
                if before is not None and isinstance(before.operation, op.Concat):
                    return _above_concat(draft, node, before, second)
        return None

    return rewrite(network, rule)


def lower_sigmoid(network: Network) -> Network:
    """Replace a sigmoid between matrices by 1/2 + 1/2 tanh(x/2), whose affine maps they absorb.

    With a matrix on one side only, the map that stays would cost more bytes than the other saves time.
    """
    vanishes = absorbed(network)

    def rule(draft: Draft, node: Node, number: int) -> Node | None:
        match node.operation, draft.sole(node.inputs[0]):
            case op.Sigmoid(), Node(operation=op.Linear() | op.Affine() | op.LayerNorm() | op.RmsNorm()) if (
                vanishes[number]
            ):
                half = np.full(draft.widths[node.inputs[0]], 0.5)
                below = draft.add(op.Affine(half, 0 * half), node.inputs, node.name)
                return Node(op.Affine(half, half), (draft.add(op.Tanh(), (below,), node.name),), node.name)
        return None

    return rewrite(network, rule)


def input_matrix(operation: op.Operation) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Return weight and bias that `operation` first applies to its input; None if it has none."""
    match operation:
        case op.Linear():
            weight, bias = operation.weight, operation.bias
        case op.Gru():
            weight, bias = operation.input_weight, operation.input_bias
        case op.Lstm():
            weight, bias = operation.input_weight, operation.bias
        case _:
            return None
    return weight.astype(np.float64), bias.astype(np.float64)


def with_input(
    operation: op.Operation, weight: NDArray[np.float64], bias: NDArray[np.float64]
) -> op.Operation:
    """Return `operation` with another input matrix. Raises PolicyError as `rounded` does."""
    match operation:
        case op.Linear():
            return op.Linear(rounded(weight), rounded(bias))
        case op.Gru():
            return replace(operation, input_weight=rounded(weight), input_bias=rounded(bias))
        case op.Lstm():
            return replace(operation, input_weight=rounded(weight), bias=rounded(bias))
    raise TypeError(f"{operation} has no matrix for its input")


def rounded(values: NDArray[np.float64]) -> Float32:
    """Round `values` to float32. Raises PolicyError if they leave its range."""
    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        result = values.astype(np.float32)
    if not np.isfinite(result).all():
        raise PolicyError(
            f"folding the policy's constants gives {values[~np.isfinite(result)].flat[0]:.3g}, "
            "expected values of float32's range; scale the observation less"
        )
    return result


def _before(second: op.Operation, first: op.Affine) -> op.Operation:
    """Join an affine map of x and then `second` into one operation of x."""
    with np.errstate(over="ignore", invalid="ignore"):
        if isinstance(second, op.Affine):
            return op.Affine(second.scale * first.scale, second.scale * first.offset + second.offset)
        if (matrix := input_matrix(second)) is None:
            raise TypeError(f"{second} takes no affine map before it")
        weight, bias = matrix
        return with_input(second, weight * first.scale, weight @ first.offset + bias)


def _after(first: op.Operation, second: op.Affine) -> op.Operation:
    """Join `first` of x and then an affine map into one operation of x."""
    with np.errstate(over="ignore", invalid="ignore"):
        match first:
            case op.Linear(weight, bias):
                bias64 = bias * second.scale + second.offset
                return op.Linear(rounded(weight * second.scale[:, None]), rounded(bias64))
            case op.LayerNorm(epsilon, scale, offset) | op.RmsNorm(epsilon, scale, offset):
                offset64 = offset * second.scale + second.offset
                return type(first)(epsilon, rounded(scale * second.scale), rounded(offset64))
    raise TypeError(f"{first} takes no affine map after it")


def _below_concat(draft: Draft, node: Node, parts: Sequence[Node | None]) -> Node:
    """Replace a Concat of affine maps by one affine map of the Concat of their inputs."""
    values, maps = [], []
    for value, part in zip(node.inputs, parts, strict=True):
        width = draft.widths[value]
        if part is not None and isinstance(part.operation, op.Affine):
            values.append(part.inputs[0])
            maps.append(part.operation)
        else:
            values.append(value)
            maps.append(op.Affine(np.ones(width), np.zeros(width)))
    scale, offset = (np.concatenate([getattr(m, name) for m in maps]) for name in ("scale", "offset"))
    return Node(op.Affine(scale, offset), (draft.add(node.operation, values, node.name),))


def _above_concat(draft: Draft, node: Node, before: Node, second: op.Affine) -> Node | None:
    """Replace an affine map of a Concat by a Concat of maps of its parts, if each part absorbs its map."""
    parts = [draft.sole(value) for value in before.inputs]
    if not all(part and isinstance(part.operation, op.Linear | op.Norm | op.Affine) for part in parts):
        return None
    values, first = [], 0
    for value in before.inputs:
        end = first + draft.widths[value]
        part_of_map = op.Affine(second.scale[first:end], second.offset[first:end])
        values.append(draft.add(part_of_map, (value,), node.name))
        first = end
    return Node(before.operation, tuple(values), before.name)
