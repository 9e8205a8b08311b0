"""The register table of the MATEKF722's chip: extracted from the vendor's description, committed as CSV.

    python -m toolchain.rendering.register_table STM32F7x2.svd --out firmware/targets/MATEKF722

Only what the firmware touches is in it. The firmware's header is written by hand from the manuals and
held against this table, so that an error in one shows against the other. The core's own registers are
stated in `toolchain.rendering.core_registers`: the vendor's file leaves some out and copies the rest from
another core. Where it has them, their addresses and fields must agree.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import io
import re
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from toolchain.errors import BuildError, NeuroflightError
from toolchain.files import write_text_if_changed
from toolchain.rendering.core_registers import CORE_REGISTERS

REGISTERS_FILE, INTERRUPTS_FILE = "registers.csv", "interrupts.csv"

_GPIO = "MODER OTYPER OSPEEDR PUPDR BSRR AFRL AFRH"
_DMA = "LISR HISR LIFCR HIFCR SCR SNDTR SPAR SM0AR"
_USART = "CR1 CR2 CR3 BRR ISR ICR RDR TDR"
_IN_USE = {
    "FLASH": "ACR KEYR SR CR OPTCR",
    "PWR": "CR1 CSR1",
    "RCC": "CR PLLCFGR CFGR CIR AHB1ENR APB1ENR APB2ENR CSR",
    "GPIOA": _GPIO,
    "GPIOB": _GPIO,
    "GPIOC": _GPIO,
    "SYSCFG": "EXTICR1",
    "DMA1": _DMA,
    "DMA2": _DMA,
    "EXTI": "IMR RTSR PR",
    "TIM1": "CR1 CR2 DIER EGR CCMR1 CCER CNT PSC ARR CCR BDTR",
    "TIM3": "CR1 DIER EGR CCMR2 CCER CNT PSC ARR CCR",
    "TIM8": "CR1 DIER EGR CCMR1 CCMR2 CCER CNT PSC ARR CCR BDTR DCR DMAR",
    "ADC1": "SR CR1 CR2 SMPR1 SQR1 SQR3 DR",
    "ADC_Common": "CCR",
    "IWDG": "KR PR RLR SR",
    "DBGMCU": "APB1FZ",
    "SPI1": "CR1 CR2 SR DR",
    "USART1": _USART,
    "USART2": _USART,
}
_STREAMS = {"DMA1": ("2", "5"), "DMA2": ("0", "1", "2", "3", "5", "6", "7")}  # of the controllers' eight
_FAMILIES = re.compile(r"(GPIO|DMA|TIM|SPI|USART)[A-Z0-9]+")  # instances that share their registers' names
# The vendor's names where they are not the manual's.
_NAMES = {
    "CCMR1_Output": "CCMR1",
    "CCMR2_Output": "CCMR2",
    "APB1_FZ": "APB1FZ",
    "ADC_Common": "ADC",
}
_CORE_BASE = 0xE0000000  # private peripheral bus (ARMv7-M B3.1)
_ACCESS = {"read-write": "rw", "read-only": "r", "write-only": "w"}


@dataclass(frozen=True)
class Field:
    """Bits `lsb` to `lsb + width - 1` of a register; access is r, w or rw."""

    name: str
    lsb: int
    width: int
    access: str

    @property
    def mask(self) -> int:
        return ((1 << self.width) - 1) << self.lsb


@dataclass(frozen=True)
class Register:
    """One 32-bit register, e.g. DMA_SCR of instance DMA2, index 1."""

    name: str  # FAMILY_REGISTER, as in the firmware's header
    instance: str  # the peripheral, or the family itself where there is but one
    index: str  # stream, channel or word; empty where there is but one
    address: int
    access: str  # r, w or rw
    reset: int | None  # None: depends on the chip's state
    source: str  # "svd" or the manual's section
    fields: tuple[Field, ...]


@dataclass(frozen=True)
class RegisterTable:
    """What the firmware touches, in order of address; all interrupts of the chip by number."""

    svd_sha256: str
    registers: tuple[Register, ...]
    interrupts: dict[str, int]


def extract(svd: Path) -> RegisterTable:
    """The table of `svd`. Raises BuildError when it is no such file or lacks or contradicts a register."""
    try:
        data = svd.read_bytes()
        peripherals = ET.fromstring(data).find("peripherals")
    except (OSError, ET.ParseError) as error:
        raise BuildError(f"{svd}: {error}; give the vendor's STM32F7x2 register description (.svd)") from None
    if peripherals is None:
        raise BuildError(f"{svd}: has no <peripherals>; give the vendor's register description (.svd)")
    named = {_text(peripheral, "name"): peripheral for peripheral in peripherals}
    found = [register for name in _IN_USE for register in _peripheral(name, named)]
    core = [Register(*row[:-1], fields=_parse_fields(row[-1], row[4])) for row in CORE_REGISTERS]
    _check_core(core, named)
    interrupts = {
        _text(node, "name").upper(): int(_text(node, "value")) for node in peripherals.iter("interrupt")
    }
    return RegisterTable(
        svd_sha256=hashlib.sha256(data).hexdigest(),
        registers=tuple(sorted(found + core, key=lambda register: register.address)),
        interrupts=dict(sorted(interrupts.items(), key=lambda item: item[1])),
    )


def render(table: RegisterTable) -> dict[str, str]:
    """File name -> CSV text of the table. Each names the description it comes from and its rows' digest."""
    registers = [
        (
            r.name,
            r.instance,
            r.index,
            f"0x{r.address:08X}",
            r.access,
            "" if r.reset is None else f"0x{r.reset:08X}",
            r.source,
            " ".join(_render_field(field, r.access) for field in r.fields),
        )
        for r in table.registers
    ]
    header = ("register", "instance", "index", "address", "access", "reset", "source", "fields")
    interrupts = [(name, str(number)) for name, number in table.interrupts.items()]
    return {
        REGISTERS_FILE: _csv(table.svd_sha256, header, registers),
        INTERRUPTS_FILE: _csv(table.svd_sha256, ("interrupt", "number"), interrupts),
    }


