"""FLASH: wait states, keys, erasing and programming with their real times, and power loss meanwhile.

Programming clears bits only. The image must not ask for a 1 where a 0 is: the chip would answer with the
bitwise and of both. An operation cut short leaves arbitrary bits behind, here from a seed: see `Cut`.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from enum import Enum, auto

from neuroflight.sim.board.core.engine import Engine
from neuroflight.sim.board.peripherals.option_bytes import OptionBytes
from neuroflight.sim.board.peripherals.rcc import MICROSECOND
from neuroflight.sim.board.registers.bus import Device, load_table
from neuroflight.toolchain.contract import FLASH_BASE, FLASH_BYTES, FLASH_SECTORS

KEYS = (0x45670123, 0xCDEF89AB)  # RM0431 3.3.5
OPTION_KEYS = (0x08192A3B, 0x4C5D6E7F)  # RM0431 3.4.2
# Typical times by parallelism PSIZE 0 to 2 (8, 16, 32 bits), data sheet DS11853, flash memory programming.
PROGRAM_CYCLES = 16 * MICROSECOND
ERASE_MS = {16: (400, 300, 250), 64: (1200, 700, 550), 128: (2000, 1300, 1000)}  # by sector size [KiB]
MASS_ERASE_MS = (8000, 5500, 4000)
_OPTIONS_MS = 250  # as the smallest sector
_MILLISECOND = 1000 * MICROSECOND
_ERRORS = ("OPERR", "WRPERR", "PGAERR", "PGPERR", "ERSERR")
_UNPROTECTED = 0xAA
_WORD_BYTES = 4


class Cut(Enum):
    """Ways in which an interrupted operation leaves what it was to change."""

    BEFORE = auto()  # all as it was
    AFTER = auto()  # all as asked for
    BETWEEN = auto()  # each bit the one or the other
    WORDS = auto()  # each word the one or the other
    NOISE = auto()  # any bits


class Flash(Device):
    """The flash controller. CPU stores to flash reach it by `program`."""

    kept = (
        *("words", "_keys", "_option_keys", "_pending"),
        *("operations", "options", "cut_at", "cut"),
    )

    def __init__(self, engine: Engine, options: OptionBytes | None = None, seed: int = 0) -> None:
        self.options = options or OptionBytes()
        super().__init__(engine, "FLASH")
        self.on_latency: Callable[[], None] = lambda: None
        self.on_begin: Callable[[str], None] = lambda what: None  # gets what is about to be done; may fail
        self.operations = 0  # erasures, programmed units and option writes begun since the board was made
        self.cut_at: int | None = None  # power goes in the middle of this operation, counted from 0
        self.cut = Cut.BETWEEN
        self._seed = seed
        self._irq = load_table().interrupt("FLASH")
        self._keys: list[int] = []
        self._option_keys: list[int] = []
        self._pending: tuple[str, int, int, int] | None = None  # kind, address, size, value
        self._done = engine.alarm("flash.done", self._finish)
        self._cut = engine.alarm("flash.cut", self._lose_power)
        self._load_options()
        engine.on_flash_store(self.program)

    def reset(self) -> None:
        if self._pending:
            self._spoil()
        super().reset()
        self.engine.forget_answers()
        self._load_options()
        self._keys, self._option_keys, self._pending = [], [], None
        self._done.cancel()
        self._cut.cancel()
        self.engine.flash_busy(None)
        self.engine.irq(self._irq, False)

    def put(self, register: str, field: str, value: int) -> None:
        """See Device; the program polls what it changes."""
        super().put(register, field, value)
        self.engine.forget_answers()

    def latency(self) -> int:
        return self.get("ACR", "LATENCY")

    @property
    def busy_until(self) -> int | None:
        """End of the present operation [cycle]; None: there is none."""
        return self._done.due

    def program(self, address: int, size: int, value: int) -> None:
        """Store `value` of `size` bytes from the CPU to flash at `address`, through the AXI bus."""
        fail, where = self.engine.fail, f"flash at 0x{address:08X}"
        if not FLASH_BASE <= address <= FLASH_BASE + FLASH_BYTES - size:
            fail(f"{where} is written, expected 0x{FLASH_BASE:08X} and up: its alias is read-only")
        if self._pending:
            fail(f"{where} is written while the controller is busy, expected FLASH_SR BSY 0 before")
        if self.get("CR", "LOCK") or not self.get("CR", "PG"):
            fail(
                f"{where} is written, but FLASH_CR LOCK is {self.get('CR', 'LOCK')} "
                f"and PG {self.get('CR', 'PG')}"
            )
        if size != 1 << self.get("CR", "PSIZE"):
            fail(
                f"{where} is written by {8 * size} bits, expected {8 << self.get('CR', 'PSIZE')} "
                f"by FLASH_CR PSIZE"
            )
        if self.options.protects(_sector_of(address)):
            self._raise("WRPERR")
            return
        old = int.from_bytes(self.engine.memory(address, size), "little")
        if value & ~old:
            fail(
                f"{where} is 0x{old:0{2 * size}X} and is to become 0x{value:0{2 * size}X}: "
                f"programming a 1 over a 0; expected an erased place or only bits to clear"
            )
        self._begin(("program", address, size, value), PROGRAM_CYCLES)

    # What the image writes

    def write_acr(self, value: int) -> None:
        if value & self.mask("ACR", "ARTRST") and self.get("ACR", "ARTEN"):
            self.engine.fail("FLASH_ACR ARTRST is set while ARTEN is 1, expected the accelerator off")
        self.keep("ACR", value)
        self.on_latency()

    def write_keyr(self, value: int) -> None:
        self._key(self._keys, KEYS, value, "FLASH_KEYR", "CR", "LOCK")

    def write_optkeyr(self, value: int) -> None:
        self._key(self._option_keys, OPTION_KEYS, value, "FLASH_OPTKEYR", "OPTCR", "OPTLOCK")

    def write_sr(self, value: int) -> None:
        for field in ("EOP", *_ERRORS):
            if value & self.mask("SR", field):
                self.put("SR", field, 0)
        self._update_irq()

    def write_cr(self, value: int) -> None:
        if not self._opens("CR", "LOCK", "KEYR", value):
            return
        self.words["CR"] = value & ~self.mask("CR", "STRT")
        if self.get("CR", "LOCK"):
            self._keys = []
        if value & self.mask("CR", "STRT"):
            self._start()
        self._update_irq()

    def write_optcr(self, value: int) -> None:
        if not self._opens("OPTCR", "OPTLOCK", "OPTKEYR", value):
            return
        self.words["OPTCR"] = value & ~self.mask("OPTCR", "OPTSTRT")
        if value & self.mask("OPTCR", "OPTLOCK"):
            self._option_keys = []
        if value & self.mask("OPTCR", "OPTSTRT"):
            rdp = self.get("OPTCR", "RDP")
            if rdp != _UNPROTECTED:
                self.engine.fail(f"option bytes: RDP 0x{rdp:02X} would lock the chip, expected 0xAA")
            self._begin(("options", 0, 0, 0), _OPTIONS_MS * _MILLISECOND)

    def _opens(self, register: str, lock: str, keys: str, value: int) -> bool:
        """Return whether `register` takes `value`: while it is locked only what it holds may be written."""
        fail, written = self.engine.fail, f"FLASH_{register} is written"
        if self.get(register, lock):
            if value != self.words[register]:
                fail(f"{written} while it is locked, expected both keys in FLASH_{keys} before")
            return False
        if self._pending:
            fail(f"{written} while the controller is busy, expected FLASH_SR BSY 0 before")
        return True

    def _start(self) -> None:
        fail, parallel = self.engine.fail, self.get("CR", "PSIZE")
        if parallel == 3:
            fail("FLASH_CR PSIZE is 3, which needs an external voltage; expected 0, 1 or 2")
        modes = [name for name in ("PG", "SER", "MER") if self.get("CR", name)]
        if modes == ["SER"]:
            number = self.get("CR", "SNB")
            if number >= len(FLASH_SECTORS):
                fail(f"FLASH_CR SNB is {number}, expected 0 to {len(FLASH_SECTORS) - 1}")
            sector = FLASH_SECTORS[number]
            if self.options.protects(number):
                self._raise("WRPERR")
                return
            time = ERASE_MS[sector.size >> 10][parallel] * _MILLISECOND
            self._begin(("erase", sector.address, sector.size, 0), time)
        elif modes == ["MER"]:
            self._begin(("erase", FLASH_BASE, FLASH_BYTES, 0), MASS_ERASE_MS[parallel] * _MILLISECOND)
        else:
            got = " and ".join(modes) or "neither SER nor MER"
            fail(f"FLASH_CR STRT is set with {got}, expected one of SER and MER")

    def _key(
        self, given: list[int], keys: tuple[int, int], value: int, name: str, register: str, lock: str
    ) -> None:
        if not self.get(register, lock) or value != keys[len(given)]:
            self.engine.fail(
                f"{name} = 0x{value:08X}, expected 0x{keys[len(given) % 2]:08X} while locked: "
                f"the chip stays locked until reset"
            )
        given.append(value)
        if len(given) == len(keys):
            given.clear()
            self.put(register, lock, 0)

    def _begin(self, operation: tuple[str, int, int, int], cycles: int) -> None:
        now = self.engine.cycle
        kind, address, _, _ = operation
        verb = {"program": "programmed", "erase": "erased"}.get(kind)
        self.on_begin("option bytes are written" if verb is None else f"flash at 0x{address:08X} is {verb}")
        self._pending = operation
        self.put("SR", "BSY", 1)
        self.engine.flash_busy(now + cycles)
        self._done.set(now + cycles)
        if self.operations == self.cut_at:
            self._cut.set(now + cycles // 2)
        self.operations += 1

    def _finish(self) -> None:
        assert self._pending is not None
        kind, address, size, value = self._pending
        self._pending = None
        self.put("SR", "BSY", 0)
        self.engine.flash_busy(None)
        if kind == "program":
            old = int.from_bytes(self.engine.memory(address, size), "little")
            self.engine.set_memory(address, (old & value).to_bytes(size, "little"))
        elif kind == "erase":
            self.engine.set_memory(address, b"\xff" * size)
        else:
            self.options = self.options.with_registers(
                self.words["OPTCR"], self.words["OPTCR1"], self.words["OPTCR2"]
            )
        if self.get("CR", "EOPIE"):
            self.put("SR", "EOP", 1)
        self._update_irq()

    def _lose_power(self) -> None:
        self.cut_at = None
        self._spoil()
        self.engine.system_reset("power")

    def _spoil(self) -> None:
        """Interrupt the present operation: of the bits that were to change, arbitrary ones have."""
        assert self._pending is not None
        kind, address, size, value = self._pending
        self._pending = None
        self._done.cancel()
        if kind != "options":
            old = int.from_bytes(self.engine.memory(address, size), "little")
            new = old & value if kind == "program" else (1 << 8 * size) - 1
            left = _torn(self.cut, old, new, size, random.Random(self._seed * 1_000_003 + self.operations))
            self.engine.set_memory(address, left.to_bytes(size, "little"))

    def _raise(self, error: str) -> None:
        self.put("SR", error, 1)
        if self.get("CR", "ERRIE"):
            self.put("SR", "OPERR", 1)
        self._update_irq()

    def _update_irq(self) -> None:
        end = self.get("SR", "EOP") and self.get("CR", "EOPIE")
        self.engine.irq(self._irq, bool(end or (self.get("SR", "OPERR") and self.get("CR", "ERRIE"))))

    def _load_options(self) -> None:
        self.words["OPTCR"] = self.options.optcr | self.mask("OPTCR", "OPTLOCK")
        self.words["OPTCR1"], self.words["OPTCR2"] = self.options.optcr1, self.options.optcr2


def _torn(cut: Cut, old: int, new: int, size: int, rng: random.Random) -> int:
    """Return the interrupted result of `size` bytes that were to become `new` from `old`."""
    if cut in (Cut.BEFORE, Cut.AFTER):
        return old if cut is Cut.BEFORE else new
    some = rng.getrandbits(8 * size)
    if cut is Cut.NOISE:
        return some
    if cut is Cut.WORDS:
        whole = (1 << 8 * min(size, _WORD_BYTES)) - 1
        some = sum(whole << 8 * at for at in range(0, size, _WORD_BYTES) if rng.getrandbits(1))
    return old & some | new & ~some


def _sector_of(address: int) -> int:
    return next(i for i, s in enumerate(FLASH_SECTORS) if s.address <= address < s.address + s.size)
