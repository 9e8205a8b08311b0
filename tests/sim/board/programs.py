"""Small programs for the emulated core, compiled as the firmware is."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from neuroflight.sim.board.core.engine import Engine

FLAGS = (
    *("-mcpu=cortex-m7", "-mthumb", "-mfpu=fpv5-sp-d16", "-mfloat-abi=hard", "-std=gnu11", "-O1", "-g"),
    *("-ffreestanding", "-fno-common", "-nostdlib", "-Wall", "-Werror", "-Wno-array-bounds"),
)
SCRIPT = """
SECTIONS {
    .vectors 0x08000000 : { KEEP(*(.vectors)) }
    .text 0x08000400 : { *(.text*) *(.rodata*) itcm_load = .; }
    .itcm 0x00000100 : AT(itcm_load) { itcm_start = .; *(.itcm*) . = ALIGN(4); itcm_end = .; }
    .bss 0x20003000 (NOLOAD) : { *(.bss*) }
    .data : { *(.data*) }
    ASSERT(SIZEOF(.data) == 0, "no data: nothing copies it")
}
"""
PRELUDE = """
#include <stdint.h>
#define REG(address) (*(volatile uint32_t *)(address))
#define RESULT ((volatile uint32_t *)0x20002000)
#define DEVICE 0x40000000u
#define HANDLER __attribute__((used)) void
#define NAKED __attribute__((naked, used)) void
#define FPU_ON() do { REG(0xE000ED88) = 0x00F00000; __asm volatile("dsb\\n\\tisb"); } while (0)
#define ENABLE(irq) (REG(0xE000E100 + 4 * ((irq) / 32)) = 1u << ((irq) % 32))
#define PRIORITY(irq, value) (*(volatile uint8_t *)(0xE000E400 + (irq)) = (value))
#define PEND(irq) (REG(0xE000E200 + 4 * ((irq) / 32)) = 1u << ((irq) % 32))
#define REST() do { for (;;) __asm volatile("wfi"); } while (0)
#define STACK ((void *)0x20001000)
#define VECTORS(...) __attribute__((section(".vectors"), used)) \
    void *const vectors[120] = { STACK, reset, __VA_ARGS__ }
"""
Boot = Callable[..., Engine]  # of fixture `boot`

RESULTS = 0x20002000
DEVICE = 0x40000000


@dataclass(frozen=True)
class Program:
    """What a compiler made."""

    flash: bytes
    elf: Path


class Device:
    """Registers that remember every access; `irq` follows what is written at offset 0."""

    def __init__(self, engine: Engine, irq: int = 0) -> None:
        self.engine, self.irq = engine, irq
        self.log: list[tuple[str, int, int, int]] = []
        self.times: list[int] = []
        self.value = 0

    def read(self, offset: int, size: int) -> int:
        self.log.append(("r", offset, size, self.value))
        self.times.append(self.engine.cycle)
        return self.value

    def write(self, offset: int, size: int, value: int) -> None:
        self.log.append(("w", offset, size, value))
        self.times.append(self.engine.cycle)
        if offset == 0:
            self.engine.irq(self.irq, bool(value))

    def reset(self) -> None:
        self.value = 0

    def state(self) -> Any:
        return (list(self.log), list(self.times), self.value)

    def restore(self, state: Any) -> None:
        self.log, self.times, self.value = list(state[0]), list(state[1]), state[2]


def attach(engine: Engine, irq: int = 0) -> Device:
    """Put a Device at DEVICE."""
    device = Device(engine, irq)
    engine.attach(DEVICE, 0x400, device, "DEVICE")
    return device


def results(engine: Engine, count: int) -> list[int]:
    """The first words that a program left at RESULT."""
    return [engine.load(RESULTS + 4 * i, 4) for i in range(count)]


def ran(engine: Engine, count: int) -> list[int]:
    """The same of a program that runs until it rests."""
    engine.run()
    return results(engine, count)


@pytest.fixture(scope="session")
def compile_program(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Program]:
    """Compiles C (with assembly inside) that defines `vectors`; equal sources once."""
    made: dict[str, Program] = {}

    def compile_one(source: str) -> Program:
        if source not in made:
            folder = tmp_path_factory.mktemp("program")
            (folder / "link.ld").write_text(SCRIPT)
            (folder / "program.c").write_text(f'{PRELUDE}#line 1 "program.c"\n{source}')
            command = ["arm-none-eabi-gcc", *FLAGS, "-T", "link.ld", "program.c", "-o", "program.elf"]
            subprocess.run(command, cwd=folder, check=True)
            copy = ["arm-none-eabi-objcopy", "-O", "binary", "program.elf", "program.bin"]
            subprocess.run(copy, cwd=folder, check=True)
            made[source] = Program((folder / "program.bin").read_bytes(), folder / "program.elf")
        return made[source]

    return compile_one


@pytest.fixture
def boot(compile_program: Callable[[str], Program]) -> Boot:
    """An engine before the first instruction of a program; options are the engine's."""

    def make(source: str, **options: Any) -> Engine:
        program = compile_program(source)
        return Engine(program.flash, elf=program.elf, **options)

    return make
