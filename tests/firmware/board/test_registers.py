"""The firmware's hand-written registers.h against the table that came from the vendor's description.

The header is read by the compiler: its preprocessor lists the macros, a small program prints their values.
"""

from __future__ import annotations

import re
import subprocess
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import pytest

from neuroflight.sim.board.registers.bus import load_table
from neuroflight.sim.board.registers.core_registers import Register
from tests.firmware.board.registers import registers_in_use

ROOT = Path(__file__).resolve().parents[3]
HEADER = ROOT / "firmware" / "hal" / "stm32f7" / "core" / "registers.h"
HELPERS = {"STM32F7_REGISTERS_H", "REGISTER", "BIT", "BITS", "FIELD", "VALUE"}
INSTANCE = re.compile(r"(GPIO[A-Z]|DMA\d|TIM\d|SPI\d|USART\d|UART\d)")

Evaluate = Callable[[Iterable[str]], dict[str, int]]


@pytest.fixture(scope="module")
def registers() -> tuple[Register, ...]:
    return registers_in_use()


@pytest.fixture(scope="module")
def macros() -> set[str]:
    """Names that the header defines."""
    command = ["gcc", "-E", "-dM", "-imacros", "stdint.h", "-x", "c"]
    before = _defined([*command, "/dev/null"])
    return _defined([*command, "-include", str(HEADER), "/dev/null"]) - before - HELPERS


def _defined(command: list[str]) -> set[str]:
    text = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    return {match[1] for match in re.finditer(r"#define (\w+)", text)}


@pytest.fixture(scope="module")
def evaluate(tmp_path_factory: pytest.TempPathFactory) -> Evaluate:
    """Values of C expressions after `#include "registers.h"`."""

    def values(expressions: Iterable[str]) -> dict[str, int]:
        asked = list(expressions)
        folder = tmp_path_factory.mktemp("registers")
        lines = "".join(f'\tprintf("%llu\\n", (unsigned long long)({e}));\n' for e in asked)
        source = folder / "print.c"
        source.write_text(
            f'#include <stdio.h>\n#include "{HEADER}"\nint main(void)\n{{\n{lines}\treturn 0;\n}}\n'
        )
        compiler = ["gcc", "-std=c11", "-Wno-int-to-pointer-cast", str(source), "-o", str(folder / "print")]
        subprocess.run(compiler, check=True)
        done = subprocess.run([folder / "print"], capture_output=True, text=True, check=True)
        return dict(zip(asked, map(int, done.stdout.split()), strict=True))

    return values


def expression(register: Register) -> str:
    """How the header says this register: RCC_CR, TIM_CR1(TIM8), DMA_SCR(DMA2, 1), NVIC_ISER(0)."""
    family = register.name.split("_")[0]
    arguments = [part for part in (register.instance, register.index) if part and part != family]
    return register.name + (f"({', '.join(arguments)})" if arguments else "")


def test_every_register_is_where_the_table_says_when_compiled(
    registers: Sequence[Register], macros: set[str], evaluate: Evaluate
) -> None:
    expressions = {f"(uintptr_t)&{expression(r)}": r.address for r in registers if r.name in macros}
    assert len(expressions) > 100
    assert evaluate(expressions) == expressions


def test_header_and_table_hold_the_same_registers_when_listed(
    registers: Sequence[Register], macros: set[str]
) -> None:
    names = {register.name for register in registers}
    stated = {name for name in macros if not INSTANCE.fullmatch(name) and name.count("_") == 1}
    stated -= {name for name in stated if name.startswith("IRQ_")}
    assert stated == names


def test_every_field_has_the_tables_bits_when_compiled(
    registers: Sequence[Register], macros: set[str], evaluate: Evaluate
) -> None:
    fields = {name for name in macros if name.count("_") >= 2 and not name.startswith("IRQ_")}
    masks = evaluate(fields)
    assert len(fields) > 100
    for name in fields:
        family, short, field = name.split("_", 2)
        alike = [r for r in registers if r.name == f"{family}_{short}"]
        assert alike, f"{name} belongs to no register"
        for register in alike:
            known = {f.name: f.mask for f in register.fields}
            assert known.get(field) == masks[name], f"{name} of {register.instance}"


def test_interrupt_numbers_are_the_tables_when_compiled(macros: set[str], evaluate: Evaluate) -> None:
    interrupts = load_table().interrupts
    stated = {name for name in macros if name.startswith("IRQ_")}
    numbers = evaluate(stated)
    assert numbers.pop("IRQ_COUNT") == max(interrupts.values()) + 1
    assert len(numbers) >= 2
    for name, number in numbers.items():
        assert interrupts[name.removeprefix("IRQ_")] == number


def test_field_macros_place_and_read_values_when_used(evaluate: Evaluate) -> None:
    expected = {
        "FIELD(RCC_PLLCFGR_PLLN, 216)": 216 << 6,
        "VALUE(RCC_PLLCFGR_PLLN, 0xFFFFFFFFu)": 511,
        "FIELD(RCC_PLLCFGR_PLLP, 7)": 3 << 16,
        "VALUE(DMA_SCR_CHSEL, 7u << 25 | 1u)": 7,
    }
    assert evaluate(expected) == expected


def test_the_registers_in_use_are_sound_when_read(registers: Sequence[Register]) -> None:
    places = [register.address for register in registers]
    assert len(places) == len(set(places))
    for register in registers:
        assert register.address % 4 == 0
        assert register.access in {"r", "w", "rw"}
        assert register.reset is None or 0 <= register.reset < 1 << 32
        taken = 0
        for field in register.fields:
            assert field.mask < 1 << 32 and not taken & field.mask, (register.name, field.name)
            assert field.access in {"r", "w", "rw"}
            taken |= field.mask
