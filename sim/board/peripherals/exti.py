"""EXTI: edges of pins become pending bits and interrupts."""

from __future__ import annotations

from sim.board.core.context import Context
from sim.board.peripherals.syscfg import Syscfg
from sim.board.registers.bus import Device, load_table

_LINES_OF = {  # interrupt: the lines that share it (RM0431, vector table)
    **{f"EXTI{i}": 1 << i for i in range(5)},
    "EXTI9_5": 0x03E0,
    "EXTI15_10": 0xFC00,
    "PVD": 1 << 16,
}


class Exti(Device):
    """External interrupts, lines 0 to 15 and the supply's."""

    def __init__(self, context: Context, syscfg: Syscfg) -> None:
        super().__init__(context, "EXTI")
        self._syscfg = syscfg
        self._interrupts = {load_table().interrupt(name): lines for name, lines in _LINES_OF.items()}
        self._asserted = 0  # lines whose interrupts are asserted

    def edge(self, port: str, line: int, rising: bool) -> None:
        """The level on pin `line` of `port` has changed."""
        bit = 1 << line
        if not self.words["RTSR" if rising else "FTSR"] & bit:
            return
        if not self._syscfg.clocked or self._syscfg.port(line) != port:
            return
        self.words["PR"] |= bit
        self._update_irq()

    def watches_fall(self, line: int) -> bool:
        """Whether a falling edge on `line` would be seen."""
        return bool(self.words["FTSR"] >> line & 1)

    def write_pr(self, value: int) -> None:
        self.words["PR"] &= ~value
        self.words["SWIER"] &= ~value
        self._update_irq()

    def write_imr(self, value: int) -> None:
        self.keep("IMR", value)
        self._update_irq()

    def write_swier(self, value: int) -> None:
        raised = self.keep("SWIER", value) & self.words["SWIER"]
        self.words["PR"] |= raised & self.words["IMR"]
        self._update_irq()

    @property
    def interrupts(self) -> tuple[int, ...]:
        return tuple(self._interrupts)

    def reset(self) -> None:
        super().reset()
        self._update_irq()

    def restore(self, state: object) -> None:
        super().restore(state)
        self._asserted = self.words["PR"] & self.words["IMR"]

    def _update_irq(self) -> None:
        pending = self.words["PR"] & self.words["IMR"]
        changed = pending ^ self._asserted
        self._asserted = pending
        if changed:
            for number, lines in self._interrupts.items():
                if changed & lines:
                    self.context.irq(number, bool(pending & lines))
