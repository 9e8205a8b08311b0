"""Lowers a network to what the emitted C does: calls of kernels, one table of floats, one scratch memory.

Table. First the rows of the functions that are looked up (`toolchain.ir.activation_tables`), then, call by
call, what the call reads. A linear layer runs in blocks of 8 outputs, and of 4 for a rest of at most 4,
whose sums stay in registers; its part of the table holds, block by block, the block's biases and then, input
by input, the block's weights, so that a kernel reads it from front to back. Every part starts 16-byte
aligned, which the Cortex-M7's 64-bit loads like.

Memory. Every value has room for a multiple of LANES floats, so that kernels go over it LANES at a time; what
stands in the padding is read and written, and means nothing. Values that are not needed at the same time
share space.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from neuroflight.toolchain.codegen.kernel_calls import Call
from neuroflight.toolchain.codegen.lowering import Lowering
from neuroflight.toolchain.codegen.scratch_allocation import place_buffers
from neuroflight.toolchain.ir.activation_tables import ActivationTable
from neuroflight.toolchain.ir.float32 import Float32
from neuroflight.toolchain.ir.network import Network
from neuroflight.toolchain.policy.model import PolicyModel


@dataclass(frozen=True, eq=False)
class CodePlan:
    """The plan of the emitted C: calls, the table they read and the memory they need."""

    calls: tuple[Call, ...]
    table: Float32  # (weight count,)
    scratch: int  # floats
    scratch_unshared: int  # floats, if every value had its own space
    state: int  # floats of recurrent state
    architecture_hash: int  # CRC-32: equal for policies whose tables may be exchanged

    @property
    def memory(self) -> int:
        """Floats that `struct policy` holds."""
        return self.scratch + self.state


def lower(policy: PolicyModel, network: Network) -> CodePlan:
    """Lower `policy`, with its network in the form `network`, to a plan."""
    lowering = Lowering(network)
    calls, scratch, unshared = place_buffers(lowering.calls)
    table = np.concatenate([np.zeros(0, np.float32), *lowering.table])
    hashed = _architecture_hash(policy, calls, lowering.functions)
    return CodePlan(tuple(calls), table, scratch, unshared, lowering.state, hashed)


def _architecture_hash(
    policy: PolicyModel, calls: Iterable[Call], functions: Iterable[ActivationTable]
) -> int:
    """Compute the CRC-32 over everything that the code, rather than the table, decides, as lines of text."""
    lines = [
        f"observation {policy.observation}",
        f"rate {policy.control_rate_hz}",
        f"filters {policy.filters}",
        *(f"function {function.name} {function.rows.shape[0]}" for function in functions),
    ]
    for call in calls:
        places = " ".join(
            "-" if p is None else f"{p.memory}+{p.offset}" for p in (call.target, *call.sources)
        )
        constants = " ".join(value.hex() for value in call.constants)
        lines.append(f"{call.kernel} {places} {call.count} {call.inputs} @{call.table} {constants}")
    return zlib.crc32("\n".join(lines).encode())
