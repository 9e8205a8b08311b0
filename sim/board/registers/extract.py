"""The register table of the chip: taken from the vendor's description, committed as registers.json.

    python -m neuroflight.sim.board.registers.extract STM32F7x2.svd

The emulator checks every access against it, and the firmware's tests the firmware's header: addresses, reset
values, access rights, fields and interrupt numbers are the vendor's, but where usb_registers.py corrects them
and says why. What the emulator adds stands below: the registers that it models and, of each, the fields. The
header is written by hand from the manuals and is no source of this table, so that an error in one shows
against the other.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from pathlib import Path

from neuroflight.sim.board.registers.bus import TABLE, digest
from neuroflight.sim.board.registers.core_registers import CORE_REGISTERS
from neuroflight.sim.board.registers.usb_registers import (
    USB_CORRECTIONS,
    USB_MODELLED,
    USB_SIZES,
    USB_STATED,
    Correction,
    usb_field,
    usb_fifos,
    usb_title,
)
from neuroflight.toolchain.errors import BuildError, NeuroflightError
from neuroflight.toolchain.files import write_text_if_changed

_ALL = "*"  # every field that the description has
_TIMER = {
    "CR1": "CEN UDIS URS OPM ARPE",
    "CR2": "CCDS",
    "DIER": "UIE UDE CC1DE CC2DE CC3DE CC4DE",
    "SR": "UIF CC1IF CC2IF CC3IF CC4IF",
    "EGR": "UG CC1G CC2G CC3G CC4G",
    "CCMR1": "OC1PE OC1M OC2PE OC2M",
    "CCMR2": "OC3PE OC3M OC4PE OC4M",
    "CCER": "CC1E CC2E CC3E CC4E",
    "CNT": "CNT",
    **dict.fromkeys(["PSC", "ARR", "CCR1", "CCR2", "CCR3", "CCR4", "DCR", "DMAR"], _ALL),
}
_ADVANCED_TIMER = {**_TIMER, "RCR": _ALL, "BDTR": "MOE AOE OSSI OSSR"}
_GPIO = dict.fromkeys(["MODER", "OTYPER", "OSPEEDR", "PUPDR", "IDR", "ODR", "BSRR", "AFRL", "AFRH"], _ALL)
_USART = {
    "CR1": "UE RE TE IDLEIE RXNEIE TCIE TXEIE PEIE PS PCE M0 OVER8 M1",
    "CR2": "STOP RXINV TXINV SWAP",
    "CR3": "EIE HDSEL DMAR DMAT ONEBIT OVRDIS DDRE",
    "BRR": _ALL,
    "RQR": "RXFRQ TXFRQ",
    "ISR": _ALL,
    "ICR": "PECF FECF NCF ORECF IDLECF TCCF",
    "RDR": _ALL,
    "TDR": _ALL,
}
_SPI = {
    "CR1": "CPHA CPOL MSTR BR SPE LSBFIRST SSI SSM",
    "CR2": "RXDMAEN TXDMAEN ERRIE RXNEIE TXEIE DS FRXTH",
    **dict.fromkeys(["SR", "DR"], _ALL),
}
_DMA = {
    **dict.fromkeys(["LISR", "HISR", "LIFCR", "HIFCR"], _ALL),
    **{f"S{i}CR": "CHSEL PL MSIZE PSIZE MINC CIRC DIR TCIE HTIE TEIE DMEIE EN"
       for i in range(8)},
    **{f"S{i}{name}": _ALL for i in range(8) for name in ("NDTR", "PAR", "M0AR")},
    **{f"S{i}FCR": "FS DMDIS FTH" for i in range(8)},
}  # fmt: skip

# Registers that the emulator models, and of each the fields that may differ from their reset value.
MODELLED: dict[str, dict[str, str]] = {
    "RCC": {
        "CR": "HSION HSIRDY HSITRIM HSICAL HSEON HSERDY HSEBYP CSSON PLLON PLLRDY",
        "PLLCFGR": _ALL,
        "CFGR": "SW SWS HPRE PPRE1 PPRE2",
        "CIR": _ALL,
        "AHB1RSTR": "GPIOARST GPIOBRST GPIOCRST GPIODRST GPIOERST DMA1RST DMA2RST",
        "APB1RSTR": "TIM2RST TIM3RST TIM4RST TIM5RST SPI2RST SPI3RST USART2RST USART3RST UART4RST UART5RST "
        "PWRRST",
        "APB2RSTR": "TIM1RST TIM8RST USART1RST USART6RST ADCRST SPI1RST SYSCFGRST",
        "AHB2RSTR": "OTGFSRST",
        "AHB1ENR": "GPIOAEN GPIOBEN GPIOCEN GPIODEN GPIOEEN DMA1EN DMA2EN DTCMRAMEN",
        "AHB2ENR": "OTGFSEN",
        "APB1ENR": "TIM2EN TIM3EN TIM4EN TIM5EN SPI2EN SPI3EN USART2EN USART3EN UART4EN UART5EN PWREN",
        "APB2ENR": "TIM1EN TIM8EN USART1EN USART6EN ADC1EN SPI1EN SYSCFGEN",
        "CSR": _ALL,
        "DCKCFGR1": "TIMPRE",
        "DCKCFGR2": "USART1SEL USART2SEL USART3SEL UART4SEL UART5SEL USART6SEL",
    },
    "PWR": {"CR1": "VOS ODEN ODSWEN PVDE PLS DBP", "CSR1": "PVDO VOSRDY ODRDY ODSWRDY"},
    "FLASH": {
        **dict.fromkeys(["ACR", "KEYR", "OPTKEYR", "CR", "OPTCR", "OPTCR1", "OPTCR2"], _ALL),
        "SR": "EOP OPERR WRPERR PGAERR PGPERR ERSERR BSY",
    },
    **{f"GPIO{port}": _GPIO for port in "ABCDE"},
    "SYSCFG": dict.fromkeys(("EXTICR1", "EXTICR2", "EXTICR3", "EXTICR4"), _ALL),
    "EXTI": dict.fromkeys(["IMR", "RTSR", "FTSR", "SWIER", "PR"], _ALL),
    **dict.fromkeys(["DMA1", "DMA2"], _DMA),
    **dict.fromkeys(["TIM1", "TIM8"], _ADVANCED_TIMER),
    **{f"TIM{n}": _TIMER for n in (2, 3, 4, 5)},
    **dict.fromkeys(["SPI1", "SPI2", "SPI3"], _SPI),
    **dict.fromkeys(["USART1", "USART2", "USART3", "UART4", "UART5", "USART6"], _USART),
    "ADC1": {
        "SR": "EOC STRT OVR",
        "CR1": "EOCIE SCAN RES OVRIE",
        "CR2": "ADON CONT DMA DDS EOCS SWSTART",
        **dict.fromkeys(["SMPR1", "SMPR2", "SQR1", "SQR2", "SQR3", "DR"], _ALL),
    },
    "ADC_Common": {"CCR": "ADCPRE"},
    "IWDG": dict.fromkeys(["KR", "PR", "RLR", "SR"], _ALL),
    "DBGMCU": {"IDCODE": _ALL, "APB1_FZ": "DBG_IWDG_STOP"},
    **USB_MODELLED,
}

# Accesses narrower than a word (RM0431: GPIO by byte, half-word and word; SPI_DR packs data by width).
_NARROW = {"GPIO": (1, 2, 4), **{f"SPI{i}.DR": (1, 2, 4) for i in (1, 2, 3)}, "TIM": (2, 4)}
_ACCESS = {"read-write": "rw", "read-only": "r", "write-only": "w", None: "rw"}
_CORE = 0xE0000000  # from here on it is the core's, which the engine knows (ARMv7-M B3.1)


def extract(svd: Path) -> dict[str, object]:
    """Return the table of `svd`, for JSON. Raises BuildError if it lacks what is modelled."""
    try:
        data = svd.read_bytes()
        root = ET.fromstring(data)
    except (OSError, ET.ParseError) as error:
        raise BuildError(f"{svd}: {error}; give the vendor's STM32F7x2 register description (.svd)") from None
    named = {_text(node, "name"): node for node in root.iter("peripheral")}
    missing = sorted(set(MODELLED) - set(named))
    if missing:
        raise BuildError(f"{svd}: has no {', '.join(missing)}; give the description of the STM32F7x2")
    _check_core(named)
    peripherals = {
        name: _peripheral(name, named)
        for name in sorted(named, key=lambda n: _number(named[n], "baseAddress"))
        if _number(named[name], "baseAddress") < _CORE or name in MODELLED
    }
    peripherals = dict(sorted((peripherals | usb_fifos()).items(), key=lambda p: int(str(p[1]["base"]), 16)))
    interrupts = sorted(
        {(_number(node, "value"), _text(node, "name").upper()) for node in root.iter("interrupt")}
    )
    rows = {"interrupts": {name: number for number, name in interrupts}, "peripherals": peripherals}
    return {
        "device": f"{_text(root, 'name')} {_text(root, 'version')}",
        "sha256": hashlib.sha256(data).hexdigest(),
        "rows_sha256": digest(rows),
        **rows,
    }


def _check_core(named: dict[str, ET.Element]) -> None:
    """Raise BuildError where the description puts a field of a register stated by hand onto other bits."""
    described = {
        _number(node, "baseAddress") + offset: register
        for node in named.values()
        for register, offset, _ in _registers(node)
    }
    for register in CORE_REGISTERS:
        node = described.get(register.address)
        theirs = {} if node is None else {_text(field, "name"): field for field in node.iter("field")}
        for field in register.fields:
            found = theirs.get(field.name)
            if found is not None and _bits(found) != (field.lsb, field.width):
                raise BuildError(
                    f"register description: {register.name} {field.name} is elsewhere than stated"
                )


def _bits(field: ET.Element) -> tuple[int, int]:
    return _number(field, "bitOffset"), _number(field, "bitWidth")


def _peripheral(name: str, named: dict[str, ET.Element]) -> dict[str, object]:
    node = named[name]
    source = named[node.get("derivedFrom") or name]
    block = source.find("addressBlock")
    modelled = MODELLED.get(name, {})
    described = [(n, offset, usb_title(name, title)) for n, offset, title in _registers(source)]
    registers = [
        _register(register, offset, f"{name}.{title}", modelled.get(title))
        for register, offset, title in sorted(described, key=lambda r: r[1])
    ]
    registers += USB_STATED.get(name, [])
    lacking = sorted(set(modelled) - {str(r["name"]) for r in registers})
    if lacking:
        raise BuildError(f"{name} of the description lacks {', '.join(lacking)}")
    return {
        "base": _hex(_number(node, "baseAddress")),
        "size": _hex(USB_SIZES.get(name, _number(block, "size") if block is not None else 0x400)),
        "registers": registers if modelled else [],
    }


def _registers(source: ET.Element) -> Iterator[tuple[ET.Element, int, str]]:
    """Register nodes with offset and the manual's name; arrays laid out, second views left out."""
    parent = source.find("registers")
    for node in parent if parent is not None else ():
        base, title = _number(node, "addressOffset"), _text(node, "name").removesuffix("_Output")
        count, step = int(node.findtext("dim") or 1), int(node.findtext("dimIncrement") or "0", 0)
        indices = (node.findtext("dimIndex") or "").split(",") if node.find("dim") is not None else [""]
        if node.findtext("alternateRegister"):
            continue
        for i in range(count):
            if node.tag == "cluster":  # the streams of a DMA controller: ST0.CR is the manual's S0CR
                for register in node.findall("register"):
                    offset = base + step * i + _number(register, "addressOffset")
                    yield register, offset, f"S{indices[i]}{_text(register, 'name')}"
            else:
                yield node, base + step * i, title.replace("%s", indices[i])


