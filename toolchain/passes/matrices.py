"""The pass that joins matrices: one after the other, and side by side."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from neuroflight.toolchain.ir.network import Network, Node
from neuroflight.toolchain.ir.operations import Add, Concat, Gru, Linear, Lstm
from neuroflight.toolchain.passes.affine import input_matrix, rounded, with_input
from neuroflight.toolchain.passes.rewrite import Draft, rewrite


def merge_linear(network: Network) -> Network:
    """Join linear layers without an activation between, if that costs no more.

    In a row, into the input weights of a recurrent cell too; as addends; and as neighbours in a Concat if
    they
    take the same value.
    """

    def rule(draft: Draft, node: Node, _number: int) -> Node | None:
        match node.operation:
            case Linear() | Gru() | Lstm():
                return _in_a_row(draft, node)
            case Add():
                return _added(draft, node)
            case Concat():
                return _side_by_side(draft, node)
        return None

    return rewrite(network, rule)


def _in_a_row(draft: Draft, node: Node) -> Node | None:
    before, matrix = draft.sole(node.inputs[0]), input_matrix(node.operation)
    if before is None or matrix is None or not isinstance(inner := before.operation, Linear):
        return None
    outer, bias = matrix
    if len(outer) * inner.inputs > inner.weight.size + outer.size:
        return None
    merged = with_input(node.operation, outer @ inner.weight, outer @ inner.bias + bias)
    return Node(merged, before.inputs, node.name)


def _added(draft: Draft, node: Node) -> Node | None:
    match [draft.sole(value) for value in node.inputs]:
        case [Node(operation=Linear() as a) as one, Node(operation=Linear() as b) as other]:
            if one.inputs == other.inputs:
                weight, bias = a.weight.astype(np.float64) + b.weight, a.bias.astype(np.float64) + b.bias
                return Node(Linear(rounded(weight), rounded(bias)), one.inputs, node.name)
    return None


def _side_by_side(draft: Draft, node: Node) -> Node | None:
    parts = [draft.sole(value) for value in node.inputs]
    for place, (one, other) in enumerate(pairwise(parts)):
        match one, other:
            case Node(operation=Linear() as a), Node(operation=Linear() as b) if one.inputs == other.inputs:
                stack = Linear(np.concatenate([a.weight, b.weight]), np.concatenate([a.bias, b.bias]))
                value = draft.add(stack, one.inputs, one.name)
                return Node(Concat(), (*node.inputs[:place], value, *node.inputs[place + 2 :]), node.name)
    return None
