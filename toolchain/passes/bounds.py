"""Passes that use the range of each value: bounds that cannot bind go, values that cannot vary are folded."""

from __future__ import annotations

import numpy as np

from neuroflight.toolchain.ir.intervals import clip_bounds, value_intervals
from neuroflight.toolchain.ir.network import Network, Node
from neuroflight.toolchain.ir.operations import Clip, Elu, LeakyRelu, Relu
from neuroflight.toolchain.passes.affine import input_matrix, with_input
from neuroflight.toolchain.passes.rewrite import Draft, rewrite


def drop_bounds(network: Network) -> Network:
    """Drop a Clip, ReLU, LeakyReLU or ELU that cannot bind; join two consecutive bounds."""
    intervals = value_intervals(network)

    def rule(draft: Draft, node: Node, number: int) -> Node | int | None:
        last = number == len(network.nodes)
        low, high = intervals[draft.roles[node.inputs[0]][0]]
        match node.operation:
            case Relu() | LeakyRelu() | Elu() if (low >= 0).all():
                return node.inputs[0]
            case Relu() | Clip():
                bounds = clip_bounds(node.operation)
                before = draft.sole(node.inputs[0])
                if before is not None and isinstance(before.operation, Relu | Clip):
                    joined = _join(clip_bounds(before.operation), bounds)
                    # The last Clip's lower bound is also what a NaN gives: it stays as it is.
                    if not last or joined[0] == bounds[0]:
                        return Node(_bound(*joined), before.inputs, node.name)
                if last:
                    return None
                free_low, free_high = (low >= bounds[0]).all(), (high <= bounds[1]).all()
                if free_low and free_high:
                    return node.inputs[0]
                kept = (-np.inf if free_low else bounds[0], np.inf if free_high else bounds[1])
                if kept != bounds:
                    return Node(_bound(*kept), node.inputs, node.name)
        return None

    return rewrite(network, rule)


def fold_constants(network: Network) -> Network:
    """Move inputs of a matrix that no observation changes into its bias; their weight becomes 0."""
    intervals = value_intervals(network)

    def rule(draft: Draft, node: Node, _number: int) -> Node | None:
        if (matrix := input_matrix(node.operation)) is None:
            return None
        weight, bias = matrix
        low, high = intervals[draft.roles[node.inputs[0]][0]]
        constant = (low == high) & np.isfinite(low) & weight.any(axis=0)
        if not constant.any():
            return None
        folded = bias + weight[:, constant] @ low[constant]
        return Node(with_input(node.operation, np.where(constant, 0, weight), folded), node.inputs, node.name)

    return rewrite(network, rule)


def _bound(low: float, high: float) -> Clip | Relu:
    if (low, high) == (0, np.inf):
        return Relu()
    return Clip(None if low == -np.inf else low, None if high == np.inf else high)


def _join(first: tuple[float, float], second: tuple[float, float]) -> tuple[float, float]:
    """Return the bounds that do the work of two: the first's, bounded by the second."""
    low, high = (min(max(bound, second[0]), second[1]) for bound in first)
    return low, high
