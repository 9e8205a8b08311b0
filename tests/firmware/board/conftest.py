"""The MATEKF722 image around a policy of the shipped size, built once, and a model of its board (Sketch)."""

from __future__ import annotations

import io
import itertools
import os
import struct
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import unicorn
from elftools.elf.elffile import ELFFile
from elftools.elf.sections import SymbolTableSection
from unicorn import UC_ARCH_ARM, UC_HOOK_CODE, UC_HOOK_MEM_READ, UC_HOOK_MEM_WRITE, UC_MODE_THUMB
from unicorn.arm_const import (
    UC_ARM_REG_LR,
    UC_ARM_REG_PC,
    UC_ARM_REG_R0,
    UC_ARM_REG_R1,
    UC_ARM_REG_R2,
    UC_ARM_REG_R3,
    UC_ARM_REG_SP,
    UC_CPU_ARM_CORTEX_M7,
)

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.board.registers.core_registers import Register
from neuroflight.sim.control.pid_table import pid_table
from neuroflight.toolchain.boards.allocation import allocate
from neuroflight.toolchain.boards.description import pack
from neuroflight.toolchain.boards.table import find_board
from neuroflight.toolchain.codegen.compiler import compile_policy
from neuroflight.toolchain.contract import (
    DTCM,
    FLASH_BASE,
    FLASH_BYTES,
    ITCM,
    SRAM1,
    SRAM2,
    observation_blocks,
)
from neuroflight.toolchain.files import locked, write_bytes_if_changed, write_text_if_changed
from neuroflight.toolchain.image.bank_state import proven
from neuroflight.toolchain.image.build import BOARD_FAMILY, BOARD_TABLE
from neuroflight.toolchain.ir.network import chain
from neuroflight.toolchain.ir.operations import Clip, Linear, Operation, Tanh
from neuroflight.toolchain.policy.model import PolicyModel
from neuroflight.toolchain.rendering.contract_header import render_contract
from neuroflight.toolchain.rendering.pid_table import render_pid_table
from tests.conftest import BUILD
from tests.firmware.board.registers import registers_in_use

ROOT = Path(__file__).resolve().parents[3]
WIDTHS = (6, 64, 64, 4)
CONTROL_HZ = 1000

FLASH_ALIAS = 0x00200000  # where BOOT_ADD0 makes the core fetch its first vectors
GARBAGE = 0xA5  # what RAM holds at power-up
STEPS_MAX = 20_000_000
ARGUMENTS = (UC_ARM_REG_R0, UC_ARM_REG_R1, UC_ARM_REG_R2, UC_ARM_REG_R3)
RETURN = FLASH_BASE + 0x3F00  # an address that no code uses, where `call` ends
WFI = b"\x30\xbf"
TICKS_MAX = 2000  # milliseconds that a start-up sleeps, at most

CHIP_READ = 0x80  # of a register's address on the gyro chip's bus
CHIP_SELECT = 2  # of port C, active low
MSP_RX = 10  # of port A: the line rests high

# Ready bit <- enable bit, in the same or a neighbouring register.
FOLLOWS = {
    "RCC_CR": (("HSIRDY", "RCC_CR", "HSION"), ("HSERDY", "RCC_CR", "HSEON"), ("PLLRDY", "RCC_CR", "PLLON")),
    "RCC_CFGR": (("SWS", "RCC_CFGR", "SW"),),
    "SYST_CSR": (("COUNTFLAG", "SYST_CSR", "ENABLE"),),
    "PWR_CSR1": (("ODRDY", "PWR_CR1", "ODEN"), ("ODSWRDY", "PWR_CR1", "ODSWEN")),
}
APB1 = ("SPI2", "SPI3", "USART2", "USART3", "UART4", "UART5")
APB2 = ("SPI1", "USART1", "USART6")
CLOCK_OF = {
    **{f"GPIO{port}": ("RCC_AHB1ENR", f"GPIO{port}EN") for port in "ABCDE"},
    **{f"DMA{number}": ("RCC_AHB1ENR", f"DMA{number}EN") for number in (1, 2)},
    "OTG": ("RCC_AHB2ENR", "OTGFSEN"),
    **{name: ("RCC_APB1ENR", f"{name}EN") for name in ("PWR", *APB1)},
    **{name: ("RCC_APB2ENR", f"{name}EN") for name in ("TIM1", "ADC1", "SYSCFG", *APB2)},
}