def load(folder: Path) -> RegisterTable:
    """The committed table. Raises BuildError when a file is missing or was edited by hand."""
    svd_sha256, rows = _read(folder / REGISTERS_FILE)
    interrupts_sha256, numbers = _read(folder / INTERRUPTS_FILE)
    if svd_sha256 != interrupts_sha256:
        raise BuildError(f"{folder}: its two tables come from different descriptions; extract both again")
    registers = tuple(
        Register(
            name=row["register"],
            instance=row["instance"],
            index=row["index"],
            address=int(row["address"], 16),
            access=row["access"],
            reset=int(row["reset"], 16) if row["reset"] else None,
            source=row["source"],
            fields=_parse_fields(row["fields"], row["access"]),
        )
        for row in rows
    )
    return RegisterTable(svd_sha256, registers, {row["interrupt"]: int(row["number"]) for row in numbers})


def _peripheral(name: str, named: dict[str, ET.Element]) -> Iterator[Register]:
    """The registers in use of one peripheral, its description maybe derived from a like one."""
    if name not in named:
        raise BuildError(f"register description: no peripheral {name}; is it the STM32F7x2's?")
    own = named[name]
    described = named[own.attrib["derivedFrom"]] if "derivedFrom" in own.attrib else own
    family = match.group(1) if (match := _FAMILIES.fullmatch(name)) else _NAMES.get(name, name)
    wanted = _IN_USE[name].split()
    missing = set(wanted)
    base = _number(own, "baseAddress")
    for register, index, offset, node in _expanded(described):
        in_use = register in wanted and (not index or family != "DMA" or index in _STREAMS[name])
        if not in_use:
            continue
        missing.discard(register)
        yield Register(
            name=f"{family}_{register}",
            instance=_NAMES.get(name, name),
            index=index,
            address=base + offset,
            access=_ACCESS.get(node.findtext("access", ""), "rw"),
            reset=_number(node, "resetValue"),
            source="svd",
            fields=_fields(node),
        )
    if missing:
        raise BuildError(f"register description: {name} lacks {', '.join(sorted(missing))}")


def _expanded(peripheral: ET.Element) -> Iterator[tuple[str, str, int, ET.Element]]:
    """Name, index, offset and node of each register, arrays and clusters unrolled."""
    for node in peripheral.findall("registers/*"):
        inner = node.findall("register") if node.tag == "cluster" else [node]
        for at, index in _repeats(node):
            for register in inner:
                offset = at + (_number(register, "addressOffset") if node.tag == "cluster" else 0)
                name = _text(register, "name").replace("%s", "")
                # A cluster's registers bear the manual's S for stream: S1CR is SCR, index 1.
                name = f"S{name}" if node.tag == "cluster" else _NAMES.get(name, name)
                yield name, index, offset, register


