"""The registers of the core and the chip's unique id, stated by hand from the manuals.

The vendor's description has the core of a Cortex-M4 (its CPUID says 0x410FC241) and knows neither the cycle
counter nor the unique id. Fields that it has too must be the same bits: extract.py compares them. ARMv7-M is
DDI 0403E, TRM the Cortex-M7's DDI 0489, RM0431 the chip's manual.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from neuroflight.sim.board.registers.bus import Field


@dataclass(frozen=True)
class Register:
    """A 32-bit register under the manual's name, e.g. NVIC_ISER of index 2, or DMA_SCR of DMA2, index 1."""

    name: str  # FAMILY_REGISTER
    instance: str  # the peripheral, or the family itself where there is but one
    index: str  # stream, channel or word; empty where there is but one
    address: int
    access: str  # r, w or rw
    reset: int | None  # None: depends on the chip's state
    source: str  # the manual's section, or "svd"
    fields: tuple[Field, ...]


# register, index, address, access, value after reset (None: depends), manual, fields (name@lsb+width:access)
_STATED: tuple[tuple[str, str, int, str, int | None, str, str], ...] = (
    ("SYST_CSR", "", 0xE000E010, "rw", 0, "ARMv7-M B3.3.3", "ENABLE@0 TICKINT@1 CLKSOURCE@2 COUNTFLAG@16"),
    ("SYST_RVR", "", 0xE000E014, "rw", None, "ARMv7-M B3.3.4", "RELOAD@0+24"),
    ("SYST_CVR", "", 0xE000E018, "rw", None, "ARMv7-M B3.3.5", "CURRENT@0+24"),
    *(("NVIC_ISER", str(i), 0xE000E100 + 4 * i, "rw", 0, "ARMv7-M B3.4.4", "SETENA@0+32") for i in range(4)),
    *(
        ("NVIC_IPR", str(i), 0xE000E400 + 4 * i, "rw", 0, "ARMv7-M B3.4.9", "")
        for i in (2, 14, 15, 17)  # of interrupts 9, 58, 60 and 69
    ),
    ("SCB_ICSR", "", 0xE000ED04, "rw", 0, "ARMv7-M B3.2.4", "VECTACTIVE@0+9 PENDSVSET@28"),
    ("SCB_VTOR", "", 0xE000ED08, "rw", None, "ARMv7-M B3.2.5", ""),
    ("SCB_AIRCR", "", 0xE000ED0C, "rw", 0xFA050000, "ARMv7-M B3.2.6", "SYSRESETREQ@2 VECTKEY@16+16"),
    (
        "SCB_CCR",
        "",
        0xE000ED14,
        "rw",
        0x00040200,
        "ARMv7-M B3.2.8",
        "NONBASETHRDENA@0 USERSETMPEND@1 UNALIGN_TRP@3 DIV_0_TRP@4 BFHFNMIGN@8 STKALIGN@9 DC@16 IC@17 BP@18",
    ),
    ("SCB_SHPR3", "", 0xE000ED20, "rw", 0, "ARMv7-M B3.2.12", "PRI_12@0+8 PRI_14@16+8 PRI_15@24+8"),
    (
        "SCB_SHCSR",
        "",
        0xE000ED24,
        "rw",
        0,
        "ARMv7-M B3.2.13",
        "MEMFAULTACT@0 BUSFAULTACT@1 USGFAULTACT@3 SVCALLACT@7 MONITORACT@8 PENDSVACT@10 SYSTICKACT@11"
        " USGFAULTPENDED@12 MEMFAULTPENDED@13 BUSFAULTPENDED@14 SVCALLPENDED@15"
        " MEMFAULTENA@16 BUSFAULTENA@17 USGFAULTENA@18",
    ),
    ("SCB_CFSR", "", 0xE000ED28, "rw", 0, "ARMv7-M B3.2.15", ""),
    ("SCB_HFSR", "", 0xE000ED2C, "rw", 0, "ARMv7-M B3.2.16", ""),
    ("SCB_MMFAR", "", 0xE000ED34, "rw", None, "ARMv7-M B3.2.18", ""),
    ("SCB_BFAR", "", 0xE000ED38, "rw", None, "ARMv7-M B3.2.19", ""),
    # 8 KB data cache: 64 sets, 4 ways, 32-byte lines; as read with CSSELR 0.
    (
        "SCB_CCSIDR",
        "",
        0xE000ED80,
        "r",
        0xF007E019,
        "ARMv7-M B4.8.3",
        "LINESIZE@0+3 ASSOCIATIVITY@3+10 NUMSETS@13+15 WA@28 RA@29 WB@30 WT@31",
    ),
    ("SCB_CSSELR", "", 0xE000ED84, "rw", None, "ARMv7-M B4.8.2", "IND@0 LEVEL@1+3"),
    ("SCB_CPACR", "", 0xE000ED88, "rw", 0, "ARMv7-M B3.2.20", "CP10@20+2 CP11@22+2"),
    ("MPU_CTRL", "", 0xE000ED94, "rw", 0, "ARMv7-M B3.5.5", "ENABLE@0 HFNMIENA@1 PRIVDEFENA@2"),
    ("MPU_RNR", "", 0xE000ED98, "rw", None, "ARMv7-M B3.5.6", "REGION@0+8"),
    ("MPU_RBAR", "", 0xE000ED9C, "rw", None, "ARMv7-M B3.5.7", "REGION@0+4 VALID@4 ADDR@5+27"),
    (
        "MPU_RASR",
        "",
        0xE000EDA0,
        "rw",
        None,
        "ARMv7-M B3.5.8",
        "ENABLE@0 SIZE@1+5 SRD@8+8 B@16 C@17 S@18 TEX@19+3 AP@24+3 XN@28",
    ),
    ("SCB_ICIALLU", "", 0xE000EF50, "w", None, "ARMv7-M B3.2.26", ""),
    ("SCB_DCISW", "", 0xE000EF60, "w", None, "ARMv7-M B3.2.26", ""),
    ("SCB_DCCISW", "", 0xE000EF74, "w", None, "ARMv7-M B3.2.26", ""),
    ("DCB_DEMCR", "", 0xE000EDFC, "rw", 0, "ARMv7-M C1.6.5", "TRCENA@24"),
    ("DWT_CTRL", "", 0xE0001000, "rw", 0x40000000, "ARMv7-M C1.8.7", "CYCCNTENA@0 NUMCOMP@28+4:r"),
    ("DWT_CYCCNT", "", 0xE0001004, "rw", None, "ARMv7-M C1.8.8", "CYCCNT@0+32"),
    ("DWT_LAR", "", 0xE0001FB0, "w", None, "TRM, CoreSight lock access", ""),
    *(
        ("SIGNATURE_UID", str(i), 0x1FF07A10 + 4 * i, "r", None, "RM0431 electronic signature", "")
        for i in range(3)
    ),
)


def _register(
    name: str, index: str, address: int, access: str, reset: int | None, source: str, fields: str
) -> Register:
    found = re.findall(r"(\w+)@(\d+)(?:\+(\d+))?(?::(\w+))?", fields)
    bits = tuple(
        Field(f, int(lsb), int(width or 1), rights or access, False) for f, lsb, width, rights in found
    )
    return Register(name, name.split("_")[0], index, address, access, reset, source, bits)


CORE_REGISTERS = tuple(_register(*row) for row in _STATED)