def random_policy() -> PolicyModel:
    """A 6-64-64-4 network of random weights, as large as the shipped one."""
    rng = np.random.default_rng(1)
    layers: list[Operation] = []
    for inputs, outputs in itertools.pairwise(WIDTHS):
        weight = rng.normal(0, inputs**-0.5, (outputs, inputs)).astype(np.float32)
        layers += [Linear(weight, np.zeros(outputs, np.float32)), Tanh()]
    return PolicyModel(
        blocks=observation_blocks("rate_error,rate_error_delta"),
        control_rate_hz=CONTROL_HZ,
        filters=(),
        aircraft="random",
        aircraft_sha256="0" * 64,
        training={},
        source_sha256="0" * 64,
        network=chain(WIDTHS[0], [*layers[:-1], Clip(0.0, 1.0)]),
    )


@pytest.fixture(scope="session")
def image_folder() -> Path:
    """Where make has left neuroflight.elf, .bin and .hex."""
    folder = BUILD / "random"
    with locked(folder):
        make_image(folder)
    return folder / "build"


def make_image(scratch: Path) -> None:
    """Build it into a folder of `scratch`, what has changed of it."""
    emission, pid = compile_policy(random_policy()).emission, pid_table(load_aircraft("nf1"))
    write_text_if_changed(scratch / "policy.c", emission.source)
    write_text_if_changed(scratch / "policy.h", emission.header)
    write_text_if_changed(scratch / "nf_contract.h", render_contract())
    write_text_if_changed(scratch / "pid_table.c", render_pid_table(pid, WIDTHS[-1], CONTROL_HZ))
    write_bytes_if_changed(scratch / "build" / BOARD_TABLE, pack(allocate(find_board("MATEKF722"))))
    firmware = ROOT / "firmware"
    named = [
        f"{name}={os.path.relpath(path, firmware)}"
        for name, path in (("GENERATED", scratch), ("BUILD", scratch / "build"))
    ]
    make = ["make", "-s", f"-j{os.cpu_count() or 1}", "-C", str(firmware), f"TARGET={BOARD_FAMILY}", *named]
    done = subprocess.run(make, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="session")
def elf(image_folder: Path) -> ELFFile:
    """The linked image."""
    return ELFFile(io.BytesIO((image_folder / "neuroflight.elf").read_bytes()))


@pytest.fixture(scope="session")
def symbols(elf: ELFFile) -> dict[str, int]:
    """Address of every name the image defines, bit 0 set for Thumb code."""
    table = elf.get_section_by_name(".symtab")
    assert isinstance(table, SymbolTableSection)
    return {s.name: s["st_value"] for s in table.iter_symbols() if s["st_shndx"] != "SHN_UNDEF"}


@pytest.fixture(scope="session")
def registers() -> tuple[Register, ...]:
    """Those that the firmware touches, as the vendor describes them."""
    return registers_in_use()


def processor() -> Any:
    uc = unicorn.Uc(UC_ARCH_ARM, UC_MODE_THUMB)  # type: ignore[attr-defined, no-untyped-call]
    uc.ctl_set_cpu_model(UC_CPU_ARM_CORTEX_M7)  # type: ignore[no-untyped-call]
    return uc