def _repeats(node: ET.Element) -> list[tuple[int, str]]:
    """Offset and index of each repetition of an array; the one offset, without index, of anything else."""
    offset = _number(node, "addressOffset")
    if node.find("dim") is None:
        return [(offset, "")]
    step, first = _number(node, "dimIncrement"), _first_index(node)
    return [(offset + i * step, str(first + i)) for i in range(_number(node, "dim"))]


def _first_index(node: ET.Element) -> int:
    return int(node.findtext("dimIndex", "0").split("-")[0].split(",")[0])


def _fields(node: ET.Element) -> tuple[Field, ...]:
    whole = _ACCESS.get(node.findtext("access", ""), "rw")
    found = (
        Field(
            name=_text(field, "name"),
            lsb=_number(field, "bitOffset"),
            width=_number(field, "bitWidth"),
            access=_ACCESS.get(field.findtext("access", ""), whole),
        )
        for field in node.iter("field")
    )
    return tuple(sorted(found, key=lambda field: field.lsb))


def _check_core(core: Sequence[Register], named: dict[str, ET.Element]) -> None:
    """Where the description has a core register too, fields of the same name must be the same bits."""
    described = {
        _number(peripheral, "baseAddress") + offset: node
        for peripheral in named.values()
        if _number(peripheral, "baseAddress") >= _CORE_BASE
        for _, _, offset, node in _expanded(peripheral)
    }
    for register in core:
        if register.address not in described:
            continue
        theirs = {field.name: field for field in _fields(described[register.address])}
        for field in register.fields:
            if field.name in theirs and theirs[field.name].mask != field.mask:
                raise BuildError(
                    f"register description: {register.name} {field.name} is elsewhere than stated"
                )


def _render_field(field: Field, access: str) -> str:
    """NAME@lsb, +width beyond one bit, :access where it is not the register's."""
    width = f"+{field.width}" if field.width > 1 else ""
    return f"{field.name}@{field.lsb}{width}" + (f":{field.access}" if field.access != access else "")


def _parse_fields(text: str, access: str) -> tuple[Field, ...]:
    pattern = re.compile(r"(\w+)@(\d+)(?:\+(\d+))?(?::(\w+))?")
    found = [pattern.fullmatch(word) for word in text.split()]
    return tuple(Field(m[1], int(m[2]), int(m[3] or 1), m[4] or access) for m in found if m)


def _csv(svd_sha256: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows([header, *rows])
    digest = hashlib.sha256(out.getvalue().encode()).hexdigest()
    return (
        f"# by toolchain/rendering/register_table.py from the description with SHA-256 {svd_sha256}\n"
        f"# rows {digest}\n{out.getvalue()}"
    )


def _read(path: Path) -> tuple[str, list[dict[str, str]]]:
    """The description's digest and the rows of one file."""
    try:
        origin, digest, body = path.read_text().split("\n", 2)
    except (OSError, ValueError):
        raise BuildError(
            f"{path}: no register table; extract it with toolchain/rendering/register_table.py"
        ) from None
    if digest != f"# rows {hashlib.sha256(body.encode()).hexdigest()}":
        raise BuildError(f"{path}: its rows are not those that were extracted; extract it again")
    return origin.rsplit(" ", 1)[1], list(csv.DictReader(io.StringIO(body)))


def _text(node: ET.Element, tag: str) -> str:
    text = node.findtext(tag)
    if text is None:
        raise BuildError(f"register description: <{node.tag}> without <{tag}>")
    return text.strip()


def _number(node: ET.Element, tag: str) -> int:
    text = _text(node, tag)
    return int(text, 16) if text.lower().startswith("0x") else int(text)


def main(argv: Sequence[str] | None = None) -> int:
    """Extract the table of a description into a folder. Returns 0, or 1 after one line on stderr."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("svd", type=Path, help="the vendor's register description")
    parser.add_argument("--out", type=Path, required=True, help="folder of the two CSV files")
    args = parser.parse_args(argv)
    try:
        for name, text in render(extract(args.svd)).items():
            write_text_if_changed(args.out / name, text)
    except NeuroflightError as error:
        print(f"registers: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
