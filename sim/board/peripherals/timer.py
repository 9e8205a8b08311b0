"""TIM1 to TIM5 and TIM8: counters and DMA requests. They count in C (native/c/timer.c)."""

from __future__ import annotations

from typing import NoReturn

from neuroflight.sim.board.core.engine import NEVER
from neuroflight.sim.board.native.library import Native, NativeDevice
from neuroflight.sim.board.peripherals.dma import DmaSystem
from neuroflight.sim.board.registers.bus import load_table

TIMERS = ("TIM1", "TIM2", "TIM3", "TIM4", "TIM5", "TIM8")  # in C's order
ADVANCED = ("TIM1", "TIM8")  # on APB2
CHANNELS = 4
_UPDATE_IRQ = {"TIM1": "TIM1_UP_TIM10", "TIM8": "TIM8_UP_TIM13"}  # of the others: their own names


class Timer(NativeDevice):
    """One timer, counting up."""

    def __init__(self, native: Native, name: str, dma: DmaSystem) -> None:
        lib, place = native.library, TIMERS.index(name)
        self.interrupt = irq = load_table().interrupt(_UPDATE_IRQ.get(name, name))
        super().__init__(
            native, name, lib.TIMER, place,
            alarm=f"{name.lower()}.update", interrupts=(irq,), advanced=name in ADVANCED,
        )  # fmt: skip
        self._place = place
        first = lib.TIMER_SOURCE + (1 + CHANNELS) * place
        for request, what in enumerate(("UP", *(f"CH{i}" for i in range(1, 1 + CHANNELS)))):
            dma.request(f"{name}_{what}", first + request)
        self.queries = {lib.QUERY_OUTPUT: lambda outputs, _: self._reject_output(bool(outputs))}

    @property
    def rings(self) -> int | None:
        """The cycle at which an update asks for the timer's interrupt next; None: none does."""
        cycle = int(self.native.library.native_timer_rings(self.native.handle, self._place))
        return None if cycle == NEVER else cycle

    def _reject_output(self, outputs: bool) -> NoReturn:
        if outputs:
            self.engine.fail(f"{self.name}_CCER enables outputs, which the emulator does not model")
        self.engine.fail(f"{self.name}_DMAR is written: the emulator does not model bursts")
