"""The shipped policy's weights inside a flying library: changed in flight."""

from __future__ import annotations

import ctypes
import mmap
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from flash import records
from flash.client import Client
from sim.ports.library import ReferencePort
from sim.ports.port import Reply, Sample
from toolchain.codegen.compiler import compile_policy
from toolchain.contract import Msp
from toolchain.policy.model import read_policy

SHIPPED = Path(__file__).parents[2] / "training" / "policies" / "nf1" / "policy.onnx"
Weights = NDArray[np.float32]
Change = Callable[[Weights], None]  # works in place


@cache
def shipped_table() -> Weights:
    """The table that the shipped policy's image takes, (weights,)."""
    return compile_policy(read_policy(SHIPPED)).plan.table


PAGE = mmap.PAGESIZE
READ, WRITE = 1, 2  # of mprotect


@contextmanager
def writable(weights: Weights) -> Iterator[None]:
    """Constants of a loaded library may be changed meanwhile; at the end they are as they were."""
    first = weights.ctypes.data // PAGE * PAGE
    size = weights.ctypes.data + weights.nbytes - first
    libc, kept = ctypes.CDLL(None, use_errno=True), weights.copy()

    def protect(how: int) -> None:
        assert libc.mprotect(ctypes.c_void_p(first), ctypes.c_size_t(size), how) == 0, ctypes.get_errno()

    protect(READ | WRITE)
    try:
        yield
    finally:
        weights[:] = kept
        protect(READ)


@dataclass
class ChangedPort:
    """A library whose policy gets other weights at an armed gyro sample, and what its firmware says of it."""

    port: ReferencePort
    change: Change
    at: int  # armed gyro samples before the change
    hidden: bool = False  # flash has the same ones, as after an upload: no comparison tells them
    armed: int = field(default=0, init=False)  # gyro samples
    _undo: ExitStack = field(default_factory=ExitStack, init=False)

    def __post_init__(self) -> None:
        """Take over what a port tells."""
        self.motor_count, self.gyro_rate_hz = self.port.motor_count, self.port.gyro_rate_hz
        self.control_rate_hz = self.port.control_rate_hz

    def exchange(self, sample: Sample, channels_us: Sequence[int] | None) -> Reply:
        """See FirmwarePort."""
        reply = self.port.exchange(sample, channels_us)
        self.armed += reply.armed
        if reply.armed and self.armed == self.at + 1:
            self.change(self.weights())
            if self.hidden:
                kept = self.kept()
                self._undo.enter_context(writable(kept))
                self.change(kept)
        return reply

    def kept(self) -> Weights:
        """The table that the firmware finds in its flash."""
        table = shipped_table()
        first = ctypes.c_float.in_dll(self.port.reference._library, "policy_weights")
        kept = np.ctypeslib.as_array(
            ctypes.cast(ctypes.byref(first), ctypes.POINTER(ctypes.c_float)), table.shape
        )
        np.testing.assert_array_equal(kept, table)
        return kept

    @contextmanager
    def kept_changed(self, change: Change) -> Iterator[None]:
        """Flash has other weights meanwhile."""
        kept = self.kept()
        with writable(kept):
            change(kept)
            yield

    def weights(self) -> Weights:
        """The table in the firmware's memory, found by what it holds."""
        memory = np.frombuffer(self.port.reference._memory, np.float32)
        table = shipped_table()
        at = memory.tobytes().find(table.tobytes())
        assert at >= 0, "the firmware flies another table"
        return memory[at // 4 : at // 4 + table.size]

    def safety(self) -> records.Safety:
        """What the firmware says of its state."""
        return records.safety(Client(self.port.reference).request(Msp.SAFETY))

    def arming_reasons(self) -> tuple[str, ...]:
        """See FirmwarePort."""
        return self.port.arming_reasons()

    def close(self) -> None:
        """See FirmwarePort."""
        self._undo.close()
        self.port.close()