class Sketch:
    """The board as far as start-up needs it. `dead` names ready bits that never come true;
    the cycle counter moves by `cycles_a_read` whenever it is read, so that waits pass quickly, and a sleep is
    a millisecond.

    Registers are memory with the vendor's reset values, ready bits follow their enable bits, nothing answers
    on SPI unless a test does. It minds what the chip minds and notes it in `sins`: registers nobody stated,
    reserved bits, peripherals without their clock.
    """

    def __init__(
        self,
        elf: ELFFile,
        registers: Sequence[Register],
        dead: frozenset[str] = frozenset(),
        cycles_a_read: int = 20000,
    ) -> None:
        self._made_of = elf, registers
        names = elf.get_section_by_name(".symtab")
        assert isinstance(names, SymbolTableSection)
        counter = names.get_symbol_by_name("milliseconds_passed")
        assert counter is not None
        self._milliseconds = int(counter[0]["st_value"])
        self.by_address = {r.address: r for r in registers}
        self.by_name = {(r.name, r.instance): r for r in registers}
        self.by_index = {(r.name, r.instance, r.index): r for r in registers}
        self.dead = dead
        self.cycles, self.cycles_a_read = 0, cycles_a_read
        self.sins: list[str] = []
        self.resets = 0  # asked for by software
        self.seen: set[int] = set()  # addresses of executed instructions
        self.on_code: Callable[[int], None] = self.seen.add
        self.on_write: Callable[[Register, int], None] = lambda register, value: None
        self.on_read: Callable[[Register], None] = lambda register: None
        self.uc = processor()
        for base, size in (
            *((FLASH_ALIAS, FLASH_BYTES), (FLASH_BASE, FLASH_BYTES)),
            *((ram.address, ram.size) for ram in (ITCM, DTCM, SRAM1, SRAM2)),
            *((0x1FF07000, 0x1000), (0x40000000, 0x80000), (0x50000000, 0x4000), (0xE0000000, 0x100000)),
        ):
            self.uc.mem_map(base, size)
        self.uc.mem_write(FLASH_BASE, b"\xff" * FLASH_BYTES)
        for segment in elf.iter_segments("PT_LOAD"):
            if segment["p_filesz"]:
                self.uc.mem_write(segment["p_paddr"], segment.data())
        flash = proven(bytes(self.uc.mem_read(FLASH_BASE, FLASH_BYTES)))
        self.uc.mem_write(FLASH_BASE, flash)
        self.uc.mem_write(FLASH_ALIAS, flash)
        for ram in (ITCM, DTCM, SRAM1, SRAM2):
            self.uc.mem_write(ram.address, bytes([GARBAGE]) * ram.size)
        self.reset_registers()
        self.uc.hook_add(UC_HOOK_MEM_READ, self._read, begin=0x40000000, end=0xFFFFFFFF)
        self.uc.hook_add(UC_HOOK_MEM_WRITE, self._write, begin=0x40000000, end=0xFFFFFFFF)
        self.uc.hook_add(UC_HOOK_CODE, lambda uc, address, size, data: self.on_code(address))

    def reset_registers(self) -> None:
        """As after a reset; memory keeps what it holds."""
        for register in self.by_address.values():
            self.poke(register.address, register.reset or 0)
        self.poke(self.by_name["GPIO_IDR", "GPIOA"].address, 1 << MSP_RX)

    def copy(self) -> Sketch:
        """Another board, whose memory and stack are as this one's: for calls of functions."""
        other = Sketch(*self._made_of, self.dead, self.cycles_a_read)
        for begin, end, _ in self.uc.mem_regions():
            other.uc.mem_write(begin, bytes(self.uc.mem_read(begin, end - begin + 1)))
        other.uc.reg_write(UC_ARM_REG_SP, self.uc.reg_read(UC_ARM_REG_SP))
        other.cycles, other.seen = self.cycles, set(self.seen)
        other.on_code = other.seen.add
        return other

    def peek(self, address: int) -> int:
        return int(struct.unpack("<I", self.uc.mem_read(address, 4))[0])

    def poke(self, address: int, value: int) -> None:
        self.uc.mem_write(address, struct.pack("<I", value & 0xFFFFFFFF))

    def field(self, register: str, field: str, instance: str = "", index: str = "") -> int:
        """index: of a DMA controller's stream."""
        instance = instance or register.split("_")[0]
        known = self.by_index[register, instance, index] if index else self.by_name[register, instance]
        found = next(f for f in known.fields if f.name == field)
        return (self.peek(known.address) & found.mask) >> found.lsb

    def run(self, until: int) -> None:
        """From reset to the code address `until`."""
        self.run_for(STEPS_MAX, until)
        assert self.uc.reg_read(UC_ARM_REG_PC) == until & ~1, hex(self.uc.reg_read(UC_ARM_REG_PC))

    def run_for(self, steps: int, until: int = 0xFFFFFFFF) -> None:
        """From reset, `steps` instructions at most."""
        stack, reset = struct.unpack("<II", self.uc.mem_read(FLASH_ALIAS, 8))
        self.uc.reg_write(UC_ARM_REG_SP, stack)
        self.uc.ctl_flush_tb()  # what an earlier run translated does not know this one's end
        for _ in range(TICKS_MAX):
            self.uc.emu_start(reset, until & ~1, count=steps)
            reset = self.uc.reg_read(UC_ARM_REG_PC) | 1
            if reset & ~1 == until & ~1 or bytes(self.uc.mem_read((reset & ~1) - 2, 2)) != WFI:
                break
            self.poke(self._milliseconds, self.peek(self._milliseconds) + 1)

    def call(self, function: int) -> None:
        """Run a handler of the image as the core would on its interrupt, on top of what `run` left."""
        self.uc.reg_write(UC_ARM_REG_LR, RETURN | 1)
        self.uc.emu_start(function | 1, RETURN, count=STEPS_MAX)
        assert self.uc.reg_read(UC_ARM_REG_PC) == RETURN, hex(self.uc.reg_read(UC_ARM_REG_PC))

    def call_to_reset(self, function: int, *arguments: int, stack: int | None = None) -> None:
        """Call a function of the image that ends in a reset; `stack`: with this stack pointer."""
        for register, value in zip(ARGUMENTS, arguments, strict=False):
            self.uc.reg_write(register, value)
        if stack is not None:
            self.uc.reg_write(UC_ARM_REG_SP, stack)
        before = self.resets
        self.uc.emu_start(function | 1, RETURN, count=STEPS_MAX)
        assert self.resets == before + 1, hex(self.uc.reg_read(UC_ARM_REG_PC))

    def call_with(self, function: int, *arguments: int) -> int:
        """Call a function of the image with up to four integers; returns its result."""
        for register, value in zip(ARGUMENTS, arguments, strict=False):
            self.uc.reg_write(register, value)
        self.call(function)
        return int(self.uc.reg_read(UC_ARM_REG_R0))

    def _read(self, uc: Any, access: int, address: int, size: int, value: int, data: object) -> None:
        register = self.by_address.get(address)
        if register is None:
            self.sins.append(f"read of 0x{address:08X}, which is no register in use")
            return
        self._mind_clock(register.instance)
        if register.name == "DWT_CYCCNT":
            self.cycles += self.cycles_a_read
            self.poke(address, self.cycles)
        self.on_read(register)
        for ready, source, enable in FOLLOWS.get(register.name, ()):
            found = next(f for f in register.fields if f.name == ready)
            if ready not in self.dead:
                on = self.field(source, enable) << found.lsb
                self.poke(address, (self.peek(address) & ~found.mask) | on)

    def _write(self, uc: Any, access: int, address: int, size: int, value: int, data: object) -> None:
        register = self.by_address.get(address & ~3)
        if register is None or "w" not in register.access:
            self.sins.append(f"write of 0x{address:08X}, which is no writable register in use")
            return
        self._mind_clock(register.instance)
        fields = sum(f.mask for f in register.fields)
        if register.source == "svd" and (value ^ (register.reset or 0)) & 0xFFFFFFFF & ~fields:
            self.sins.append(
                f"{register.name} of {register.instance} = 0x{value & 0xFFFFFFFF:08X}: reserved bits"
            )
        self.on_write(register, value & 0xFFFFFFFF)
        if register.name == "SCB_AIRCR" and value & 0xFFFFFFFF == 0x05FA0004:  # key and SYSRESETREQ
            self.resets += 1
            self.uc.emu_stop()

    def _mind_clock(self, instance: str) -> None:
        if instance in CLOCK_OF and not self.field(*CLOCK_OF[instance]):
            self.sins.append(f"{instance} used without its clock")


