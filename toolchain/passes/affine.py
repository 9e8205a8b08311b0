"""Passes that fold affine maps: into each other, into matrices, and through Concat and Slice between."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from neuroflight.toolchain.errors import PolicyError
from neuroflight.toolchain.ir.float32 import Float32
from neuroflight.toolchain.ir.network import Network, Node
from neuroflight.toolchain.ir.operations import (
    Affine,
    Concat,
    Gru,
    LayerNorm,
    Linear,
    Lstm,
    Norm,
    Operation,
    RmsNorm,
    Sigmoid,
    Slice,
    Tanh,
)
from neuroflight.toolchain.passes.rewrite import Draft, absorbed, rewrite


def merge_affine(network: Network) -> Network:
    """Join two consecutive affine maps into one."""

    def rule(draft: Draft, node: Node, _number: int) -> Node | None:
        match node, draft.sole(node.inputs[0]):
            case Node(operation=Affine() as second), Node(operation=Affine() as first) as before:
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
            case Linear() | Gru() | Lstm(), Node(operation=Affine() as first) as before:
                if all(vanishes[role] for role in draft.roles[taken]):
                    return Node(_before(node.operation, first), before.inputs, node.name)
            case Affine() as second, Node() as before if isinstance(
                before.operation, Linear | Norm
            ) and draft.sole(taken):
                return replace(before, operation=_after(before.operation, second))
        return None

    return rewrite(network, rule)


def move_affine(network: Network) -> Network:
    """Move affine maps through Concat and Slice to layers that can absorb them."""
    vanishes = absorbed(network)

    def movable(draft: Draft, value: int) -> Node | None:
        before = draft.producer(value)
        if before is None or not isinstance(before.operation, Affine):
            return None
        return before if all(vanishes[role] for role in draft.roles[value]) else None

    def rule(draft: Draft, node: Node, number: int) -> Node | None:
        match node.operation:
            case Slice() as cut:
                before = movable(draft, node.inputs[0]) or draft.sole(node.inputs[0])
                if before is not None and isinstance(first := before.operation, Affine):
                    taken = [cut.start + cut.step * place for place in range(cut.count)]
                    part = draft.add(cut, before.inputs, node.name)
                    return Node(Affine(first.scale[taken], first.offset[taken]), (part,), before.name)
            case Concat() if vanishes[number]:
                parts = [movable(draft, value) for value in node.inputs]
                if any(parts):
                    return _below_concat(draft, node, parts)
            case Affine() as second:
                before = draft.sole(node.inputs[0])
                if before is not None and isinstance(before.operation, Concat):
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
            case Sigmoid(), Node(operation=Linear() | Affine() | LayerNorm() | RmsNorm()) if vanishes[number]:
                half = np.full(draft.widths[node.inputs[0]], 0.5)
                below = draft.add(Affine(half, 0 * half), node.inputs, node.name)
                return Node(Affine(half, half), (draft.add(Tanh(), (below,), node.name),), node.name)
        return None

    return rewrite(network, rule)


def input_matrix(operation: Operation) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Return weight and bias that `operation` first applies to its input; None if it has none."""
    match operation:
        case Linear():
            weight, bias = operation.weight, operation.bias
        case Gru():
            weight, bias = operation.input_weight, operation.input_bias
        case Lstm():
            weight, bias = operation.input_weight, operation.bias
        case _:
            return None
    return weight.astype(np.float64), bias.astype(np.float64)


def with_input(operation: Operation, weight: NDArray[np.float64], bias: NDArray[np.float64]) -> Operation:
    """Return `operation` with another input matrix. Raises PolicyError as `rounded` does."""
    match operation:
        case Linear():
            return Linear(rounded(weight), rounded(bias))
        case Gru():
            return replace(operation, input_weight=rounded(weight), input_bias=rounded(bias))
        case Lstm():
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


def _before(second: Operation, first: Affine) -> Operation:
    """Join an affine map of x and then `second` into one operation of x."""
    with np.errstate(over="ignore", invalid="ignore"):
        if isinstance(second, Affine):
            return Affine(second.scale * first.scale, second.scale * first.offset + second.offset)
        if (matrix := input_matrix(second)) is None:
            raise TypeError(f"{second} takes no affine map before it")
        weight, bias = matrix
        return with_input(second, weight * first.scale, weight @ first.offset + bias)


def _after(first: Operation, second: Affine) -> Operation:
    """Join `first` of x and then an affine map into one operation of x."""
    with np.errstate(over="ignore", invalid="ignore"):
        match first:
            case Linear(weight, bias):
                bias64 = bias * second.scale + second.offset
                return Linear(rounded(weight * second.scale[:, None]), rounded(bias64))
            case LayerNorm(epsilon, scale, offset) | RmsNorm(epsilon, scale, offset):
                offset64 = offset * second.scale + second.offset
                return type(first)(epsilon, rounded(scale * second.scale), rounded(offset64))
    raise TypeError(f"{first} takes no affine map after it")


def _below_concat(draft: Draft, node: Node, parts: Sequence[Node | None]) -> Node:
    """Replace a Concat of affine maps by one affine map of the Concat of their inputs."""
    values, maps = [], []
    for value, part in zip(node.inputs, parts, strict=True):
        width = draft.widths[value]
        if part is not None and isinstance(part.operation, Affine):
            values.append(part.inputs[0])
            maps.append(part.operation)
        else:
            values.append(value)
            maps.append(Affine(np.ones(width), np.zeros(width)))
    scale, offset = (np.concatenate([getattr(m, name) for m in maps]) for name in ("scale", "offset"))
    return Node(Affine(scale, offset), (draft.add(node.operation, values, node.name),))


def _above_concat(draft: Draft, node: Node, before: Node, second: Affine) -> Node | None:
    """Replace an affine map of a Concat by a Concat of maps of its parts, if each part absorbs its map."""
    parts = [draft.sole(value) for value in before.inputs]
    if not all(part and isinstance(part.operation, Linear | Norm | Affine) for part in parts):
        return None
    values, first = [], 0
    for value in before.inputs:
        end = first + draft.widths[value]
        part_of_map = Affine(second.scale[first:end], second.offset[first:end])
        values.append(draft.add(part_of_map, (value,), node.name))
        first = end
    return Node(before.operation, tuple(values), before.name)
