"""Lowers a chain of layers to what the emitted C does: kernels in order and one table of weights.

A linear layer runs in blocks of at most BLOCK outputs whose sums stay in registers. Its part of the table
holds, block by block, the block's biases and then, input by input, the block's weights, so that a kernel
reads the table from front to back. A block that would end on an odd word is padded with one zero: each
block starts 8-byte aligned, which the Cortex-M7's 64-bit loads like.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from toolchain.float32 import Float32
from toolchain.graph import Network
from toolchain.network import PolicyModel
from toolchain.operations import Activation, Affine, Clip, Linear
from toolchain.operations import Operation as Layer

BLOCK = 8  # outputs summed at a time: 8 sums, 8 weights and the input fit the FPU's 32 registers


@dataclass(frozen=True)
class Blocks:
    """`count` blocks of `width` outputs, beginning at output `first`."""

    first: int
    width: int
    count: int


@dataclass(frozen=True)
class Step:
    """One pass over the values: a linear or affine map (or a mere copy), then activations, value by value."""

    kind: str  # "linear", "affine" or "copy"
    inputs: int
    outputs: int
    blocks: tuple[Blocks, ...]  # of a linear step
    activations: tuple[Activation, ...]
    offset: int  # of the step's part of the table, in floats


@dataclass(frozen=True, eq=False)
class Plan:
    """What is emitted: the steps and the table they read."""

    steps: tuple[Step, ...]
    table: Float32  # (weight count,)
    architecture_hash: int  # CRC-32: equal for policies whose tables may be exchanged


def lower(policy: PolicyModel, network: Network) -> Plan:
    """The plan of `policy` with its network in the form `network`."""
    steps: list[Step] = []
    tables: list[Float32] = [np.zeros(0, np.float32)]
    layers = [node.operation for node in network.nodes]
    width, offset, position = policy.observation_count, 0, 0
    while position < len(layers):
        layer = layers[position]
        end = position + isinstance(layer, Linear | Affine)
        activations = []
        while end < len(layers) and isinstance(activation := layers[end], Activation):
            activations.append(activation)
            end += 1
        kind, blocks, table = _table(layer)
        outputs = layer.outputs if isinstance(layer, Linear) else width
        steps.append(Step(kind, width, outputs, blocks, tuple(activations), offset))
        tables.append(table)
        width, offset, position = outputs, offset + table.size, end
    return Plan(tuple(steps), np.concatenate(tables), _architecture_hash(policy, steps))


def _table(layer: Layer) -> tuple[str, tuple[Blocks, ...], Float32]:
    match layer:
        case Linear():
            blocks = _blocks(layer.outputs)
            parts = [
                _block(layer, group.first + index * group.width, group.width)
                for group in blocks
                for index in range(group.count)
            ]
            return "linear", blocks, np.concatenate(parts)
        case Affine():
            return "affine", (), np.concatenate([layer.scale, layer.offset]).astype(np.float32)
    return "copy", (), np.zeros(0, np.float32)


def _blocks(outputs: int) -> tuple[Blocks, ...]:
    """Full blocks, then one of what remains."""
    full, rest = divmod(outputs, BLOCK)
    groups = (Blocks(0, BLOCK, full), Blocks(full * BLOCK, rest, 1))
    return tuple(group for group in groups if group.width * group.count)


def _block(layer: Linear, first: int, width: int) -> Float32:
    rows = slice(first, first + width)
    values = np.concatenate([layer.bias[rows], layer.weight[rows].T.ravel()])
    return np.append(values, np.zeros(values.size % 2, np.float32))


def _architecture_hash(policy: PolicyModel, steps: Sequence[Step]) -> int:
    """CRC-32 over everything that the code, rather than the table, decides, as lines of text."""
    lines = [
        f"observation {policy.observation}",
        f"rate {policy.control_rate_hz}",
        f"filters {policy.filters}",
    ]
    for step in steps:
        blocks = ",".join(f"{group.first}+{group.count}x{group.width}" for group in step.blocks)
        chain = " ".join(_activation_text(activation) for activation in step.activations)
        lines.append(f"{step.kind} {step.inputs} {step.outputs} @{step.offset} {blocks} {chain}")
    return zlib.crc32("\n".join(lines).encode())


def _activation_text(activation: Activation) -> str:
    name = type(activation).__name__.lower()
    if isinstance(activation, Clip):
        bounds = (None if b is None else b.hex() for b in (activation.low, activation.high))
        return f"{name}({','.join(map(str, bounds))})"
    return name
