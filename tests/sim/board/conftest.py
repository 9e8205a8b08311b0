"""A plain context for peripherals: time moves when a test says so, memory is a few arrays."""

from __future__ import annotations

import heapq
import struct
from collections.abc import Callable
from functools import partial
from typing import Any, NoReturn

import pytest

from sim.board.board import Hardware
from sim.board.core.context import BoardError
from sim.board.native.callbacks import BoardEngine
from sim.board.registers.bus import load_table
from tests.sim.board.programs import attach, boot, compile_program, results  # noqa: F401 - fixtures
from toolchain.contract import DTCM, FLASH_BASE, FLASH_BYTES, ITCM, SRAM1, SRAM2

MICROSECOND = 216


class FakeAlarm:
    """sim.board.core.context.Alarm."""

    def __init__(self, context: FakeContext, order: int, callback: Callable[[], None]) -> None:
        self._context, self._order, self._callback = context, order, callback
        self.due: int | None = None

    def set(self, cycle: int) -> None:
        self.due = cycle
        heapq.heappush(self._context.queue, (cycle, self._order, self))

    def cancel(self) -> None:
        self.due = None

    def go_off(self) -> None:
        self.due = None
        self._callback()

    def __lt__(self, other: FakeAlarm) -> bool:
        return self._order < other._order


class FakeContext:
    """sim.board.core.context.Context without a core."""

    def __init__(self) -> None:
        self.cycle = 0
        self.queue: list[tuple[int, int, FakeAlarm]] = []
        self.alarms: list[FakeAlarm] = []
        self.lines: dict[int, bool] = {}
        self.nmis = 0
        self.cache = False
        self.core_hz = 16_000_000
        self.busy_until: int | None = None
        self.resets: list[str] = []
        self.notes: list[str] = []
        self.listeners: list[Callable[[str], None]] = []
        self.sleepers: list[Callable[[], None]] = []
        self.regions = {
            base: bytearray(data)
            for base, data in (
                (FLASH_BASE, b"\xff" * FLASH_BYTES),
                *((r.address, bytes(r.size)) for r in (ITCM, DTCM, SRAM1, SRAM2)),
                (0x1FF07000, bytes(0x1000)),
            )
        }

    def alarm(self, name: str, callback: Callable[[], None]) -> FakeAlarm:
        self.alarms.append(FakeAlarm(self, len(self.alarms), callback))
        return self.alarms[-1]

    def irq(self, number: int, asserted: bool) -> None:
        self.lines[number] = asserted

    def nmi(self) -> None:
        self.nmis += 1

    def load(self, address: int, size: int) -> int:
        return int.from_bytes(self.memory(address, size), "little")

    def store(self, address: int, size: int, value: int) -> None:
        self.set_memory(address, value.to_bytes(size, "little"))

    def memory(self, address: int, size: int) -> bytes:
        data, offset = self._place(address)
        return bytes(data[offset : offset + size])

    def set_memory(self, address: int, data: bytes) -> None:
        memory, offset = self._place(address)
        memory[offset : offset + len(data)] = data

    def is_cached(self, address: int) -> bool:
        return self.cache

    def data_cache_on(self) -> bool:
        return self.cache

    def core_clock(self, hz: int) -> None:
        self.core_hz = hz

    def flash_busy(self, until: int | None) -> None:
        self.busy_until = until

    def system_reset(self, cause: str) -> None:
        self.resets.append(cause)

    def on_system_reset(self, callback: Callable[[str], None]) -> None:
        self.listeners.append(callback)

    def on_sleep(self, callback: Callable[[], None]) -> None:
        self.sleepers.append(callback)

    def on_flash_store(self, callback: Callable[[int, int, int], None]) -> None:
        self.flash_store = callback

    def note(self, message: str) -> None:
        self.notes.append(message)

    def fail(self, message: str) -> NoReturn:
        raise BoardError(message)

    # For tests

    def run_to(self, cycle: int) -> None:
        """Time passes until `cycle`; alarms go off on the way."""
        while self.queue and self.queue[0][0] <= cycle:
            due, _, alarm = heapq.heappop(self.queue)
            if alarm.due == due:
                self.cycle = max(self.cycle, due)
                alarm.go_off()
        self.cycle = max(self.cycle, cycle)

    def run(self, microseconds: float) -> None:
        self.run_to(self.cycle + round(microseconds * MICROSECOND))

    def sleep(self) -> None:
        """As a core that executes WFI."""
        for sleeper in self.sleepers:
            sleeper()

    def asserted(self, name: str) -> bool:
        """Whether interrupt line `name` is up."""
        return self.lines.get(load_table().interrupt(name), False)

    def _place(self, address: int) -> tuple[bytearray, int]:
        for base, data in self.regions.items():
            if base <= address < base + len(data):
                return data, address - base
        raise AssertionError(f"no memory at 0x{address:08X}")


