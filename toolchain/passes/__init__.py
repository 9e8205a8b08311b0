"""Optimization: shortens a network without changing what it computes.

Each pass is exact in real arithmetic, is carried out in float64 and rounds its result to float32 once. The
passes run in the order of PASSES, again and again until none of them changes anything.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, assert_never

from neuroflight.toolchain.ir import operations as op
from neuroflight.toolchain.ir.network import Network, arrays, multiply_adds
from neuroflight.toolchain.passes.affine import fold_affine, lower_sigmoid, merge_affine, move_affine, rounded
from neuroflight.toolchain.passes.bounds import drop_bounds, fold_constants
from neuroflight.toolchain.passes.matrices import merge_linear
from neuroflight.toolchain.passes.shape import drop_identities, share_equal, simplify_slices
from neuroflight.toolchain.passes.unread import drop_unread

if TYPE_CHECKING:
    from neuroflight.toolchain.passes.equivalence import Equivalence

FLOAT_BYTES = 4


@dataclass(frozen=True)
class Pass:
    """One kind of rewrite: a pure function that gives back the same object where it finds nothing to do."""

    name: str
    finds: str  # what it removes or rewrites, for people
    run: Callable[[Network], Network]


PASSES = (
    Pass("drop unread", "nodes, and rows of matrices, that cannot reach the output", drop_unread),
    Pass("fold constants", "what no observation changes, before a matrix", fold_constants),
    Pass("drop identities", "what gives the value that it takes", drop_identities),
    Pass("share equal", "what is computed twice from the same values", share_equal),
    Pass("simplify slices", "slices of slices and of concats, concats of both", simplify_slices),
    Pass("drop bounds", "a clip or relu that cannot bind, or two in a row", drop_bounds),
    Pass("lower sigmoid", "sigmoid between matrices: 1/2 + 1/2 tanh(x/2)", lower_sigmoid),
    Pass("merge affine", "two affine maps in a row", merge_affine),
    Pass("fold affine", "affine maps beside weights that take them in", fold_affine),
    Pass("move affine", "affine maps that a concat or slice keeps from weights", move_affine),
    Pass("merge linear", "linear layers with no activation between", merge_linear),
)


@dataclass(frozen=True)
class Size:
    """The cost of a network."""

    nodes: int
    operations: int  # of one evaluation; a multiply-add, a bound or a tanh is one
    bytes: int  # of weights


@dataclass(frozen=True)
class Saving:
    """The saving of one pass over all its runs; negative if it prepares another's work."""

    rewrite: str  # the name of the pass
    nodes: int
    operations: int
    bytes: int
    proof: Equivalence | None = None  # the worst of its runs


def optimize(network: Network, prove: bool = False) -> tuple[Network, tuple[Saving, ...]]:
    """Shorten the network; return it and one `Saving` for each pass that did something, in their order.

    prove: run the network in onnxruntime before and after each pass that did something, and raise
    `toolchain.passes.equivalence.ProofError` where they differ by more than rounding. Deterministic. Raises
    PolicyError where folding leaves the range of float32.
    """
    savings: dict[str, Saving] = {}
    changed = True
    while changed:
        changed = False
        for step in PASSES:
            after = step.run(network)
            if after is not network:
                changed = True
                savings[step.name] = _add(savings.get(step.name), step.name, network, after, prove)
                network = after
    for node in network.nodes:
        if isinstance(node.operation, op.Affine):  # the others have been rounded where they were made
            rounded(node.operation.scale)
            rounded(node.operation.offset)
    return network, tuple(savings[step.name] for step in PASSES if step.name in savings)


def size(network: Network) -> Size:
    """Return nodes, operations and bytes of a network."""
    widths = network.widths[1:]
    total = sum(operations(node.operation, width) for node, width in zip(network.nodes, widths, strict=True))
    return Size(len(network.nodes), total, sum(weight_bytes(node.operation) for node in network.nodes))


def weight_bytes(operation: op.Operation) -> int:
    """Return the bytes of the operation's weights in float32."""
    return sum(FLOAT_BYTES * array.size for array in arrays(operation))


def operations(operation: op.Operation, width: int) -> int:
    """Count the operations of one evaluation; a function that has a kernel of its own counts as one."""
    match operation:
        case op.Linear():
            return multiply_adds(operation)
        case op.Gru():  # 2 sums, 2 sigmoids of 3, tanh, 2 products with a sum, a difference
            return multiply_adds(operation) + 12 * width
        case op.Lstm():  # 4 sums, 3 sigmoids of 3, 2 tanh, 2 products, a product with a sum
            return multiply_adds(operation) + 18 * width
        case op.Concat() | op.Slice():
            return 0
        case op.Sigmoid() | op.Softsign() | op.Softplus() | op.Elu():
            return 3 * width
        case op.LayerNorm() | op.RmsNorm() | op.Softmax() | op.Silu():
            return 4 * width
        case op.LeakyRelu():
            return 2 * width
        case (
            op.Affine()
            | op.Tanh()
            | op.Erf()
            | op.Relu()
            | op.Clip()
            | op.Add()
            | op.Multiply()
            | op.Select()
        ):
            return width
        case never:
            assert_never(never)


def _add(old: Saving | None, name: str, before: Network, after: Network, prove: bool) -> Saving:
    """Add one more run of a pass to its saving."""
    less, now = size(before), size(after)
    proof = None if old is None else old.proof
    if prove:
        from neuroflight.toolchain.passes.equivalence import check_equivalence

        fresh = check_equivalence(before, after, name)
        proof = fresh if proof is None else proof.worst(fresh)
    base = old or Saving(name, 0, 0, 0)
    return Saving(
        name,
        base.nodes + less.nodes - now.nodes,
        base.operations + less.operations - now.operations,
        base.bytes + less.bytes - now.bytes,
        proof,
    )
