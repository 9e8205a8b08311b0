"""The shipped policy's weights inside a flying library: changed in flight."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from neuroflight.flash.link import records
from neuroflight.flash.link.client import Client
from neuroflight.sim.ports.library import ReferencePort
from neuroflight.sim.ports.port import Reply, Sample
from neuroflight.toolchain.codegen.compiler import CompiledPolicy, compile_policy
from neuroflight.toolchain.contract import FLASH_BYTES, Msp
from neuroflight.toolchain.policy.model import read_policy

SHIPPED = Path(__file__).parents[2] / "training" / "policies" / "nf1" / "policy.onnx"
Weights = NDArray[np.float32]
Change = Callable[[Weights], None]  # works in place


@cache
def shipped() -> CompiledPolicy:
    """The shipped policy, as its image takes it."""
    return compile_policy(read_policy(SHIPPED))


def shipped_table() -> Weights:
    """Its weights, (weights,)."""
    return shipped().plan.table


@dataclass
class ChangedPort:
    """A library whose policy gets other weights at an armed gyro sample, and what its firmware says of it."""

    port: ReferencePort
    change: Change
    at: int  # armed gyro samples before the change
    hidden: bool = False  # flash has the same ones, as after an upload: no comparison tells them
    armed: int = field(default=0, init=False)  # gyro samples

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
                self.change(self.kept())
        return reply

    def kept(self) -> Weights:
        """The table that the firmware finds in its flash."""
        memory, table = np.frombuffer(self.port.reference._memory, np.float32), shipped_table()
        at = memory.tobytes().rfind(table.tobytes())  # behind those that it flies
        assert at > memory.nbytes - FLASH_BYTES
        return memory[at // 4 : at // 4 + table.size]

    @contextmanager
    def kept_changed(self, change: Change) -> Iterator[None]:
        """Flash has other weights meanwhile."""
        kept = self.kept()
        before = kept.copy()
        change(kept)
        yield
        kept[:] = before

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
        self.port.close()
