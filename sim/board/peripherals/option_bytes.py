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
    """The option bytes, by default the factory's: unprotected, flash's ITCM alias, no watchdog."""

    optcr: int = 0xC0FFAAFC  # without lock and start bits
    optcr1: int = 0x00400080
    optcr2: int = 0x800000FF

    @property
    def boot_address(self) -> int:
        """Address of the core's vectors with the BOOT button released."""
        return (self.optcr1 & 0xFFFF) << BOOT_ADDRESS_UNIT

    @property
    def button_address(self) -> int:
        """Address of the core's vectors with the button held: the ROM's, in its ITCM alias."""
        return (self.optcr1 >> 16) << BOOT_ADDRESS_UNIT

    @property
    def hardware_watchdog(self) -> bool:
        """True if IWDG runs from reset on (IWDG_SW 0)."""
        return not self.optcr >> 5 & 1

    @property
    def detects_brown_out(self) -> bool:
        """True if BOR_LEV is a threshold; otherwise only the power-on reset detects a dip."""
        return self.optcr >> 2 & 3 != 3

    def protects(self, sector: int) -> bool:
        """Return True if nWRP protects `sector` from being written."""
        return not self.optcr >> 16 + sector & 1

    def with_registers(self, optcr: int, optcr1: int, optcr2: int) -> OptionBytes:
        """Return the option bytes programmed from the registers."""
        return replace(self, optcr=optcr & ~(_OPTLOCK | _OPTSTRT), optcr1=optcr1, optcr2=optcr2)


def signature(uid: tuple[int, int, int] = UID, flash_kilobytes: int = 512) -> tuple[tuple[int, bytes], ...]:
    """Return address and bytes of the factory's data in system memory."""
    return ((UID_ADDRESS, struct.pack("<3I", *uid)), (FLASH_SIZE_ADDRESS, struct.pack("<H", flash_kilobytes)))
