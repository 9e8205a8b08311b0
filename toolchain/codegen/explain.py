"""The compilation of a policy, explained: passes with their equivalence checks, networks, memory."""

from __future__ import annotations

from dataclasses import dataclass

from neuroflight.toolchain.codegen.compiler import CompiledPolicy, compile_network
from neuroflight.toolchain.ir import operations as op
from neuroflight.toolchain.ir.network import OBSERVATION, Network
from neuroflight.toolchain.passes import Size, operations, optimize, size, weight_bytes
from neuroflight.toolchain.passes.equivalence import Equivalence, check_equivalence
from neuroflight.toolchain.policy.model import PolicyModel

FLOAT = 4  # bytes


@dataclass(frozen=True)
class NodeFacts:
    """One node as shown to people."""

    value: int  # the number of the value that it gives; 0 is the observation
    operation: str
    takes: tuple[int, ...]
    width: int
    operations: int
    bytes: int
    name: str  # of the ONNX node it comes from


@dataclass(frozen=True)
class Memory:
    """Bytes that the compiled policy needs."""

    weights: int  # the whole table, tables of functions and padding included
    scratch: int  # of intermediate values, sharing space if not alive at the same time
    scratch_unshared: int  # if every value had its own space
    state: int  # of recurrent cells


@dataclass(frozen=True, eq=False)
class Explanation:
    """A compiled policy and how it came to be."""

    compiled: CompiledPolicy  # its savings carry their proofs
    proof: Equivalence | None  # of all passes together, None if none did anything
    before: tuple[NodeFacts, ...]
    after: tuple[NodeFacts, ...]
    size_before: Size
    size_after: Size
    memory: Memory


def explain_policy(policy: PolicyModel) -> Explanation:
    """Compile `policy`, each pass proven in onnxruntime.

    Raises PolicyError where folding leaves float32's range, EquivalenceError where a pass is wrong.
    """
    network, savings = optimize(policy.network, prove=True)
    compiled = compile_network(policy, network, savings)
    plan = compiled.plan
    return Explanation(
        compiled,
        check_equivalence(policy.network, network, "all passes together") if savings else None,
        node_facts(policy.network),
        node_facts(network),
        size(policy.network),
        size(network),
        Memory(plan.table.nbytes, FLOAT * plan.scratch, FLOAT * plan.scratch_unshared, FLOAT * plan.state),
    )


def node_facts(network: Network) -> tuple[NodeFacts, ...]:
    """Describe every node of a network, in order of computation."""
    return tuple(
        NodeFacts(
            number,
            describe(node.operation),
            node.inputs,
            network.widths[number],
            operations(node.operation, network.widths[number]),
            weight_bytes(node.operation),
            node.name,
        )
        for number, node in enumerate(network.nodes, OBSERVATION + 1)
    )


def describe(operation: op.Operation) -> str:
    """Describe an operation in a few words, without its weights."""
    name = type(operation).__name__
    match operation:
        case op.Linear():
            return f"{name} {operation.inputs} → {operation.outputs}"
        case op.Gru() | op.Lstm():
            return f"{name} {operation.input_weight.shape[1]} → {operation.units}"
        case op.Affine(scale, offset):
            scaled, moved = bool((scale != 1).any()), bool(offset.any())
            return f"{name} {'a x' if scaled else 'x'}{' + b' if moved else ''}"
        case op.LeakyRelu(factor) | op.Elu(factor):
            return f"{name} {factor:.4g}"
        case op.Clip(low, high):
            return (
                f"{name} {'…' if low is None else f'{low:.4g}'} to {'…' if high is None else f'{high:.4g}'}"
            )
        case op.Slice(start, count, step):
            every = "" if step == 1 or count == 1 else f", every {step}"
            return f"{name} {start} to {start + (count - 1) * step}{every}"
    return name
