"""The MATEKF722's memories and what lies in which sector of its flash."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Region:
    """A span of the address space: [address, address + size)."""

    name: str
    address: int
    size: int


FLASH_BASE = 0x08000000
FLASH_BYTES = 512 * 1024
FLASH_SECTORS = (
    *(Region(f"sector {i}", FLASH_BASE + i * 0x4000, 0x4000) for i in range(4)),
    Region("sector 4", FLASH_BASE + 0x10000, 0x10000),
    *(Region(f"sector {i}", FLASH_BASE + (i - 4) * 0x20000, 0x20000) for i in range(5, 8)),
)
FLASH_BOOT = FLASH_SECTORS[0]
FLASH_SETTINGS = (FLASH_SECTORS[1], FLASH_SECTORS[2])
FLASH_FAULT_RECORD = FLASH_SECTORS[3]
FLASH_POLICY_SLOTS = (FLASH_SECTORS[4], Region("policy slot B", FLASH_SECTORS[7].address, 0x10000))
FLASH_BANKS = (FLASH_SECTORS[5], FLASH_SECTORS[6])
FLASH_BANK_A, FLASH_BANK_B = FLASH_BANKS
NULL_PAGE_BYTES = 512  # at the begin of ITCM, closed by the MPU: what follows a null pointer faults
ITCM = Region("ITCM", 0x00000000, 16 * 1024)
DTCM = Region("DTCM", 0x20000000, 64 * 1024)
SRAM1 = Region("SRAM1", 0x20010000, 176 * 1024)
SRAM2 = Region("SRAM2", 0x2003C000, 16 * 1024)
