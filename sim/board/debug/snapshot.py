"""The whole state of an emulated board between two runs, to go on from as often as wanted.

A snapshot holds the core's state and registers, memory, counts and what every attached peripheral says of
itself. It goes back into the engine it came from or into another one with the same peripherals, and the run
that follows is the run that would have followed.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from unicorn import arm_const

from neuroflight.sim.board.core.context import BoardError
from neuroflight.sim.board.core.engine import CORE_REGISTERS, XPSR, Engine, Note
from neuroflight.sim.board.debug.profile import code_counts
from neuroflight.toolchain.contract import FLASH_BASE, FLASH_BYTES

SYSTEM_MEMORY = (0x1FF00000, 0x10000)
MEMORIES = ((0x00000000, 0x4000), (FLASH_BASE, FLASH_BYTES), SYSTEM_MEMORY, (0x20000000, 0x40000))
# The mode comes first: it decides which of the two stack pointers is SP.
REGISTERS = (
    *(XPSR, arm_const.UC_ARM_REG_CONTROL, arm_const.UC_ARM_REG_MSP, arm_const.UC_ARM_REG_PSP),
    *(arm_const.UC_ARM_REG_PRIMASK, arm_const.UC_ARM_REG_BASEPRI, arm_const.UC_ARM_REG_FAULTMASK),
    *(arm_const.UC_ARM_REG_FPSCR, *CORE_REGISTERS[:13], arm_const.UC_ARM_REG_LR),
    *(arm_const.UC_ARM_REG_S0 + i for i in range(32)),
)


@dataclass(frozen=True)
class Snapshot:
    """Everything that decides what happens next, and what has been counted."""

    shape: tuple[object, ...]  # what an engine must have to take it
    core: bytes
    registers: tuple[int, ...]
    memories: tuple[bytes, ...]
    peripherals: dict[str, Any]
    counts: bytes
    notes: tuple[Note, ...]
    resets: tuple[str, ...]


def take_snapshot(engine: Engine) -> Snapshot:
    """Copy the state of `engine`, which stands between two runs."""
    return Snapshot(
        shape=_shape(engine),
        core=bytes(_core(engine)),
        registers=tuple(engine.library.engine_register(engine.handle, name) for name in REGISTERS),
        memories=tuple(engine.memory(address, size) for address, size in MEMORIES),
        peripherals={name: peripheral.state() for name, peripheral in engine.peripherals.items()},
        counts=b"".join(map(bytes, _counts(engine))),
        notes=tuple(engine.notes.values()),
        resets=tuple(engine.resets),
    )


def restore_snapshot(engine: Engine, snapshot: Snapshot) -> None:
    """Make `snapshot` the state of `engine`. Raises BoardError when it comes from another kind of board."""
    if snapshot.shape != _shape(engine):
        raise BoardError("a snapshot of a board with other peripherals or another time; take a new one")
    for (address, _), data in zip(MEMORIES, snapshot.memories, strict=True):
        engine.set_memory(address, data)
    _core(engine)[:] = snapshot.core
    enters, leaves = _counts(engine)
    enters[:], leaves[:] = snapshot.counts[: len(enters)], snapshot.counts[len(enters) :]
    for name, value in zip(REGISTERS, snapshot.registers, strict=True):
        engine.library.engine_set_register(engine.handle, name, value)
    engine.notes = {note.message: note for note in snapshot.notes}
    engine.resets = list(snapshot.resets)
    for name, peripheral in engine.peripherals.items():
        peripheral.restore(snapshot.peripherals[name])
    engine.forget_failure()
    engine.library.engine_restored(engine.handle)


def _shape(engine: Engine) -> tuple[object, ...]:
    cpi: Fraction = engine.cpi
    return (cpi, engine.strict, tuple(engine.alarms), tuple(engine.peripherals), len(_core(engine)))


def _core(engine: Engine) -> memoryview:
    library = engine.library
    return memoryview(engine.ffi.buffer(library.engine_state(engine.handle), library.engine_state_bytes()))


def _counts(engine: Engine) -> tuple[memoryview, memoryview]:
    enters, leaves = (counts.data.cast("B") for counts in code_counts(engine))
    return enters, leaves
