"""The firmware's hand-written registers.h against the table that came from the vendor's description.

The header is read by the compiler: its preprocessor lists the macros, a small program prints their values.
"""

from __future__ import annotations

import os
import re
import subprocess
from collections.abc import Callable, Iterable
from pathlib import Path

import pytest

from toolchain.errors import BuildError
from toolchain.rendering.register_table import (
    INTERRUPTS_FILE,
    REGISTERS_FILE,
    Register,
    RegisterTable,
    extract,
    load,
    main,
    render,
)

ROOT = Path(__file__).resolve().parents[3]
HEADER = ROOT / "firmware" / "hal" / "stm32f7" / "core" / "registers.h"
TARGET = ROOT / "firmware" / "targets" / "MATEKF722"
# The vendor's description of the STM32F7x2, version 1.3, from which the committed table comes.
SVD_SHA256 = "8d411b234d33dad0d4daa56acdc03991d45feb91ab6ffecf49b2cfca83c119d9"
HELPERS = {"STM32F7_REGISTERS_H", "REGISTER", "BIT", "BITS", "FIELD", "VALUE"}
INSTANCE = re.compile(r"(GPIO[A-Z]|DMA\d|TIM\d|SPI\d|USART\d)")

Evaluate = Callable[[Iterable[str]], dict[str, int]]


@pytest.fixture(scope="module")
def table() -> RegisterTable:
    return load(TARGET)


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
    table: RegisterTable, macros: set[str], evaluate: Evaluate
) -> None:
    expressions = {f"(uintptr_t)&{expression(r)}": r.address for r in table.registers if r.name in macros}
    assert len(expressions) > 100
    assert evaluate(expressions) == expressions


def test_header_and_table_hold_the_same_registers_when_listed(table: RegisterTable, macros: set[str]) -> None:
    names = {register.name for register in table.registers}
    stated = {name for name in macros if not INSTANCE.fullmatch(name) and name.count("_") == 1}
    stated -= {name for name in stated if name.startswith("IRQ_")}
    assert stated == names


def test_every_field_has_the_tables_bits_when_compiled(
    table: RegisterTable, macros: set[str], evaluate: Evaluate
) -> None:
    fields = {name for name in macros if name.count("_") >= 2 and not name.startswith("IRQ_")}
    masks = evaluate(fields)
    assert len(fields) > 100
    for name in fields:
        family, short, field = name.split("_", 2)
        registers = [r for r in table.registers if r.name == f"{family}_{short}"]
        assert registers, f"{name} belongs to no register"
        for register in registers:
            known = {f.name: f.mask for f in register.fields}
            assert known.get(field) == masks[name], f"{name} of {register.instance}"


def test_interrupt_numbers_are_the_tables_when_compiled(
    table: RegisterTable, macros: set[str], evaluate: Evaluate
) -> None:
    stated = {name for name in macros if name.startswith("IRQ_")}
    numbers = evaluate(stated)
    assert numbers.pop("IRQ_COUNT") == max(table.interrupts.values()) + 1
    assert len(numbers) >= 2
    for name, number in numbers.items():
        assert table.interrupts[name.removeprefix("IRQ_")] == number


def test_field_macros_place_and_read_values_when_used(evaluate: Evaluate) -> None:
    expected = {
        "FIELD(RCC_PLLCFGR_PLLN, 216)": 216 << 6,
        "VALUE(RCC_PLLCFGR_PLLN, 0xFFFFFFFFu)": 511,
        "FIELD(RCC_PLLCFGR_PLLP, 7)": 3 << 16,
        "VALUE(DMA_SCR_CHSEL, 7u << 25 | 1u)": 7,
    }
    assert evaluate(expected) == expected


def test_the_committed_table_is_sound_when_read(table: RegisterTable) -> None:
    assert table.svd_sha256 == SVD_SHA256
    places = [register.address for register in table.registers]
    assert len(places) == len(set(places))
    for register in table.registers:
        assert register.address % 4 == 0
        assert register.access in {"r", "w", "rw"}
        assert register.reset is None or 0 <= register.reset < 1 << 32
        taken = 0
        for field in register.fields:
            assert field.mask < 1 << 32 and not taken & field.mask, (register.name, field.name)
            assert field.access in {"r", "w", "rw"}
            taken |= field.mask


def test_the_committed_table_is_the_scripts_when_the_description_is_at_hand(table: RegisterTable) -> None:
    """Where it is not, the digests inside the files stand for it: `load` has compared the rows'."""
    beside = ROOT.parent / "shared" / "svd" / "stm32f7x2.svd"
    svd = Path(os.environ.get("NEUROFLIGHT_SVD", beside))
    committed = {name: (TARGET / name).read_text() for name in (REGISTERS_FILE, INTERRUPTS_FILE)}
    assert render(table) == committed
    if svd.is_file():
        assert render(extract(svd)) == committed


def test_a_row_edited_by_hand_is_refused_when_read(tmp_path: Path) -> None:
    for name in (REGISTERS_FILE, INTERRUPTS_FILE):
        (tmp_path / name).write_text((TARGET / name).read_text())
    (tmp_path / REGISTERS_FILE).write_text(
        (TARGET / REGISTERS_FILE).read_text().replace("0x40023800", "0x40023804", 1)
    )
    with pytest.raises(BuildError, match=r"registers\.csv: its rows are not those that were extracted"):
        load(tmp_path)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("no xml", "syntax error"),
        ("<device/>", "has no <peripherals>"),
        ("<device><peripherals/></device>", "no peripheral FLASH"),
    ],
)
def test_another_file_is_refused_and_nothing_written_when_extracting(
    text: str, says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    svd = tmp_path / "some.svd"
    svd.write_text(text)
    assert main([str(svd), "--out", str(tmp_path / "out")]) == 1
    error = capsys.readouterr().err
    assert says in error and error.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_a_missing_register_is_named_when_extracting(tmp_path: Path) -> None:
    register = "<register><name>OPTKEYR</name><addressOffset>0x8</addressOffset></register>"
    flash = f"<name>FLASH</name><baseAddress>0x1000</baseAddress><registers>{register}</registers>"
    svd = tmp_path / "some.svd"
    svd.write_text(f"<device><peripherals><peripheral>{flash}</peripheral></peripherals></device>")
    with pytest.raises(BuildError, match="FLASH lacks ACR"):
        extract(svd)
