"""EXTI and SYSCFG: edges of pins become pending bits and interrupts, in C (native/c/pins.c)."""

from __future__ import annotations

from neuroflight.sim.board.native.library import Native, NativeDevice
from neuroflight.sim.board.registers.bus import load_table

# The interrupts of EXTI, in C's order; lines share some of them (RM0431, vector table).
_INTERRUPTS = (*(f"EXTI{i}" for i in range(5)), "EXTI9_5", "EXTI15_10", "PVD")


class Exti(NativeDevice):
    """External interrupts, lines 0 to 15 and the supply's."""

    def __init__(self, native: Native) -> None:
        interrupts = tuple(map(load_table().interrupt, _INTERRUPTS))
        super().__init__(native, "EXTI", native.library.EXTI, interrupts=interrupts)


class Syscfg(NativeDevice):
    """The system configuration: the port behind each external interrupt line."""

    def __init__(self, native: Native) -> None:
        super().__init__(native, "SYSCFG", native.library.SYSCFG)
