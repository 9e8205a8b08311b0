"""Passes over nodes that compute nothing new: equal values, identities, Slice and Concat."""

from __future__ import annotations

from dataclasses import fields
from itertools import pairwise

import numpy as np

from neuroflight.toolchain.ir import operations as op
from neuroflight.toolchain.ir.network import Network, Node
from neuroflight.toolchain.passes.rewrite import Draft, rewrite


def share_equal(network: Network) -> Network:
    """Compute only once what nodes compute from the same values and weights."""
    known: dict[tuple[object, ...], int] = {}

    def rule(draft: Draft, node: Node, _number: int) -> int | None:
        inputs = sorted(node.inputs) if isinstance(node.operation, op.Add | op.Multiply) else node.inputs
        key = (*inputs, *_content(node.operation))
        if key in known:
            return known[key]
        known[key] = len(draft.nodes) + 1  # the value that this node is about to give
        return None

    return rewrite(network, rule)


def drop_identities(network: Network) -> Network:
    """Drop nodes whose result equals their input."""

    def rule(draft: Draft, node: Node, _number: int) -> int | None:
        return node.inputs[0] if _is_identity(node.operation, draft.widths[node.inputs[0]]) else None

    return rewrite(network, rule)


def simplify_slices(network: Network) -> Network:
    """Let a Slice of a Slice or Concat read the original value; join Concats."""

    def rule(draft: Draft, node: Node, _number: int) -> Node | int | None:
        match node.operation:
            case op.Slice() as cut:
                return _source(draft, node, cut)
            case op.Concat() if len(node.inputs) == 1:
                return node.inputs[0]
            case op.Concat():
                return _joined(draft, node)
        return None

    return rewrite(network, rule)


def _content(operation: op.Operation) -> tuple[object, ...]:
    """Return the operation's content for comparison by value."""
    content: list[object] = [type(operation)]
    for entry in fields(operation):
        value = getattr(operation, entry.name)
        content.append((value.shape, value.tobytes()) if isinstance(value, np.ndarray) else value)
    return tuple(content)


def _is_identity(operation: op.Operation, width: int) -> bool:
    match operation:
        case op.Affine(scale, offset):
            return bool((scale == 1).all() and (offset == 0).all())
        case op.Linear(weight, bias):
            return np.array_equal(weight, np.eye(width)) and not bias.any()
        case op.LeakyRelu(slope):
            return slope == 1
        case op.Slice(start, count, step):
            return start == 0 and count == width and (step == 1 or count == 1)
        case op.Clip(None, None):
            return True
    return False


def _source(draft: Draft, node: Node, cut: op.Slice) -> Node | None:
    before = draft.producer(node.inputs[0])
    match before:
        case Node(operation=op.Slice() as inner):
            start = inner.start + cut.start * inner.step
            return Node(op.Slice(start, cut.count, cut.step * inner.step), before.inputs, node.name)
        case Node(operation=op.Concat()):
            last = cut.start + (cut.count - 1) * cut.step
            lowest, highest, first = min(cut.start, last), max(cut.start, last), 0
            for value in before.inputs:
                width = draft.widths[value]
                if first <= lowest and highest < first + width:
                    return Node(op.Slice(cut.start - first, cut.count, cut.step), (value,), node.name)
                first += width
    return None


def _joined(draft: Draft, node: Node) -> Node | None:
    """Join a Concat of Concats, and neighbouring slices of one value."""
    values = list[int]()
    for value in node.inputs:
        part = draft.sole(value)
        inner = part is not None and isinstance(part.operation, op.Concat)
        values += part.inputs if part is not None and inner else (value,)
    if len(values) > len(node.inputs):
        return Node(op.Concat(), tuple(values), node.name)
    for place, (one, other) in enumerate(pairwise(values)):
        match draft.producer(one), draft.producer(other):
            case Node(operation=op.Slice(start, count, 1)) as a, Node(
                operation=op.Slice(second, more, 1)
            ) as b:
                if a.inputs == b.inputs and start + count == second:
                    whole = draft.add(op.Slice(start, count + more), a.inputs, a.name)
                    return Node(op.Concat(), (*values[:place], whole, *values[place + 2 :]), node.name)
    return None
