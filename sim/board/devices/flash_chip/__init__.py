"""A flash chip on SPI, NOR or NAND, in memory or backed by a file (docs/explanation/emulated-board.md)."""

from neuroflight.sim.board.devices.flash_chip.chip import FlashChip
from neuroflight.sim.board.devices.flash_chip.kinds import KINDS, ChipKind
from neuroflight.sim.board.devices.flash_chip.memory import FlashMemory

__all__ = ["KINDS", "ChipKind", "FlashChip", "FlashMemory"]
