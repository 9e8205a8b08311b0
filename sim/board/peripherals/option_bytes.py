"""Option bytes, unique id and flash size.

Option bytes are read into FLASH_OPTCR, OPTCR1 and OPTCR2 at each reset and outlive all of them.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, replace

UID_ADDRESS = 0x1FF07A10  # 96 bits (RM0431, device electronic signature; not in the vendor's description)
FLASH_SIZE_ADDRESS = 0x1FF07A22  # [KiB], 16 bits
UID = (0x0033004B, 0x31385107, 0x30383733)  # like a real one: wafer position, lot
BOOT_ADDRESS_UNIT = 14  # BOOT_ADDx times 2^14 is where the vectors are

_OPTLOCK, _OPTSTRT = 1 << 0, 1 << 1


@dataclass(frozen=True)
class OptionBytes:
    """As the chip leaves its factory: unprotected, boot from flash's ITCM alias, watchdog by software."""

    optcr: int = 0xC0FFAAFC  # without lock and start bits
    optcr1: int = 0x00400080
    optcr2: int = 0x800000FF

    @property
    def boot_address(self) -> int:
        """Where the core fetches its vectors with the BOOT button released."""
        return (self.optcr1 & 0xFFFF) << BOOT_ADDRESS_UNIT

    @property
    def button_address(self) -> int:
        """Likewise with the button held: the ROM's, in its ITCM alias."""
        return (self.optcr1 >> 16) << BOOT_ADDRESS_UNIT

    @property
    def read_protection(self) -> int:
        """RDP: 0xAA none, 0xCC for ever, else level 1."""
        return self.optcr >> 8 & 0xFF

    @property
    def hardware_watchdog(self) -> bool:
        """Whether IWDG runs from reset on (IWDG_SW 0)."""
        return not self.optcr >> 5 & 1

    @property
    def detects_brown_out(self) -> bool:
        """Whether BOR_LEV is a threshold; else only the power-on reset sees a dip."""
        return self.optcr >> 2 & 3 != 3

    def protects(self, sector: int) -> bool:
        """Whether nWRP keeps `sector` from being written."""
        return not self.optcr >> 16 + sector & 1

    def with_registers(self, optcr: int, optcr1: int, optcr2: int) -> OptionBytes:
        """As programmed from the registers."""
        return replace(self, optcr=optcr & ~(_OPTLOCK | _OPTSTRT), optcr1=optcr1, optcr2=optcr2)


def signature(uid: tuple[int, int, int] = UID, flash_kilobytes: int = 512) -> tuple[tuple[int, bytes], ...]:
    """Address and bytes of what the factory wrote to system memory."""
    return ((UID_ADDRESS, struct.pack("<3I", *uid)), (FLASH_SIZE_ADDRESS, struct.pack("<H", flash_kilobytes)))
