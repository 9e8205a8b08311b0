"""Strict registers: every access of the image is checked against the vendor's table first.

A peripheral is a `Device`: its registers are words by name, and methods `read_cr1` and `write_cr1` stand
where reading or writing does more than to keep a value. `Registers` puts devices behind the engine's bus,
refuses what the chip's manual refuses, and counts what the image touches.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property, reduce
from operator import or_
from pathlib import Path
from typing import Any, NoReturn

from neuroflight.sim.board.core.context import Kept
from neuroflight.sim.board.core.engine import Engine
from neuroflight.toolchain.errors import BuildError

TABLE = Path(__file__).with_name("registers.json")
WINDOW = 0x400  # the engine attaches peripherals in windows of this many bytes
WORD = 0xFFFFFFFF
_BLOCK_MAX = 0x1000  # the description gives one USB block 250 KiB, of which a word is used
_EXTERNAL = 0x60000000  # external memory and the core's own registers: the engine's, but for DBGMCU


@dataclass(frozen=True)
class Field:
    """Bits `lsb` to `lsb + width - 1` of a register."""

    name: str
    lsb: int
    width: int
    access: str  # r, w or rw
    modelled: bool

    @cached_property
    def mask(self) -> int:
        return ((1 << self.width) - 1) << self.lsb


@dataclass(frozen=True)
class Register:
    """One register of a peripheral as the vendor describes it."""

    name: str
    offset: int  # bytes from the peripheral's base
    modelled: bool
    reset: int
    access: str  # r, w or rw
    sizes: tuple[int, ...]  # bytes an access may have
    fields: dict[str, Field]

    @cached_property
    def reserved(self) -> int:
        """Bits that no field covers; they keep their reset value."""
        return WORD & ~self._mask(lambda field: True)

    @cached_property
    def unmodelled(self) -> int:
        """Bits of fields that a program may write but the emulator does not know."""
        return self._mask(lambda field: not field.modelled and "w" in field.access) & ~self.writable

    @cached_property
    def writable(self) -> int:
        """Bits of fields that take what is written."""
        return self._mask(lambda field: field.modelled and "w" in field.access)

    def _mask(self, wanted: Callable[[Field], bool]) -> int:
        return reduce(or_, (field.mask for field in self.fields.values() if wanted(field)), 0)


@dataclass(frozen=True)
class Block:
    """A peripheral's registers; none if the emulator does not model it."""

    name: str
    base: int
    size: int  # bytes
    registers: dict[str, Register]


@dataclass(frozen=True)
class Table:
    """The chip as its vendor describes it, with what the emulator models of it."""

    sha256: str  # of the description
    blocks: dict[str, Block]
    interrupts: dict[str, int]

    def interrupt(self, name: str) -> int:
        """Return the number of interrupt `name`, e.g. "EXTI3"."""
        return self.interrupts[name]

    def find(self, address: int) -> tuple[Block, Register | None] | None:
        """Return the peripheral and register at `address`; None if the chip has none."""
        for block in self.blocks.values():
            if block.base <= address < block.base + block.size:
                offset = address - block.base & ~3
                return block, next((r for r in block.registers.values() if r.offset == offset), None)
        return None


def digest(rows: dict[str, Any]) -> str:
    """Compute SHA-256 of a table's interrupts and peripherals, so that an edit by hand is noticed."""
    kept = [rows["interrupts"], rows["peripherals"]]
    return hashlib.sha256(json.dumps(kept).encode()).hexdigest()


@cache
def load_table(path: Path = TABLE) -> Table:
    """Load the committed table. Raises BuildError if it was edited by hand."""
    data = json.loads(path.read_text())
    if data["rows_sha256"] != digest(data):
        raise BuildError(f"{path}: its rows are not those that were extracted; extract it again")
    return Table(
        data["sha256"],
        {name: _block(name, block) for name, block in data["peripherals"].items()},
        data["interrupts"],
    )


def _block(name: str, data: dict[str, Any]) -> Block:
    registers = {r["name"]: _register(r) for r in data["registers"]}
    return Block(name, int(data["base"], 16), int(data["size"], 16), registers)


def _register(data: dict[str, Any]) -> Register:
    return Register(
        name=data["name"],
        offset=int(data["offset"], 16),
        modelled="fields" in data,
        reset=int(data.get("reset", "0"), 16),
        access=data.get("access", ""),
        sizes=tuple(data.get("sizes", ())),
        fields={n: Field(n, f[0], f[1], f[2], bool(f[3])) for n, f in data.get("fields", {}).items()},
    )