class Chip:
    """The gyro chip at the other end of SPI1: registers, byte by byte. Notes what breaks its rules."""

    def __init__(self, sketch: Sketch, identity: int, told_at: int = 0x75) -> None:
        self.sketch = sketch
        self.registers = {told_at: identity}
        self.written: list[tuple[int, int]] = []
        self.broken_rules: list[str] = []
        self._bytes: list[int] = []
        self._selected = self._full = False
        self._answer = 0
        sketch.on_write, sketch.on_read = self._on_write, self._on_read

    def _on_write(self, register: Register, value: int) -> None:
        if register.name == "GPIO_BSRR" and register.instance == "GPIOC":
            if value >> 16 >> CHIP_SELECT & 1:
                self._selected, self._bytes = True, []
            elif value >> CHIP_SELECT & 1:
                self._selected = False
        if register.name != "SPI_DR":
            return
        if not self._selected:
            self.broken_rules.append("a byte without chip select")
        if 108e6 / (2 << self.sketch.field("SPI_CR1", "BR", "SPI1")) > 1e6:
            self.broken_rules.append("a register faster than 1 MHz")
        self._bytes.append(value)
        if len(self._bytes) > 1:
            address = self._bytes[0] & ~CHIP_READ
            self._answer = self.registers.get(address, 0)
            if not self._bytes[0] & CHIP_READ:
                self.written.append((address, value))
                self.registers[address] = value
        self._full = True

    def _on_read(self, register: Register) -> None:
        if register.name == "SPI_SR":
            self.sketch.poke(register.address, 2 | self._full)  # TXE, RXNE
        if register.name == "SPI_DR":
            self.sketch.poke(register.address, self._answer)
            self._full = False


@pytest.fixture(scope="session")
def make_chip() -> Callable[..., Chip]:
    """Puts a gyro chip of some identity onto a sketch's SPI bus."""
    return Chip


@pytest.fixture(scope="session")
def make_sketch(elf: ELFFile, registers: Sequence[Register]) -> Callable[..., Sketch]:
    """Makes a board with the image in its flash; `dead` names ready bits that never come true."""
    return lambda **options: Sketch(elf, registers, **options)


@pytest.fixture(scope="session")
def make_booted(make_sketch: Callable[..., Sketch], symbols: dict[str, int]) -> Callable[[], Sketch]:
    """Makes boards without a gyro chip in their background loop; reset and start-up ran once for all."""
    first = make_sketch()
    first.run(symbols["msp_lines_serve"])
    return first.copy
