"""The emulated core: memory, time, exceptions and what peripherals need of them. `c/` does the work.

Time advances by `cpi` cycles of the core for each executed instruction, by 12, 10 and 6 cycles for entry,
return and tail-chaining of an exception, and by WFI to the next event. The same image, peripherals and calls
give the same run to the bit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from enum import IntEnum
from fractions import Fraction
from pathlib import Path
from typing import Any, NoReturn

from unicorn import arm_const

from neuroflight.sim.board.core.context import BoardError, Peripheral
from neuroflight.sim.board.core.library import load_library
from neuroflight.sim.board.core.source_places import Places
from neuroflight.sim.compiled import Library
from neuroflight.toolchain.contract import FLASH_BASE, FLASH_BYTES

CPI = Fraction(163, 100)  # of the shipped policy as llvm-mca prices it: docs/explanation/timing.md
FLASH_ALIAS = 0x00200000  # BOOT_ADD0's default: the core fetches its vectors here (RM0431 2.4)
NEVER = 2**64 - 1
FRACTION = 16  # bits of the engine's time below a cycle
ITCM_BYTES = 0x4000
CODE_HALFWORDS = (ITCM_BYTES + FLASH_BYTES) // 2
POWER_UP = 0xA5  # what RAM holds then
RAM = ((0x00000000, ITCM_BYTES), (0x20000000, 0x40000))

CORE_REGISTERS = (
    *(getattr(arm_const, f"UC_ARM_REG_R{i}") for i in range(13)),
    *(arm_const.UC_ARM_REG_SP, arm_const.UC_ARM_REG_LR),
)
XPSR, CONTROL = arm_const.UC_ARM_REG_XPSR, arm_const.UC_ARM_REG_CONTROL
NUMBERED = (  # of unicorn, by the number of `register`; pc is kept by the engine itself
    *(*CORE_REGISTERS, arm_const.UC_ARM_REG_PC, XPSR),
    *(arm_const.UC_ARM_REG_S0 + i for i in range(32)),
    *(arm_const.UC_ARM_REG_FPSCR, arm_const.UC_ARM_REG_MSP, arm_const.UC_ARM_REG_PSP),
    *(arm_const.UC_ARM_REG_PRIMASK, arm_const.UC_ARM_REG_BASEPRI, arm_const.UC_ARM_REG_FAULTMASK, CONTROL),
)
_SPSEL, _FPCA, _SFPA = 2, 4, 8  # of CONTROL; SFPA is ARMv8-M's, which unicorn's core wants beside FPCA


class Outcome(IntEnum):
    """Reasons for which the core stopped: `enum outcome` of api.h."""

    REACHED = 0  # the cycle asked for
    LIMIT = 1  # the instructions asked for
    BREAKPOINT = 2
    RESET = 3
    FAILED = 4
    ASLEEP = 5  # in WFI with nothing that could end it
    WATCHPOINT = 6  # `Engine.watch_hit` tells which


_OUTCOMES = tuple(Outcome)


@dataclass(frozen=True)
class Watchpoint:
    """Memory whose accesses by the core stop it; not those of DMA, nor the frames of exceptions."""

    address: int
    size: int  # bytes
    loads: bool
    stores: bool


@dataclass(frozen=True)
class Note:
    """A note for the report."""

    message: str
    cycle: int  # the first time
    place: str
    times: int


class Alarm:
    """A callback at a set time. Snapshots keep it by its name."""

    def __init__(self, engine: Engine, number: int) -> None:
        """Wrap the alarm that C knows by `number`."""
        self._engine, self.number = engine, number

    @property
    def due(self) -> int | None:
        """Cycle of the callback; None: not set."""
        due = int(self._engine.library.engine_due(self._engine.handle, self.number))
        return None if due == NEVER else due

    def set(self, cycle: int) -> None:
        """Call back at `cycle`, instead of any time set before; at once after this instruction if passed."""
        self._engine.library.engine_set_alarm(self._engine.handle, self.number, max(cycle, 0))

    def cancel(self) -> None:
        self._engine.library.engine_set_alarm(self._engine.handle, self.number, NEVER)


class Engine:
    """A Cortex-M7 in its memory, without peripherals until they are attached."""

    def __init__(
        self,
        flash: bytes,
        *,
        elf: Path | None = None,
        cpi: Fraction = CPI,
        strict: bool = True,
        profile: bool = False,
        library: Library | None = None,
    ) -> None:
        """Flash holds `flash` and is erased behind it; the core stands at its first instruction.

        elf: the image's, for the names and lines of its code. strict: a fault of the core is an error of the
        image; else the program's fault handler runs. profile: keep the tree of calls.
        library: one with more in it than the core.
        Raises BuildError when the engine cannot be built or `elf` is none, ValueError on a wrong argument.
        """
        if len(flash) > FLASH_BYTES:
            raise ValueError(f"an image of {len(flash)} bytes, the flash holds {FLASH_BYTES}")
        if not Fraction(1, 4) <= cpi <= 64:
            raise ValueError(f"{cpi} cycles an instruction, expected 1/4 to 64")
        self.places = Places(elf) if elf is not None else None
        loaded = library or load_library()
        self.ffi, self.library = loaded.ffi, loaded.lib
        self.profiled = profile
        self._functions = self._function_table() if profile else self.ffi.NULL
        fixed = round(cpi * (1 << FRACTION))
        self._free = self.library.engine_free  # looked up now: see Native
        self.handle = self.library.engine_new(fixed, strict, profile, self._functions)
        error = self.library.engine_open(self.handle)
        if error:
            raise RuntimeError(f"unicorn does not open: error {error}")
        self.cpi, self.strict, self.vectors = cpi, strict, FLASH_ALIAS
        self.peripherals: dict[str, Peripheral] = {}
        self.windows: dict[str, int] = {}
        self.alarms: dict[str, Alarm] = {}
        self.notes: dict[str, Note] = {}
        self.resets: list[str] = []
        self._reads: list[Callable[[int, int], int]] = []
        self._writes: list[Callable[[int, int, int], None]] = []
        self._rings: list[Callable[[], None]] = []
        self._reset_listeners: list[Callable[[str], None]] = []
        self.after_run: Callable[[], None] = lambda: None  # delivers what C has buffered
        self._flash_store: Callable[[int, int, int], None] | None = None
        self.on_rom: Callable[[], None] = lambda: self.fail("the program runs in the ROM, which is empty")
        self._error: BaseException | None = None
        self._cause = ""
        self._bound: dict[int, Any] = {}  # names of bounded interrupts, which C only points to
        self._closed = False
        self.callbacks = self._make_callbacks()
        self.library.engine_callbacks(self.handle, self.callbacks)
        self.set_memory(FLASH_BASE, flash)
        self._reset("power")

    def __del__(self) -> None:
        self.close()

    def close(self) -> None:
        """Free the memory; the engine cannot be used afterwards."""
        if not getattr(self, "_closed", True):
            self._closed = True
            self._free(self.handle)

    # ---- running ----

    def run_to(self, cycle: int) -> None:
        """Run until `cycle`; resets of the chip happen on the way. Raises BoardError."""
        while self.run(cycle) is Outcome.RESET:
            pass

    def run(self, cycle: int = NEVER, instructions: int = NEVER) -> Outcome:
        """Run until `cycle`, for at most `instructions`, or to a breakpoint or a reset, done by then.

        Raises BoardError for what the image did wrong, and what a peripheral raised.
        """
        outcome: Outcome = _OUTCOMES[self.library.engine_run(self.handle, cycle, instructions)]
        self.after_run()
        if outcome is Outcome.RESET:
            self._reset(self._cause or "software")
        elif outcome is Outcome.FAILED:
            message = self.ffi.string(self.library.engine_message(self.handle)).decode()
            raise self._error or BoardError(f"{message}; {self.place()}")
        return outcome

    def power_cycle(self) -> None:
        """Switch the supply off and on: RAM is lost, flash stays."""
        self._reset("power")

    def pull_reset(self) -> None:
        """Reset the chip by its NRST pin, between two runs; an error that `run` raised is cleared."""
        self._reset("pin")

    def _reset(self, cause: str) -> None:
        self._cause, self._error = "", None
        self.resets.append(cause)
        if cause == "power":
            for address, size in RAM:
                self.set_memory(address, bytes([POWER_UP]) * size)
        self.library.engine_reset(self.handle, self.vectors)
        for listener in self._reset_listeners:
            listener(cause)
        for peripheral in self.peripherals.values():
            peripheral.reset()

    def forget_failure(self) -> None:
        """Clear a failure, after the state before it has been restored."""
        self._error, self._cause = None, ""

    def place(self, address: int | None = None) -> str:
        """Describe `address`, or the program's place."""
        pc = self.pc if address is None else address
        if self.places is None:
            return f"pc 0x{pc:08X}"
        return self.places.describe(code_address(pc))

    # ---- the core from outside ----

    @property
    def pc(self) -> int:
        """Address of the instruction at hand, or of the next one."""
        return int(self.library.engine_pc(self.handle))

    @pc.setter
    def pc(self, address: int) -> None:
        self.library.engine_set_pc(self.handle, address)

    def register(self, number: int) -> int:
        """Return a register's 32 bits.

        number: r0 to r12, sp (13), lr (14), pc (15), xPSR (16), s0 to s31 (17 to 48), FPSCR (49), MSP (50),
        PSP (51), PRIMASK (52), BASEPRI (53), FAULTMASK (54), CONTROL (55).
        """
        if number == 15:
            return self.pc
        value = int(self.library.engine_register(self.handle, NUMBERED[number]))
        if NUMBERED[number] == CONTROL:
            return value & ~_SFPA & ~(_SPSEL if self.depth else 0)
        return value

    def set_register(self, number: int, value: int) -> None:
        if number == 15:
            self.pc = value
            return
        if NUMBERED[number] == CONTROL:
            value = value & ~_SFPA | (_SFPA if value & _FPCA else 0)
        self.library.engine_set_register(self.handle, NUMBERED[number], value)

    @property
    def depth(self) -> int:
        """Number of active exceptions; 0: the thread runs."""
        return int(self.library.engine_counts(self.handle).depth)

    @property
    def instructions(self) -> int:
        """Executed so far, those skipped under a condition included."""
        return int(self.library.engine_counts(self.handle).instructions)

    @property
    def accesses(self) -> int:
        """To peripherals so far."""
        return int(self.library.engine_counts(self.handle).accesses)

    @property
    def trace_hash(self) -> int:
        """Hash of all jumps, exceptions and their times so far: equal runs have equal hashes."""
        return int(self.library.engine_counts(self.handle).hash)

    @property
    def sleeping(self) -> bool:
        """True in WFI."""
        return bool(self.library.engine_counts(self.handle).sleeping)

    def clock(self, on: bool = True) -> None:
        """Begin or stop measuring how this computer's time is spent."""
        self.library.engine_clock(self.handle, on)

    @property
    def spent_s(self) -> tuple[float, float]:
        """Since `clock` [s]: in unicorn with the engine's hooks, in peripherals and their alarms."""
        code, devices = self.library.engine_spent(self.handle)[0:2]
        return code / 1e9, devices / 1e9

    @property
    def symbols(self) -> dict[str, int]:
        """Address of every name of the ELF; empty without one."""
        return {} if self.places is None else {n: s.address for n, s in self.places.symbols.items()}

    def set_breakpoints(self, addresses: Iterable[int]) -> None:
        """Stop before the instructions at `addresses`, and nowhere else. Raises ValueError above 64."""
        wanted = sorted(set(addresses))
        if self.library.engine_set_breakpoints(self.handle, wanted, len(wanted)):
            raise ValueError(f"{len(wanted)} breakpoints, at most 64")

    def set_watchpoints(self, watchpoints: Iterable[Watchpoint]) -> None:
        """Stop before each instruction that accesses one of these, at most 32. Raises ValueError.

        Inside an IT block nothing stops: an access there stops the core behind the block.
        """
        wanted = list(watchpoints)
        rows = self.ffi.new("struct watchpoint[]", [(w.address, w.size, w.loads, w.stores) for w in wanted])
        if self.library.engine_set_watchpoints(self.handle, rows, len(wanted)):
            raise ValueError(f"{len(wanted)} watchpoints, at most 32")

    @property
    def watch_hit(self) -> tuple[int, int]:
        """Index of the watchpoint that stopped the core last, and the first watched address accessed."""
        hit = self.library.engine_watch_hit(self.handle)
        return int(hit.number), int(hit.address)

    def bound_entry(self, irq: int, cycles: int, name: str = "", *, urgent: bool = False) -> None:
        """Fail from now on if `irq` waits more than `cycles` for its handler; 0: no limit.

        Waiting for code outside flash while flash is erased or programmed is allowed. name: of the source.
        urgent: fail as well if another enabled interrupt cannot be interrupted by `irq`.
        """
        self._bound[irq] = self.ffi.new("char[]", (name or f"interrupt {irq}").encode())
        self.library.engine_bound_entry(self.handle, 16 + irq, cycles, self._bound[irq], urgent)

    def skip_breakpoint(self) -> None:
        """Let the next instruction run, once, in spite of break- and watchpoints on it."""
        self.library.engine_skip_breakpoint(self.handle)

    # ---- for peripherals, from their constructors on ----

    def attach(self, base: int, size: int, peripheral: Peripheral, name: str) -> None:
        """Attach `peripheral` at `base` to `base + size - 1`, both 1 KiB aligned. `name`: "USART1".

        Raises ValueError if the place is taken.
        """
        number = self.library.engine_attach(self.handle, base, size)
        if number < 0:
            raise ValueError(
                f"{name} at 0x{base:08X}, {size} bytes: taken, not aligned or no place of peripherals"
            )
        self.windows[name] = number
        self.peripherals[name] = peripheral
        self._reads.append(peripheral.read)
        self._writes.append(peripheral.write)

    @property
    def cycle(self) -> int:
        """Present time, in cycles of 216 MHz; inside an access: the time of that access."""
        return int(self.library.engine_cycle(self.handle))

    def alarm(self, name: str, callback: Callable[[], None]) -> Alarm:
        """Create an alarm, not yet set. `name` is unique on the board ("usart1.tx"). Call this in the
        constructor.

        At one cycle alarms go off in the order of their creation.
        """
        if name in self.alarms:
            raise ValueError(f"two alarms named {name}")
        number = self.library.engine_new_alarm(self.handle)
        if number < 0:
            raise ValueError(f"no room for the alarm {name}")
        self.alarms[name] = Alarm(self, number)
        self._rings.append(callback)
        return self.alarms[name]

    def new_answer(self, address: int) -> int:
        """Return the number of an answer for the register at `address`, in a window. Raises ValueError.

        A register that a program polls is read from its peripheral once, until something happens there.
        """
        number = int(self.library.engine_new_answer(self.handle, address))
        if number < 0:
            raise ValueError(f"no room for an answer of 0x{address:08X}, or no window is there")
        return number

    def answer(self, number: int, value: int) -> None:
        """Let that register's word read as `value` until a store to its window or `forget_answers`."""
        self.library.engine_answer(self.handle, number, value)

    def forget_answers(self) -> None:
        self.library.engine_forget_answers(self.handle)

    def answered(self, number: int) -> int:
        """Return how many reads were answered so since the last call."""
        return int(self.library.engine_answered(self.handle, number))

    def irq(self, number: int, asserted: bool) -> None:
        """Set the level of interrupt line `number` (0..103, as in the vendor's table).

        Keep it asserted as long as flag and enable are; the handler runs again if it leaves them so.
        """
        self.library.engine_irq(self.handle, number, asserted)

    def nmi(self) -> None:
        """Raise the non-maskable interrupt (clock security system)."""
        self.library.engine_nmi(self.handle)

    def load(self, address: int, size: int) -> int:
        """Read as a bus master (DMA) from `address`: memory or, of 1, 2 or 4 bytes, a peripheral."""
        return int(self.library.engine_load(self.handle, address, size))

    def store(self, address: int, size: int, value: int) -> None:
        """Write as a bus master: to RAM or a peripheral. Fails for flash and unused addresses."""
        self.library.engine_store(self.handle, address, size, value)

    def memory(self, address: int, size: int) -> bytes:
        """Return bytes of flash, RAM or system memory, without side effect. Raises ValueError elsewhere."""
        return bytes(self.view(address, size))

    def view(self, address: int, size: int) -> memoryview:
        """Return a view of the engine's bytes: they change as it runs, and are freed with it."""
        found = self.library.engine_memory(self.handle, address, size)
        if not found:
            raise ValueError(f"{size} bytes at 0x{address:08X}: no memory")
        return memoryview(self.ffi.buffer(found, size))

    def set_memory(self, address: int, data: bytes) -> None:
        """Change flash (as its controller does), RAM or system memory; translated code of it is dropped.

        Raises ValueError where nothing is.
        """
        if self.library.engine_poke(self.handle, address, bytes(data), len(data)):
            raise ValueError(f"{len(data)} bytes at 0x{address:08X}: no memory")

    def is_cached(self, address: int) -> bool:
        """Return True if the data cache is on and the MPU lets it hold `address`: DMA must not use it."""
        return bool(self.library.engine_cached(self.handle, address))

    def core_clock(self, hz: int) -> None:
        """Run the core (and DWT, SysTick) at `hz` from now on. After reset: 16 MHz."""
        if not 0 < hz <= 432_000_000:
            raise ValueError(f"a core clock of {hz} Hz, expected up to 432 MHz")
        self.library.engine_core_clock(self.handle, hz)

    def flash_busy(self, until: int | None) -> None:
        """Mark the flash bank as busy until cycle `until` (None: no longer): fetches from it stall."""
        self.library.engine_flash_busy(self.handle, 0 if until is None else until)

    def system_reset(self, cause: str) -> None:
        """Reset the chip after this instruction. `cause`: "software", "iwdg", "pin", "power"."""
        self._cause = self._cause or cause
        self.library.engine_want_reset(self.handle)

    def on_system_reset(self, callback: Callable[[str], None]) -> None:
        """Call `callback(cause)` at every reset before peripherals reset; RCC keeps the cause for its CSR."""
        self._reset_listeners.append(callback)

    def on_flash_store(self, callback: Callable[[int, int, int], None]) -> None:
        """Call `callback(address, size, value)` for what the program stores into flash (0x08000000 on).

        It changes flash by `set_memory` or not at all. Without a callback such a store is a fault.
        """
        self._flash_store = callback

    def note(self, message: str) -> None:
        """Add to the report, with cycle and place; the program continues. Equal messages are counted."""
        first = self.notes.get(message) or Note(message, self.cycle, self.place(), 0)
        self.notes[message] = replace(first, times=first.times + 1)

    def fail(self, message: str) -> NoReturn:
        """Raise BoardError: `message` and the place. `message` names what, got and expected."""
        raise BoardError(f"{message}; {self.place()}")

    # ---- errors of callbacks ----

    def raise_now(self) -> None:
        """Raise what a callback raised outside a run."""
        error, self._error = self._error, None
        if error is not None:
            raise error

    # ---- what C calls ----

    def guarded(self, function: Callable[..., Any], failed: Any = None) -> Callable[..., Any]:  # noqa: ANN401
        """Wrap `function` for C, into which nothing may unwind: C gets `failed` where it raises an error."""

        def call(*arguments: Any) -> Any:  # noqa: ANN401
            try:
                return function(*arguments)
            except BaseException as error:  # raised when the core has come to a stop
                self._error = self._error or error
                self.library.engine_fail(self.handle)
                return failed

        return call

    def _make_callbacks(self) -> Any:  # noqa: ANN401 - struct callbacks
        """Create the callbacks for C; the engine keeps them alive."""
        reads, writes, rings = self._reads, self._writes, self._rings

        def flash(_: object, address: int, size: int, value: int) -> None:
            if self._flash_store is None:
                self.fail(f"a store of 0x{value:X} ({size} bytes) to flash at 0x{address:08X}")
            self._flash_store(address, size, value & (1 << 8 * size) - 1)

        functions = {
            "read": self.guarded(lambda _, window, *access: reads[window](*access), failed=0),
            "write": self.guarded(lambda _, window, *access: writes[window](*access)),
            "alarm": self.guarded(lambda _, alarm: rings[alarm]()),
            "flash": self.guarded(flash),
            "rom": self.guarded(lambda _: self.on_rom()),
        }
        self._kept = {name: self.ffi.callback(f"{name}_callback", f) for name, f in functions.items()}
        return self.ffi.new("struct callbacks *", self._kept)

    def _function_table(self) -> Any:  # noqa: ANN401 - an array of C
        """Return for each halfword of code its function's number in `places.functions` plus one, or 0."""
        table = self.ffi.new(f"uint16_t[{CODE_HALFWORDS}]")
        for number, symbol in enumerate(self.places.functions if self.places else (), 1):
            row = code_row(symbol.address)
            if row is not None:
                for i in range(row, min(row + max(symbol.size, 2) // 2, CODE_HALFWORDS)):
                    table[i] = number
        return table


def code_address(pc: int) -> int:
    """Return `pc` as the linker knows it, with the alias of flash mapped to flash."""
    return pc - FLASH_ALIAS + FLASH_BASE if 0 <= pc - FLASH_ALIAS < FLASH_BYTES else pc


def code_row(address: int) -> int | None:
    """Return the row of counts for the halfword at `address`; None: no code can be there."""
    address = code_address(address)
    if 0 <= address < ITCM_BYTES:
        return address // 2
    if 0 <= address - FLASH_BASE < FLASH_BYTES:
        return (ITCM_BYTES + address - FLASH_BASE) // 2
    return None


def row_address(row: int) -> int:
    """Return the address of a row: the inverse of `code_row`."""
    return 2 * row if row < ITCM_BYTES // 2 else FLASH_BASE + 2 * row - ITCM_BYTES
