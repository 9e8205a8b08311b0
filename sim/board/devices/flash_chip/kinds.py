"""Kinds of flash chips: what they answer, how they are divided, and how long they take.

Times are the data sheets' typical and longest ones (W25Q128JV rev. F, 9.6; W25N01GV rev. O, 9.5; M25P16,
table 17); those of the other chips are taken to be their kin's. Nothing here was measured on a chip.
"""

from __future__ import annotations

from dataclasses import dataclass

Range = tuple[float, float]  # typical and longest [s]


@dataclass(frozen=True)
class ChipKind:
    """A kind of chip; of a package with several dies all of them."""

    name: str
    identity: bytes  # what command 0x9F answers
    blocks: int  # that command 0xD8 erases
    nand: bool = False
    dies: int = 1
    program: Range = (0.4e-3, 3e-3)
    erase: Range = (0.15, 2.0)
    status: Range = (10e-3, 15e-3)  # a NOR chip's status written
    load: Range = (25e-6, 60e-6)  # a NAND chip's page into its buffer

    @property
    def page_bytes(self) -> int:
        """Bytes of a page that a program uses."""
        return 2048 if self.nand else 256

    @property
    def spare_bytes(self) -> int:
        """Further ones behind them."""
        return {"W25N02K": 128}.get(self.name, 64) if self.nand else 0

    @property
    def pages(self) -> int:
        """Pages of a block."""
        return 64 if self.nand else 256

    @property
    def whole_page(self) -> int:
        return self.page_bytes + self.spare_bytes

    @property
    def read_hz(self) -> float:
        """SCK at most, of the slowest read command."""
        return 20e6 if self.name == "M25P16" else 50e6


def _nor(name: str, identity: int, megabytes: int, **more: object) -> ChipKind:
    return ChipKind(name, identity.to_bytes(3, "big"), megabytes * 16, **more)  # type: ignore[arg-type]


def _nand(name: str, identity: int, blocks: int, dies: int = 1) -> ChipKind:
    times = {"program": (0.25e-3, 0.7e-3), "erase": (2e-3, 10e-3)}
    return ChipKind(name, identity.to_bytes(3, "big"), blocks, nand=True, dies=dies, **times)


KINDS = {
    kind.name: kind
    for kind in (
        _nor("W25Q80", 0xEF4014, 1),
        _nor("W25Q16", 0xEF4015, 2),
        _nor("W25Q128", 0xEF4018, 16),
        _nor("W25Q256", 0xEF4019, 32),
        _nor("W25Q512", 0xEF4020, 64),
        _nor("W25M512", 0xEF7119, 64, dies=2),
        _nor("GD25Q128", 0xC84018, 16),
        _nor("MX25L128", 0xC22018, 16),
        _nor("N25Q128", 0x20BA18, 16),
        _nor("M25P16", 0x202015, 2, program=(0.64e-3, 5e-3), erase=(0.6, 3.0)),
        _nor("PY25Q128HA", 0x852018, 16),
        _nand("W25N01G", 0xEFAA21, 1024),
        _nand("W25N02K", 0xEFAA22, 2048),
        _nand("W25M02G", 0xEFAB21, 2048, dies=2),
    )
}