def _register(node: ET.Element, offset: int, full: str, modelled: str | None) -> dict[str, object]:
    peripheral, name = full.split(".")
    if modelled is None:
        return {"name": name, "offset": _hex(offset)}
    right = USB_CORRECTIONS.get(full, Correction())
    fields: dict[str, tuple[int, int, str]] = {
        usb_field(peripheral, _text(f, "name")): (
            *_bits(f),
            _ACCESS[f.findtext("access") or node.findtext("access")],
        )
        for f in node.iter("field")
    }
    fields |= right.fields
    fields |= {key: (*fields[key][:2], access) for key, access in right.rights.items()}
    wanted = set(fields) if modelled == _ALL else set(modelled.split())
    if wanted - set(fields):
        raise BuildError(f"{name} of the description has no field {', '.join(sorted(wanted - set(fields)))}")
    reset = int(node.findtext("resetValue") or "0", 0) if right.reset is None else right.reset
    return {
        "name": name,
        "offset": _hex(offset),
        "reset": _hex(reset),
        "access": right.access or _access(node, list(fields.values())),
        "sizes": list(_sizes(peripheral, name)),
        "fields": {
            key: [lsb, width, right.access or access, int(key in wanted)]
            for key, (lsb, width, access) in sorted(fields.items(), key=lambda f: f[1][0])
        },
    }