class Device(Kept):
    """A peripheral of the chip: registers as words by name, and what happens around them."""

    kept: tuple[str, ...] = ("words",)

    def __init__(self, engine: Engine, name: str) -> None:
        self.engine = engine
        self.name = name
        self.block = load_table().blocks[name]
        self.gate = ""  # the bit that clocks it, "RCC_AHB1ENR GPIOAEN"; empty: always clocked
        self.clocked = True
        self.clears: frozenset[str] = frozenset()  # registers of flags that a 1 clears: all ones are no error
        self.words = self._reset_words()

    @property
    def interrupts(self) -> tuple[int, ...]:
        """The interrupt lines that it drives."""
        return ()

    def _reset_words(self) -> dict[str, int]:
        return {r.name: r.reset for r in self.block.registers.values() if r.modelled}

    def reset(self) -> None:
        """Return to the state after a reset of the chip or by the peripheral's bit in RCC."""
        self.words = self._reset_words()

    def counts(self, register: Register) -> tuple[int, int] | None:
        """Return how often `register` was read and written, if the bus does not count that."""
        return None

    def mask(self, register: str, *fields: str) -> int:
        return sum(self.block.registers[register].fields[field].mask for field in fields)

    def get(self, register: str, field: str) -> int:
        found = self.block.registers[register].fields[field]
        return (self.words[register] & found.mask) >> found.lsb

    def put(self, register: str, field: str, value: int) -> None:
        found = self.block.registers[register].fields[field]
        self.words[register] = self.words[register] & ~found.mask | value << found.lsb & found.mask

    def keep(self, register: str, value: int) -> int:
        """Store what was written to the writable fields; returns the bits that changed."""
        writable = self.block.registers[register].writable
        before = self.words[register]
        self.words[register] = before & ~writable | value & writable
        return before ^ self.words[register]


class _Slot:
    """A register in its place: the device behind it and how often it was touched."""

    __slots__ = ("answer", "device", "fixed", "plain", "read", "reads", "register", "write", "writes")

    def __init__(self, device: Device, register: Register) -> None:
        self.device, self.register = device, register
        name = register.name
        self.fixed = 0 if name in device.clears else register.reserved | register.unmodelled
        self.read: Callable[[], int] = getattr(device, f"read_{name.lower()}", lambda: device.words[name])
        self.write: Callable[[int], object] = getattr(
            device, f"write_{name.lower()}", lambda value: device.keep(name, value)
        )
        self.plain = "r" in register.access and 4 in register.sizes  # a word can be read
        self.answer: int | None = None  # the engine's number, where it reads the same until something happens
        self.reads = self.writes = 0


@dataclass(frozen=True)
class Touch:
    """The counts of reads and writes of a register by the image."""

    register: str  # "RCC_CR"
    reads: int
    writes: int


class _Window:
    """1 KiB of the address space behind the engine's bus: the registers of one or more devices."""

    def __init__(self, engine: Engine, base: int) -> None:
        self._engine, self.base = engine, base
        self.blocks: list[Block] = []
        self.devices: list[Device] = []
        self.companions: list[Kept] = []
        self.slots: dict[int, _Slot] = {}

    @property
    def name(self) -> str:
        """Blocks that begin in it, or the one that goes on in it with the distance from its base."""
        return " and ".join(
            block.name + (f"+0x{self.base - block.base:X}" if self.base > block.base else "")
            for block in self.blocks
        )

    def add(self, device: Device) -> None:
        self.devices.append(device)
        for register in device.block.registers.values():
            if register.modelled:
                offset = device.block.base + register.offset - self.base
                self.slots[offset] = _Slot(device, register)

    def read(self, offset: int, size: int) -> int:
        slot = self.slots.get(offset)
        if slot is not None and slot.plain and size == 4 and slot.device.clocked:
            slot.reads += 1
            value = slot.read()
            if slot.answer is not None:
                self._engine.answer(slot.answer, value)
            return value
        slot = self._slot(offset, size, "read")
        if "r" not in slot.register.access:
            self._fail(slot, "is read, but it is write-only")
        slot.reads += 1
        value = slot.read()
        if size == 4:
            return value
        return value >> 8 * (offset & 3) & (1 << 8 * size) - 1

    def write(self, offset: int, size: int, value: int) -> None:
        slot = self._slot(offset, size, "write")
        register = slot.register
        if "w" not in register.access:
            self._fail(slot, "is written, but it is read-only")
        slot.writes += 1
        if size != 4:
            shift = 8 * (offset & 3)
            old = slot.device.words[register.name] if "r" in register.access else 0
            value = old & ~(((1 << 8 * size) - 1) << shift) & WORD | value << shift
        if (value ^ register.reset) & slot.fixed:
            self._reject_bits(slot, value)
        slot.write(value)

    def reset(self) -> None:
        for device in self.devices:
            device.reset()

    def count_answers(self) -> None:
        """Count reads that the engine has answered itself."""
        for slot in self.slots.values():
            if slot.answer is not None:
                slot.reads += self._engine.answered(slot.answer)

    def state(self) -> Any:  # noqa: ANN401
        self.count_answers()
        return {
            "devices": [device.state() for device in self.devices],
            "companions": [companion.state() for companion in self.companions],
            "touched": {offset: (slot.reads, slot.writes) for offset, slot in self.slots.items()},
        }

    def restore(self, state: Any) -> None:  # noqa: ANN401
        self.count_answers()
        for device, saved in zip(self.devices, state["devices"], strict=True):
            device.restore(saved)
        for companion, saved in zip(self.companions, state["companions"], strict=True):
            companion.restore(saved)
        for offset, counts in state["touched"].items():
            self.slots[offset].reads, self.slots[offset].writes = counts

    def explain(self, offset: int, size: int, value: int | None) -> None:
        """Raise the error of an access that C has rejected. `value`: written; None: a read."""
        slot = self._slot(offset, size, "read" if value is None else "write")
        if value is None:
            self._fail(slot, "is read, but it is write-only")
        if "w" not in slot.register.access:
            self._fail(slot, "is written, but it is read-only")
        self._reject_bits(slot, value)

    def _slot(self, offset: int, size: int, verb: str) -> _Slot:
        """Return the register at `offset`. Raises the error that it cannot be accessed so."""
        slot = self.slots.get(offset & ~3)
        if slot is None:
            self._reject_address(self.base + offset, verb)
        if not slot.device.clocked:
            done = "read" if verb == "read" else "written"
            self._fail(slot, f"is {done} without its clock: {slot.device.gate} is 0")
        if size not in slot.register.sizes:
            widths = " or ".join(str(8 * size) for size in slot.register.sizes)
            self._fail(slot, f"has a {verb} of {8 * size} bits, but takes {widths}")
        return slot

    def _reject_address(self, address: int, verb: str) -> NoReturn:
        found = load_table().find(address)
        where = f"{verb} at 0x{address:08X}"
        if found is None:
            self._engine.fail(f"{where}: the chip has no register there")
        block, register = found
        if register is None and block.registers:
            self._engine.fail(f"{where}: {block.name} has no register there")
        name = block.name if register is None else f"{block.name}_{register.name}"
        self._engine.fail(f"{where}: {name} is not modelled")

    def _reject_bits(self, slot: _Slot, value: int) -> None:
        register = slot.register
        wrong = (value ^ register.reset) & slot.fixed
        if wrong & register.reserved:
            self._fail(slot, f"= 0x{value:08X} changes reserved bits 0x{wrong & register.reserved:08X}")
        fields = [
            f.name
            for f in register.fields.values()
            if not f.modelled and "w" in f.access and f.mask & wrong & ~register.writable
        ]
        self._fail(slot, f"= 0x{value:08X} sets {', '.join(fields)}, which the emulator does not model")

    def _fail(self, slot: _Slot, message: str) -> NoReturn:
        self._engine.fail(f"{slot.device.name}_{slot.register.name} {message}")


