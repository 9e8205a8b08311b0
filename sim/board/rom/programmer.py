"""Erasing and programming by the program in the ROM, step by step through the flash controller's registers.

It takes the time that it takes on the chip, and can lose power in the middle.
"""

from __future__ import annotations

from collections.abc import Callable

from neuroflight.sim.board.core.context import TIME_HZ, Kept
from neuroflight.sim.board.core.engine import Engine
from neuroflight.sim.board.peripherals.flash import ERASE_MS, KEYS, MASS_ERASE_MS, PROGRAM_CYCLES, Flash
from neuroflight.toolchain.contract import FLASH_SECTORS

PARALLELISM = 0  # FLASH_CR PSIZE: by bytes, as fits the lowest supply, which the ROM has to reckon with
_UNIT = 1 << PARALLELISM  # bytes programmed at once
_MASS = -1  # in place of a sector's number


def erase_cycles(sectors: tuple[int, ...] | None) -> int:
    """Return how long erasing these sectors takes, or the whole flash (None)."""
    times = [MASS_ERASE_MS] if sectors is None else [ERASE_MS[FLASH_SECTORS[n].size >> 10] for n in sectors]
    return sum(time[PARALLELISM] for time in times) * TIME_HZ // 1000


def program_cycles(size: int) -> int:
    """Return how long programming `size` bytes takes."""
    return -(-size // _UNIT) * PROGRAM_CYCLES


class Programmer(Kept):
    """One order to flash at a time: `erase` or `program`, then a call of `on_done`."""

    kept = ("_sectors", "_address", "_data", "busy")

    def __init__(self, engine: Engine, flash: Flash) -> None:
        """Set up after `flash`, whose alarm then goes first."""
        self._engine, self._flash = engine, flash
        self._next = engine.alarm("rom.flash", self._go_on)
        self.on_done: Callable[[], None] = lambda: None
        self.stop()

    def stop(self) -> None:
        """Forget the order, as at a reset."""
        self._sectors: tuple[int, ...] = ()  # still to be erased
        self._address, self._data = 0, b""  # still to be programmed
        self.busy = False  # until the call of `on_done`
        self._next.cancel()

    def erase(self, sectors: tuple[int, ...] | None) -> None:
        """Erase sectors one after another, or the whole flash (None). A write-protected one stays, without
        an error."""
        self._sectors = (_MASS,) if sectors is None else sectors
        self._begin()

    def program(self, address: int, data: bytes) -> None:
        """Program bytes of flash. Where it is not erased, it keeps the bits that both have set."""
        self._address, self._data = address, data
        self._begin()

    def lock(self) -> None:
        """Lock the flash controller, as it is after a reset."""
        if not self._flash.get("CR", "LOCK"):
            self._flash.write_cr(self._flash.words["CR"] | self._flash.mask("CR", "LOCK"))

    def _begin(self) -> None:
        self.busy = True
        if self._flash.get("CR", "LOCK"):
            for key in KEYS:
                self._flash.write_keyr(key)
        self._go_on()

    def _go_on(self) -> None:
        if self._sectors:
            self._erase_next()
        elif self._data:
            self._program_next()
        else:
            self.busy = False
            self.on_done()

    def _erase_next(self) -> None:
        sector, self._sectors = self._sectors[0], self._sectors[1:]
        command, number = ("MER", 0) if sector == _MASS else ("SER", sector << self._field_lsb("SNB"))
        order = self._flash.mask("CR", command, "STRT") | number | PARALLELISM << self._field_lsb("PSIZE")
        self._flash.write_cr(order)
        self._wait()

    def _program_next(self) -> None:
        flash, address = self._flash, self._address
        size = _UNIT if not address % _UNIT and len(self._data) >= _UNIT else 1
        raw, self._data = self._data[:size], self._data[size:]
        self._address += size
        old = int.from_bytes(self._engine.memory(address, size), "little")
        programming = flash.mask("CR", "PG") | (size.bit_length() - 1) << self._field_lsb("PSIZE")
        if flash.words["CR"] != programming:
            flash.write_cr(programming)
        flash.program(address, size, int.from_bytes(raw, "little") & old)
        self._wait()

    def _wait(self) -> None:
        until = self._flash.busy_until
        self._next.set(self._engine.cycle if until is None else until)

    def _field_lsb(self, field: str) -> int:
        return self._flash.block.registers["CR"].fields[field].lsb
