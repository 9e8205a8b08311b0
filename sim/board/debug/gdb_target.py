"""A debugger's packets for registers, memory and flash of an engine that stands between two runs.

Each method takes the text after the packet's name and returns the reply. It raises ValueError for a malformed
packet or an address that does not exist, and RefusedError where the user is told why.
"""

from __future__ import annotations

import re
from collections.abc import Callable

from neuroflight.sim.board.core.context import BoardError
from neuroflight.sim.board.core.engine import Engine
from neuroflight.sim.board.debug.gdb_description import (
    READ_ONLY,
    REGISTER_SPACES,
    REGISTERS,
    UNCHANGED,
    Register,
    readable_bytes,
)
from neuroflight.sim.board.debug.gdb_packets import PACKET_BYTES
from neuroflight.sim.board.debug.snapshot import restore_snapshot, take_snapshot
from neuroflight.toolchain.contract import FLASH_BASE, FLASH_BYTES, FLASH_SECTORS

DATA_BYTES = PACKET_BYTES // 2  # of memory in one answer


class RefusedError(Exception):
    """A request that is not carried out; its text tells the debugger's user why."""


class Target:
    """The debugger's view of the target: registers, memory, flash."""

    def __init__(self, engine: Engine, on_flashed: Callable[[], None]) -> None:
        """on_flashed: called when flash has been changed."""
        self._engine, self._on_flashed = engine, on_flashed

    # ---- registers ----

    def registers(self) -> str:
        return "".join(map(self._value, REGISTERS))

    def register(self, rest: str) -> str:
        return self._value(_register(rest))

    def set_registers(self, rest: str) -> str:
        data = bytes.fromhex(rest)
        if len(data) != sum(register.bits // 8 for register in REGISTERS):
            raise ValueError(f"{len(data)} bytes for all registers")
        for register in REGISTERS:
            self._set(register, data[: register.bits // 8])
            data = data[register.bits // 8 :]
        return "OK"

    def set_register(self, rest: str) -> str:
        number, _, value = rest.partition("=")
        register, data = _register(number), bytes.fromhex(value)
        if len(data) != register.bits // 8:
            raise ValueError(f"{len(data)} bytes for {register.name}")
        self._set(register, data)
        return "OK"

    def _value(self, register: Register) -> str:
        return "".join(_word(self._engine.register(i)).hex() for i in register.words)

    def _set(self, register: Register, data: bytes) -> None:
        for place, i in enumerate(register.words):
            self._engine.set_register(i, int.from_bytes(data[4 * place : 4 * place + 4], "little"))

    # ---- memory ----

    def read(self, rest: str) -> str:
        """Return bytes of memory or of registers of peripherals: those from the first on that can be read."""
        address, size = numbers(rest, 2)
        size = min(size, DATA_BYTES)
        found = readable_bytes(address, size)
        data = self._engine.memory(address, found) if found else self._peripherals(address, size)
        if size and not data:
            raise ValueError(f"nothing can be read at 0x{address:08X}")
        return data.hex()

    def _peripherals(self, address: int, size: int) -> bytes:
        """Read words of registers as the program would; what that changes is restored."""
        engine, first, end = self._engine, address & ~3, address + size
        if not any(base <= address and end <= base + length for base, length in REGISTER_SPACES):
            return b""
        if (first, end) == (address, address + 4) and address in UNCHANGED:
            return _word(engine.load(address, 4))
        data = b""
        try:
            engine.run(0)  # raises the error that the board may have stopped on: nothing can be put back then
            before = take_snapshot(engine)
            try:
                for place in range(first, end, 4):
                    word = engine.load(place, 4)
                    engine.run(0)  # raises what is wrong with reading it
                    data += _word(word)
            finally:
                restore_snapshot(engine, before)
        except BoardError:
            pass
        return data[address - first : end - first]

    def write(self, rest: str, decode: Callable[[str], bytes]) -> str:
        """Change RAM; decode: turns the packet's data into bytes."""
        place, _, text = rest.partition(":")
        address, size = numbers(place, 2)
        data = decode(text)
        if len(data) != size or readable_bytes(address, size) != size:
            raise ValueError(f"{len(data)} bytes for {size} at 0x{address:08X}")
        for base, length, what in READ_ONLY:
            if base <= address < base + length:
                raise RefusedError(what)
        if size:
            self._engine.set_memory(address, data)
        return "OK"

    # ---- flash ----

    def erase(self, rest: str) -> str:
        """Erase whole sectors."""
        address, size = numbers(rest, 2)
        sectors = [s for s in FLASH_SECTORS if address <= s.address < address + size]
        if sum(s.size for s in sectors) != size or not sectors or sectors[0].address != address:
            raise RefusedError(f"{size} bytes at 0x{address:08X} are no whole sectors of flash")
        self._change_flash(address, b"\xff" * size)
        return "OK"

    def program(self, rest: str) -> str:
        """Program bytes where flash is erased."""
        place, _, text = rest.partition(":")
        (address,), data = numbers(place, 1), text.encode("latin-1")
        if not _in_flash(address, len(data)):
            raise RefusedError(f"{len(data)} bytes at 0x{address:08X}, expected flash")
        old = self._engine.memory(address, len(data))
        if any(new & ~before for new, before in zip(data, old, strict=True)):
            raise RefusedError(f"{len(data)} bytes at 0x{address:08X} over others that are not erased")
        self._change_flash(address, data)
        return "OK"

    def _change_flash(self, address: int, data: bytes) -> None:
        self._engine.set_memory(address, data)
        self._on_flashed()


def numbers(text: str, count: int) -> list[int]:
    """Read `count` numbers of up to 32 bits. Raises ValueError for anything else."""
    if not re.fullmatch(rf"[0-9a-fA-F]{{1,8}}(,[0-9a-fA-F]{{1,8}}){{{count - 1}}}", text):
        raise ValueError(f"got {text!r}, expected {count} hexadecimal numbers")
    return [int(part, 16) for part in text.split(",")]


def _register(number: str) -> Register:
    return REGISTERS[numbers(number, 1)[0]]


def _word(value: int) -> bytes:
    return value.to_bytes(4, "little")


def _in_flash(address: int, size: int) -> bool:
    return FLASH_BASE <= address <= FLASH_BASE + FLASH_BYTES - size