WAIT = struct.pack("<IIHH", 0x20010000, 0x00200009, 0xBF30, 0xE7FD)  # vectors; wfi, and again


class WatchedEngine(BoardEngine):
    """Notes what a core that only waits would not show."""

    core_hz = 16_000_000
    nmis = 0

    def core_clock(self, hz: int) -> None:
        self.core_hz = hz
        super().core_clock(hz)

    def nmi(self) -> None:
        self.nmis += 1


class EngineContext:
    """The engine, with a core that only waits, as a test sees it."""

    def __init__(self) -> None:
        self.engine = WatchedEngine(WAIT)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.engine, name)

    @property
    def cache(self) -> bool:
        return self.engine.data_cache_on()

    @cache.setter
    def cache(self, on: bool) -> None:
        ccr = self.engine.load(0xE000ED14, 4)
        self.engine.store(0xE000ED14, 4, ccr & ~(1 << 16) | on << 16)

    def run_to(self, cycle: int) -> None:
        try:
            self.engine.run_to(cycle)
        except BoardError:
            self.forgive()
            raise

    def run(self, microseconds: float) -> None:
        self.run_to(self.engine.cycle + round(microseconds * MICROSECOND))

    def sleep(self) -> None:
        """The core executes WFI and sleeps."""
        self.run_to(self.engine.cycle + 1)

    def forgive(self) -> None:
        """After what a test has seen raised."""
        self.engine.forget_failure()
        self.engine.library.engine_restored(self.engine.handle)

    def asserted(self, name: str) -> bool:
        """Whether interrupt line `name` is up: a pending bit that cannot be cleared."""
        number = load_table().interrupt(name)
        self.engine.store(0xE000E280 + number // 32 * 4, 4, 1 << number % 32)
        return bool(self.engine.load(0xE000E200 + number // 32 * 4, 4) >> number % 32 & 1)


class Bench:
    """The board's hardware with a program's view of it: registers by name.

    kind: "python", the classes alone, or "c", the busy ones in C and an engine around them.
    """

    def __init__(self, kind: str = "python", **options: Any) -> None:
        self.context: Any = FakeContext() if kind == "python" else EngineContext()
        self.hardware = Hardware(getattr(self.context, "engine", self.context), **options)
        self._table = load_table()
        self._engine: BoardEngine | None = getattr(self.context, "engine", None)
        if self._engine is not None:
            self._engine.power_cycle()

    def address(self, name: str) -> int:
        """Of "RCC_CR"; of "ADC_Common_CCR" too."""
        block, _, register = name.rpartition("_")
        found = self._table.blocks[block]
        return found.base + found.registers[register].offset

    def read(self, name: str, size: int = 4) -> int:
        return self.load(self.address(name), size)

    def write(self, name: str, value: int, size: int = 4) -> None:
        self.store(self.address(name), size, value)

    def load(self, address: int, size: int) -> int:
        if self._engine is None:
            return self.hardware.registers.read(address, size)
        value = self._engine.load(address, size)
        self._raise()
        return value

    def store(self, address: int, size: int, value: int) -> None:
        if self._engine is None:
            self.hardware.registers.write(address, size, value)
        else:
            self._engine.store(address, size, value)
            self._raise()

    def _raise(self) -> None:
        assert self._engine is not None
        try:
            self._engine.raise_now()
        except BoardError:
            self.context.forgive()
            raise

    def bits(self, name: str, *fields: str) -> int:
        """The mask of fields of a register."""
        block, _, register = name.rpartition("_")
        found = self._table.blocks[block].registers[register]
        return sum(found.fields[field].mask for field in fields)

    def set(self, name: str, **fields: int) -> None:
        """Change fields of a register as a program does: read, modify, write."""
        block, _, register = name.rpartition("_")
        known = self._table.blocks[block].registers[register].fields
        value = self.read(name)
        for field, wanted in fields.items():
            value = value & ~known[field].mask | wanted << known[field].lsb
        self.write(name, value)

    def get(self, name: str, field: str) -> int:
        block, _, register = name.rpartition("_")
        found = self._table.blocks[block].registers[register].fields[field]
        return (self.read(name) & found.mask) >> found.lsb

    def reset(self, cause: str) -> None:
        """As the engine resets the chip."""
        if self._engine is not None:
            self._engine.system_reset(cause)
            self._engine.run_to(self._engine.cycle + 1)
            return
        for alarm in self.context.alarms:
            alarm.cancel()
        self.context.lines.clear()
        for listener in self.context.listeners:
            listener(cause)
        for device in self.hardware.registers.devices.values():
            device.reset()

    def full_speed(self) -> None:
        """216 MHz by HSE, PLL and over-drive, and all clocks of peripherals on."""
        self.set("RCC_CR", HSEON=1)
        self.context.run(2500)
        self.set("RCC_APB1ENR", PWREN=1)
        self.set("RCC_PLLCFGR", PLLSRC=1, PLLM=4, PLLN=216, PLLP=0, PLLQ=9)
        self.set("RCC_CR", PLLON=1)
        self.set("PWR_CR1", ODEN=1)
        self.context.run(400)
        self.set("PWR_CR1", ODSWEN=1)
        self.context.run(100)
        self.set("FLASH_ACR", LATENCY=7)
        self.set("RCC_CFGR", PPRE1=5, PPRE2=4)
        self.set("RCC_CFGR", SW=2)
        self.set("RCC_AHB1ENR", GPIOAEN=1, GPIOBEN=1, GPIOCEN=1, GPIODEN=1, DMA1EN=1, DMA2EN=1)
        self.set("RCC_APB1ENR", USART2EN=1, TIM3EN=1, USART3EN=1)
        self.set("RCC_APB2ENR", SPI1EN=1, TIM8EN=1, TIM1EN=1, USART1EN=1, ADC1EN=1, SYSCFGEN=1)

    def alternate(self, pin: str, function: int) -> None:
        """Give a pin such as "PA5" to a peripheral."""
        port, number = f"GPIO{pin[1]}", int(pin[2:])
        register = "AFRL" if number < 8 else "AFRH"
        self.set(f"{port}_{register}", **{f"{register}{number}": function})
        self.set(f"{port}_MODER", **{f"MODER{number}": 2})


@pytest.fixture
def kind() -> str:
    """Which peripherals a test is about; a module may ask for those in C as well."""
    return "python"


@pytest.fixture
def make_bench(kind: str) -> Callable[..., Bench]:
    """Makes a board with options of its own."""
    return partial(Bench, kind)


@pytest.fixture
def bench(kind: str) -> Bench:
    """The board after power-up."""
    return Bench(kind)


@pytest.fixture
def fast(bench: Bench) -> Bench:
    """The board at 216 MHz."""
    bench.full_speed()
    return bench
