"""The board's hardware around a core that only waits: tests read and write registers as a program would."""

from __future__ import annotations

import struct
from typing import Any

import pytest

from neuroflight.sim.board.board import Hardware
from neuroflight.sim.board.core.context import BoardError
from neuroflight.sim.board.core.engine import Engine
from neuroflight.sim.board.devices.gyro_mpu import MPU6500
from neuroflight.sim.board.native.library import native_library
from neuroflight.sim.board.registers.bus import load_table
from tests.sim.board.programs import boot, compile_program  # noqa: F401 - fixtures

MICROSECOND = 216


WAIT = struct.pack("<IIHH", 0x20010000, 0x00200009, 0xBF30, 0xE7FD)  # vectors; wfi, and again


class WatchedEngine(Engine):
    """Records calls whose effects a core that only waits does not show."""

    core_hz = 16_000_000
    busy_until: int | None = None
    nmis = 0

    def core_clock(self, hz: int) -> None:
        self.core_hz = hz
        super().core_clock(hz)

    def flash_busy(self, until: int | None) -> None:
        self.busy_until = until
        super().flash_busy(until)

    def nmi(self) -> None:
        self.nmis += 1


class EngineContext:
    """The engine, with a core that only waits, as a test sees it."""

    def __init__(self) -> None:
        self.engine = WatchedEngine(WAIT, library=native_library())

    def __getattr__(self, name: str) -> Any:
        return getattr(self.engine, name)

    @property
    def cache(self) -> bool:
        return bool(self.engine.load(0xE000ED14, 4) >> 16 & 1)

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
    """The board's hardware with a program's view of it: registers by name."""

    def __init__(self, **options: Any) -> None:
        self.context: Any = EngineContext()
        self._engine: Engine = self.context.engine
        self.hardware = Hardware(self._engine, **{"chip": MPU6500, **options})  # its data is read the fastest
        self._table = load_table()
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
        value = self._engine.load(address, size)
        self._raise()
        return value

    def store(self, address: int, size: int, value: int) -> None:
        self._engine.store(address, size, value)
        self._raise()

    def _raise(self) -> None:
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
        self._engine.system_reset(cause)
        self._engine.run_to(self._engine.cycle + 1)

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
        self.set("RCC_APB1ENR", USART2EN=1, TIM3EN=1, USART3EN=1, SPI3EN=1)
        self.set("RCC_APB2ENR", SPI1EN=1, TIM8EN=1, TIM1EN=1, USART1EN=1, ADC1EN=1, SYSCFGEN=1)

    def alternate(self, pin: str, function: int) -> None:
        """Give a pin such as "PA5" to a peripheral."""
        port, number = f"GPIO{pin[1]}", int(pin[2:])
        register = "AFRL" if number < 8 else "AFRH"
        self.set(f"{port}_{register}", **{f"{register}{number}": function})
        self.set(f"{port}_MODER", **{f"MODER{number}": 2})

    def stream(
        self, stream: str, peripheral: int, memory: int, count: int, options: int, *, enable: bool = True
    ) -> None:
        """Set up a DMA stream such as "DMA2_S5"; options: of its CR."""
        for register, value in (("PAR", peripheral), ("M0AR", memory), ("NDTR", count), ("CR", options)):
            self.write(f"{stream}{register}", value)
        if enable:
            self.set(f"{stream}CR", EN=1)


@pytest.fixture
def make_bench() -> type[Bench]:
    """Makes a board with options of its own."""
    return Bench


@pytest.fixture
def bench() -> Bench:
    """The board after power-up."""
    return Bench()


@pytest.fixture
def fast(bench: Bench) -> Bench:
    """The board at 216 MHz."""
    bench.full_speed()
    return bench
