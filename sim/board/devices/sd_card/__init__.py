"""An SD card in its slot, in SPI mode, backed by an image file (docs/explanation/emulated-board.md)."""

from neuroflight.sim.board.devices.sd_card.card import SdCard
from neuroflight.sim.board.devices.sd_card.delays import CardTiming
from neuroflight.sim.board.devices.sd_card.faults import CardFault, Cut

__all__ = ["CardFault", "CardTiming", "Cut", "SdCard"]
