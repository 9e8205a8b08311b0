"""What the firmware touches of the chip: the vendor's table under the names of the firmware's header.

The values are those of sim/board/registers; which registers are in use is stated here.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

from neuroflight.sim.board.registers.bus import Table, load_table
from neuroflight.sim.board.registers.core_registers import CORE_REGISTERS, Register

_GPIO = "MODER OTYPER OSPEEDR PUPDR IDR BSRR AFRL AFRH"
_DMA = "LISR HISR LIFCR HIFCR SCR SNDTR SPAR SM0AR"
_USART = "CR1 CR2 CR3 BRR ISR ICR RDR TDR"
_IN_USE = {
    "FLASH": "ACR KEYR SR CR OPTCR",
    "PWR": "CR1 CSR1",
    "RCC": "CR PLLCFGR CFGR CIR AHB1ENR AHB2ENR APB1ENR APB2ENR CSR",
    **{f"GPIO{port}": _GPIO for port in "ABCDE"},
    "SYSCFG": "EXTICR",
    "DMA1": _DMA,
    "DMA2": _DMA,
    "EXTI": "IMR RTSR PR",
    "TIM1": "CR1 CR2 DIER SR EGR CNT PSC ARR",
    "TIM5": "CR1 CR2 DIER SR EGR PSC ARR",
    "ADC1": "SR CR1 CR2 SMPR1 SMPR2 SQR1 SQR3 DR",
    "ADC_Common": "CCR",
    "IWDG": "KR PR RLR SR",
    "DBGMCU": "APB1FZ",
    **dict.fromkeys(("SPI1", "SPI2", "SPI3"), "CR1 CR2 SR DR"),
    **dict.fromkeys(("USART1", "USART2", "USART3", "UART4", "UART5", "USART6"), _USART),
    "OTG_FS_GLOBAL": "GOTGCTL GUSBCFG GRSTCTL GINTSTS GRXSTSP GRXFSIZ DIEPTXF0 DIEPTXF GCCFG",
    "OTG_FS_DEVICE": "DCFG DCTL DSTS DIEPMSK DAINTMSK DIEPCTL DIEPINT DIEPTSIZ DOEPCTL DOEPTSIZ",
    "OTG_FS_PWRCLK": "PCGCCTL",
    **{f"OTG_FS_FIFO{n}": "FIFO" for n in range(3)},
}
_STREAMS = {"DMA1": "01234567", "DMA2": "01234567"}
_ENDPOINTS = "012"  # of USB's six
_MANUALS = {"ADC_Common": "ADC", "APB1_FZ": "APB1FZ"}  # the manual's names where the vendor's differ
_FAMILIES = re.compile(
    r"(GPIO|DMA|TIM|SPI|USART|UART)[A-Z0-9]+"
)  # instances that share their registers' names


def registers_in_use(table: Table | None = None) -> tuple[Register, ...]:
    """Every register that the firmware touches, in order of address, the core's included."""
    found = [r for name in _IN_USE for r in _peripheral(table or load_table(), name)]
    return tuple(sorted([*found, *CORE_REGISTERS], key=lambda register: register.address))


def _peripheral(table: Table, name: str) -> Iterator[Register]:
    block, wanted = table.blocks[name], set(_IN_USE[name].split())
    family = match[1] if (match := _FAMILIES.fullmatch(name)) else _MANUALS.get(name, name)
    family = {"UART": "USART"}.get(family, "OTG" if name.startswith("OTG_FS_") else family)
    missing = set(wanted)
    for vendors in block.registers.values():
        title, index = _MANUALS.get(vendors.name, vendors.name), ""
        # In the header the number is an argument: S1CR is SCR, index 1.
        if family == "DMA" and (one := re.fullmatch(r"S(\d)(\w+)", title)):
            title, index = f"S{one[2]}", one[1]
        elif family == "SYSCFG" and (one := re.fullmatch(r"EXTICR([1-4])", title)):
            title, index = "EXTICR", one[1]
        elif family == "OTG" and title == "DFIFO":
            title, index = "FIFO", name[-1]
        elif family == "OTG" and (one := re.fullmatch(r"(D[IO]EP\w+?)(\d)", title)) and title != "DIEPTXF0":
            title, index = one[1], one[2]
        numbers = {"DMA": _STREAMS.get(name, ""), "OTG": _ENDPOINTS}.get(family, index)
        if title not in wanted or index not in numbers:
            continue
        missing.discard(title)
        assert vendors.modelled, f"{name}: the table has no fields of {vendors.name}"
        yield Register(
            name=f"{family}_{title}",
            instance="OTG" if family == "OTG" else _MANUALS.get(name, name),
            index=index,
            address=block.base + vendors.offset,
            access=vendors.access,
            reset=vendors.reset,
            source="svd",
            fields=tuple(vendors.fields.values()),
        )
    assert not missing, f"{name}: the table lacks {missing}"
