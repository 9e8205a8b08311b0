"""A flash chip on its SPI lines: bytes in, bytes out, its power, and faults.

Time is the cycle at which each byte begins. Between two bytes nothing of the chip is computed: what was sent
before is carried out, at its own cycle, when the next transaction begins.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

from neuroflight.sim.board.core.context import BoardError, Kept
from neuroflight.sim.board.devices.flash_chip.die import RELEASED, SELECT, Die
from neuroflight.sim.board.devices.flash_chip.kinds import KINDS, ChipKind
from neuroflight.sim.board.devices.flash_chip.memory import FlashMemory


def _raise(message: str) -> NoReturn:
    raise BoardError(message)


class FlashChip(Kept):
    """One chip. It has its file, if it has one, alone until `close`."""

    kept = ("operations", "_cuts", "_die", "_powered", "_transaction", "_select")

    def __init__(self, kind: ChipKind | str = "W25Q128", path: Path | None = None, *, seed: int = 0) -> None:
        """path: of its content, made if there is none. seed: of times and of what a power cut leaves.

        Raises LinkError for a file that cannot be this chip.
        """
        self.kind = KINDS[kind] if isinstance(kind, str) else kind
        self.memory = FlashMemory(self.kind, path)
        self.fail: Callable[[str], NoReturn] = _raise  # called with an error of the host; does not return
        self.on_power_cut: Callable[[], None] = lambda: None  # a scripted one: the board loses its power
        self.operations = 0  # programs and erases that were begun
        blocks = self.kind.blocks // self.kind.dies
        self.dies = [Die(self.kind, self.memory, i * blocks, seed) for i in range(self.kind.dies)]
        for die in self.dies:
            die.fail = self._fail
            die.on_operation = self._begin_operation
        self._cuts: set[int] = set()
        self._die = 0
        self._powered = True
        self._transaction: int | None = None
        self._select = bytearray()

    @property
    def writes(self) -> int:
        """Pages that were programmed and blocks that were erased since the chip was made."""
        return self.operations

    def _fail(self, message: str) -> NoReturn:
        self.fail(message)

    def cut_at(self, operation: int) -> None:
        """Let the power go in the middle of that program or erase, counted from 1 since the chip was made."""
        self._cuts.add(operation)

    def mark_bad(self, block: int) -> None:
        """Mark a block as its maker does: it may not be used."""
        assert self.kind.nand
        self.memory.put(
            block * self.kind.pages,
            b"\xff" * self.kind.page_bytes + b"\0".ljust(self.kind.spare_bytes, b"\xff"),
        )
        for die in self.dies:
            die.factory_bad.add(block)

    def wear_out(self, block: int) -> None:
        """Let the block be neither programmed nor erased from now on."""
        for die in self.dies:
            die.worn.add(block)

    def decay(self, page: int) -> None:
        """Give the page more wrong bits than a NAND chip can mend, from now on."""
        for die in self.dies:
            die.decayed.add(page)

    def power_off(self, cycle: int) -> None:
        if self._powered:
            for die in self.dies:
                die.lose_power(cycle)
        self._powered = False

    def power_on(self, cycle: int) -> None:
        """Switch the supply on, also after a gap so short that only unfinished work is lost."""
        self.power_off(cycle)
        self._powered, self._die, self._transaction = True, 0, None
        for die in self.dies:
            die.power_on()

    def close(self) -> None:
        for die in self.dies:
            die.deselect()
        self.memory.close()

    def exchange(
        self, sent: bytes, cycle: int, length: int, hz: float, mode: int, *, selected: bool, transaction: int
    ) -> bytes:
        """Exchange bytes.

        cycle: at which the first one begins; length: of each [cycles]; hz: of the clock; mode: 0 to 3.
        transaction: a number that changes with every edge of the select line.
        """
        if transaction != self._transaction:
            self._transaction = transaction
            self._deselect()
        if not (selected and self._powered):
            return bytes([RELEASED]) * len(sent)
        if mode not in (0, 3):
            self.fail(f"the flash chip is addressed in SPI mode {mode}, expected 0 or 3")
        if len(self._select) < 2:
            self._select += sent[:2]
        return self.dies[self._die].exchange(sent, cycle, length, hz)

    def steady(self, cycle: int, *, selected: bool) -> tuple[int, int]:
        """Return the byte that answers 0xFF from `cycle` on, and until which cycle; 0: unknown."""
        return RELEASED, 0

    def _deselect(self) -> None:
        self.dies[self._die].deselect()
        select, self._select = self._select, bytearray()
        if len(select) == 2 and select[0] == SELECT and len(self.dies) > 1:
            if select[1] >= len(self.dies):
                self.fail(f"the flash chip is to select die {select[1]}, it has {len(self.dies)}")
            self._die = select[1]

    def _begin_operation(self, cycle: int) -> bool:
        self.operations += 1
        if self.operations not in self._cuts:
            return False
        self._powered = False
        self.on_power_cut()
        return True

    def state(self) -> Any:  # noqa: ANN401
        return (self.memory.state(), [die.state() for die in self.dies], super().state())

    def restore(self, state: Any) -> None:  # noqa: ANN401
        self.memory.restore(state[0])
        for die, kept in zip(self.dies, state[1], strict=True):
            die.restore(kept)
        super().restore(state[2])