def _access(node: ET.Element, fields: list[tuple[int, int, str]]) -> str:
    if node.findtext("access"):
        return _ACCESS[node.findtext("access")]
    rights = {letter for _, _, access in fields for letter in access}
    return "".join(letter for letter in "rw" if letter in rights)


def _sizes(peripheral: str, register: str) -> tuple[int, ...]:
    for prefix, sizes in _NARROW.items():
        if f"{peripheral}.{register}".startswith(prefix):
            return sizes
    return (4,)


def _text(node: ET.Element, tag: str) -> str:
    return (node.findtext(tag) or "").strip()


def _number(node: ET.Element, tag: str) -> int:
    return int(_text(node, tag) or "0", 0)


def _hex(value: int) -> str:
    return f"0x{value:X}"


def render(table: dict[str, object]) -> str:
    """Format `table` as JSON text, one register a line."""
    head = {key: value for key, value in table.items() if key != "peripherals"}
    lines = json.dumps(head, indent=1)[:-2] + ',\n "peripherals": {\n'
    rows = []
    peripherals = table["peripherals"]
    assert isinstance(peripherals, dict)
    for name, peripheral in peripherals.items():
        registers = ",\n".join("   " + json.dumps(r) for r in peripheral["registers"])
        body = f"[\n{registers}]" if registers else "[]"
        place = json.dumps({key: peripheral[key] for key in ("base", "size")})[1:-1]
        rows.append(f'  "{name}": {{{place}, "registers": {body}}}')
    return lines + ",\n".join(rows) + "\n }\n}\n"


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the table. Returns 0, or 1 after a line with the reason."""
    parser = argparse.ArgumentParser(description="extract the emulated board's register table")
    parser.add_argument("svd", type=Path, help="the vendor's STM32F7x2 register description")
    parser.add_argument("--out", type=Path, default=TABLE, help="file to write (default: the committed one)")
    options = parser.parse_args(arguments)
    try:
        write_text_if_changed(options.out, render(extract(options.svd)))
    except NeuroflightError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