class Registers:
    """All windows of the chip's peripherals, modelled or not, so that each wrong access is named."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._windows: dict[int, _Window] = {}
        self.devices: dict[str, Device] = {}
        for block in load_table().blocks.values():
            size = min(block.size, _BLOCK_MAX)
            for base in range(block.base & ~(WINDOW - 1), block.base + size, WINDOW):
                window = self._windows.setdefault(base, _Window(engine, base))
                window.blocks.append(block)

    def _window(self, device: Device) -> _Window:
        return self._windows[device.block.base & ~(WINDOW - 1)]

    def add(self, device: Device) -> None:
        self.devices[device.name] = device
        self._window(device).add(device)

    def accompany(self, device: Device, companion: Kept) -> None:
        """Put `companion` into snapshots with `device`, which was added before."""
        self._window(device).companions.append(companion)

    def keep_answers(self, device: Device, *names: str) -> None:
        """Let the engine answer reads of these registers with the last value.

        `device` says when that may have changed, by `Engine.forget_answers`; a store to its window does, too.
        """
        window = self._window(device)
        for name in names:
            offset = device.block.base + device.block.registers[name].offset - window.base
            window.slots[offset].answer = self._engine.new_answer(window.base + offset)

    def window_name(self, device: Device) -> str:
        """Return the engine's name of the window that `device` answers in."""
        return self._window(device).name

    def explain(self, device: Device, offset: int, size: int, value: int | None) -> None:
        """Raise the error of an access to `device`'s window."""
        self._window(device).explain(offset, size, value)

    def attach(self, engine: Engine) -> None:
        """Put every window behind the engine's bus."""
        for base, window in sorted(self._windows.items()):
            if base >= _EXTERNAL and not window.devices:
                continue
            engine.attach(base, WINDOW, window, window.name)

    def touched(self) -> tuple[Touch, ...]:
        """Return every register that the image touched, in order of address."""
        touched = []
        for _, window in sorted(self._windows.items()):
            window.count_answers()
            for _, slot in sorted(window.slots.items()):
                counts = slot.device.counts(slot.register) or (slot.reads, slot.writes)
                if any(counts):
                    touched.append(Touch(f"{slot.device.name}_{slot.register.name}", *counts))
        return tuple(touched)

    def state(self) -> Any:  # noqa: ANN401
        return {base: window.state() for base, window in self._windows.items() if window.devices}

    def restore(self, state: Any) -> None:  # noqa: ANN401
        for base, saved in state.items():
            self._windows[base].restore(saved)
