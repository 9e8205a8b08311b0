"""The image's first steps, executed: reset, boot part, bank A, clock, set-up, background.

A sketch of the board around an ARM emulator: registers are memory with the vendor's reset values, ready bits
follow their enable bits, nothing answers on SPI. It minds what the chip minds: reserved bits, clocks of
peripherals, the order of the clock switch. The gyro and the motors' frames need the whole emulated board.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

import pytest
import unicorn
from elftools.elf.elffile import ELFFile
from unicorn import UC_ARCH_ARM, UC_HOOK_CODE, UC_HOOK_MEM_READ, UC_HOOK_MEM_WRITE, UC_MODE_THUMB
from unicorn.arm_const import UC_ARM_REG_CONTROL, UC_ARM_REG_PC, UC_ARM_REG_SP, UC_CPU_ARM_CORTEX_M7

from toolchain.contract import DTCM, FLASH_BANK_A, FLASH_BASE, FLASH_BYTES, ITCM
from toolchain.registers import RegisterTable

FLASH_ALIAS = 0x00200000  # where BOOT_ADD0 makes the core fetch its first vectors
GARBAGE = 0xA5  # what RAM holds at power-up
CYCLES_A_READ = 20000  # the cycle counter's step, so that time-outs pass quickly
STEPS_MAX = 3_000_000
STEPS_TO_STOP = 200_000  # start-up and the longest time-out take a third of it

# Ready bit <- enable bit, in the same or a neighbouring register.
FOLLOWS = {
    "RCC_CR": (("HSIRDY", "RCC_CR", "HSION"), ("HSERDY", "RCC_CR", "HSEON"), ("PLLRDY", "RCC_CR", "PLLON")),
    "RCC_CFGR": (("SWS", "RCC_CFGR", "SW"),),
    "PWR_CSR1": (("ODRDY", "PWR_CR1", "ODEN"), ("ODSWRDY", "PWR_CR1", "ODSWEN")),
}
CLOCK_OF = {
    **{f"GPIO{port}": ("RCC_AHB1ENR", f"GPIO{port}EN") for port in "ABC"},
    **{f"DMA{number}": ("RCC_AHB1ENR", f"DMA{number}EN") for number in (1, 2)},
    **{name: ("RCC_APB1ENR", f"{name}EN") for name in ("PWR", "USART2")},
    **{name: ("RCC_APB2ENR", f"{name}EN") for name in ("TIM8", "USART1", "SPI1", "SYSCFG")},
}


def processor() -> Any:  # noqa: ANN401 - unicorn is half typed
    uc = unicorn.Uc(UC_ARCH_ARM, UC_MODE_THUMB)  # type: ignore[attr-defined, no-untyped-call]
    uc.ctl_set_cpu_model(UC_CPU_ARM_CORTEX_M7)  # type: ignore[no-untyped-call]
    return uc


class Sketch:
    """The board as far as start-up needs it. `dead` names ready bits that never come true."""

    def __init__(self, elf: ELFFile, table: RegisterTable, dead: frozenset[str] = frozenset()) -> None:
        self.by_address = {r.address: r for r in table.registers}
        self.by_name = {(r.name, r.instance): r for r in table.registers}
        self.dead = dead
        self.cycles = 0
        self.sins: list[str] = []
        self.seen: set[int] = set()  # addresses of executed instructions
        self.on_write: Callable[[str, int], None] = lambda name, value: None
        self.uc = processor()
        for base, size in (
            *((FLASH_ALIAS, FLASH_BYTES), (FLASH_BASE, FLASH_BYTES)),
            *((ITCM.address, ITCM.size), (DTCM.address, DTCM.size)),
            *((0x1FF07000, 0x1000), (0x40000000, 0x80000), (0xE0000000, 0x100000)),
        ):
            self.uc.mem_map(base, size)
        self.uc.mem_write(FLASH_BASE, b"\xff" * FLASH_BYTES)
        for segment in elf.iter_segments("PT_LOAD"):
            if segment["p_filesz"]:
                self.uc.mem_write(segment["p_paddr"], segment.data())
        self.uc.mem_write(FLASH_ALIAS, bytes(self.uc.mem_read(FLASH_BASE, FLASH_BYTES)))
        for ram in (ITCM, DTCM):
            self.uc.mem_write(ram.address, bytes([GARBAGE]) * ram.size)
        for register in table.registers:
            self.poke(register.address, register.reset or 0)
        self.uc.hook_add(UC_HOOK_MEM_READ, self._read, begin=0x40000000, end=0xFFFFFFFF)
        self.uc.hook_add(UC_HOOK_MEM_WRITE, self._write, begin=0x40000000, end=0xFFFFFFFF)
        self.uc.hook_add(UC_HOOK_CODE, lambda uc, address, size, data: self.seen.add(address))

    def peek(self, address: int) -> int:
        return int(struct.unpack("<I", self.uc.mem_read(address, 4))[0])

    def poke(self, address: int, value: int) -> None:
        self.uc.mem_write(address, struct.pack("<I", value & 0xFFFFFFFF))

    def field(self, register: str, field: str, instance: str = "") -> int:
        known = self.by_name[register, instance or register.split("_")[0]]
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
        self.uc.emu_start(reset, until & ~1, count=steps)

    def _read(self, uc: Any, access: int, address: int, size: int, value: int, data: object) -> None:  # noqa: ANN401
        register = self.by_address.get(address)
        if register is None:
            self.sins.append(f"read of 0x{address:08X}, which is no register in use")
            return
        self._mind_clock(register.instance)
        if register.name == "DWT_CYCCNT":
            self.cycles += CYCLES_A_READ
            self.poke(address, self.cycles)
        for ready, source, enable in FOLLOWS.get(register.name, ()):
            found = next(f for f in register.fields if f.name == ready)
            if ready not in self.dead:
                on = self.field(source, enable) << found.lsb
                self.poke(address, (self.peek(address) & ~found.mask) | on)

    def _write(self, uc: Any, access: int, address: int, size: int, value: int, data: object) -> None:  # noqa: ANN401
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
        self.on_write(register.name, value & 0xFFFFFFFF)

    def _mind_clock(self, instance: str) -> None:
        if instance in CLOCK_OF and not self.field(*CLOCK_OF[instance]):
            self.sins.append(f"{instance} used without its clock")


@pytest.fixture
def sketch(elf: ELFFile, registers: RegisterTable) -> Sketch:
    return Sketch(elf, registers)


def test_the_program_starts_in_place_when_reset(
    sketch: Sketch, elf: ELFFile, symbols: dict[str, int]
) -> None:
    sketch.run(symbols["main"])
    assert symbols["boot_reset"] & ~1 in sketch.seen
    assert sketch.peek(0xE000ED08) == FLASH_BANK_A.address  # VTOR
    assert sketch.field("SCB_CPACR", "CP10") == sketch.field("SCB_CPACR", "CP11") == 3
    for name in (".itcm", ".data"):
        section = elf.get_section_by_name(name)
        assert section is not None
        assert bytes(sketch.uc.mem_read(section["sh_addr"], section["sh_size"])) == section.data()
    size = symbols["bss_end"] - symbols["bss_start"]
    assert bytes(sketch.uc.mem_read(symbols["bss_start"], size)) == bytes(size)
    assert sketch.uc.reg_read(UC_ARM_REG_SP) > DTCM.address
    assert sketch.uc.reg_read(UC_ARM_REG_CONTROL) & 4 == 0  # no floating-point instruction so far
    assert sketch.sins == []


def test_the_core_switches_to_216_mhz_only_when_flash_and_regulator_are_ready(
    sketch: Sketch, symbols: dict[str, int]
) -> None:
    switched = []

    def on_write(name: str, value: int) -> None:
        if name == "RCC_CFGR" and value & 3 == 2:
            switched.append(
                {
                    "wait states": sketch.field("FLASH_ACR", "LATENCY"),
                    "over-drive": sketch.field("PWR_CSR1", "ODSWRDY"),
                    "PLL locked": sketch.field("RCC_CR", "PLLRDY"),
                    "APB1, APB2": (value >> 10 & 7, value >> 13 & 7),
                }
            )

    sketch.on_write = on_write
    sketch.run(symbols["clock_peripherals"])
    # 7 wait states at 216 MHz; 101 and 100 divide by 4 and 2 (RM0431, RCC_CFGR).
    assert switched == [{"wait states": 7, "over-drive": 1, "PLL locked": 1, "APB1, APB2": (5, 4)}]
    pll = {name: sketch.field("RCC_PLLCFGR", name) for name in ("PLLM", "PLLN", "PLLP", "PLLQ", "PLLSRC")}
    vco_hz = 8_000_000 * pll["PLLN"] / pll["PLLM"]
    assert pll["PLLSRC"] == 1
    assert 1e6 <= 8_000_000 / pll["PLLM"] <= 2e6 and 100e6 <= vco_hz <= 432e6
    assert vco_hz / (2 * pll["PLLP"] + 2) == 216e6
    assert vco_hz / pll["PLLQ"] == 48e6
    assert sketch.field("SCB_CCR", "IC") == sketch.field("SCB_CCR", "DC") == 1
    assert sketch.field("MPU_CTRL", "ENABLE") == 1
    assert sketch.sins == []


def test_the_board_serves_without_a_gyro_when_nothing_answers(
    sketch: Sketch, symbols: dict[str, int]
) -> None:
    sketch.run(symbols["msp_uart_serve"])
    assert sketch.sins == []
    assert symbols["gyro_run"] & ~1 not in sketch.seen
    # Motors: PC6..PC9 on AF3, the timer's outputs on, all compare values 0, no frame.
    assert sketch.peek(0x40020800) >> 12 & 0xFF == 0b10101010
    assert sketch.peek(0x40020820) >> 24 == 0x33 and sketch.peek(0x40020824) & 0xFF == 0x33
    assert sketch.field("TIM_BDTR", "MOE", "TIM8") == 1
    assert sketch.field("TIM_CR1", "CEN", "TIM8") == 1
    assert [sketch.peek(0x40010434 + 4 * i) for i in range(4)] == [0, 0, 0, 0]
    assert sketch.peek(0x40026428) & 1 == 0
    # Baud rates: APB2 / 938 = 115139, APB1 / 540 = 100000.
    assert (sketch.peek(0x4001100C), sketch.peek(0x4000440C)) == (938, 540)


@pytest.mark.parametrize("dead", ["HSERDY", "PLLRDY", "ODRDY", "ODSWRDY", "SWS"])
def test_the_motors_are_held_low_when_the_clock_does_not_come_up(
    dead: str, elf: ELFFile, registers: RegisterTable, symbols: dict[str, int]
) -> None:
    sketch = Sketch(elf, registers, dead=frozenset({dead}))
    sketch.run_for(STEPS_TO_STOP)
    assert symbols["stop"] & ~1 in sketch.seen
    assert symbols["clock_peripherals"] & ~1 not in sketch.seen
    assert symbols["motors_start"] & ~1 not in sketch.seen
    assert sketch.peek(0x40020800) >> 12 & 0xFF == 0b01010101  # PC6..PC9 outputs
    assert sketch.sins == []


def test_the_boot_part_stays_put_when_the_bank_is_erased(sketch: Sketch, symbols: dict[str, int]) -> None:
    sketch.uc.mem_write(FLASH_BANK_A.address, b"\xff" * FLASH_BANK_A.size)
    sketch.run(symbols["boot_fault"])
    assert symbols["reset_handler"] & ~1 not in sketch.seen
