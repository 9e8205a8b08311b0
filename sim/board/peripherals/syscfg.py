"""SYSCFG: which port each external interrupt line listens to."""

from __future__ import annotations

from sim.board.core.context import Context
from sim.board.peripherals.gpio import PORTS
from sim.board.registers.bus import Device


class Syscfg(Device):
    """System configuration."""

    def __init__(self, context: Context) -> None:
        super().__init__(context, "SYSCFG")

    def port(self, line: int) -> str:
        """The letter of the port that `line` 0..15 listens to; "?" for one that this board does not have."""
        number = self.words[f"EXTICR{line // 4 + 1}"] >> 4 * (line % 4) & 15
        return PORTS[number] if number < len(PORTS) else "?"
