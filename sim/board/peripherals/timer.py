"""TIM1 to TIM5 and TIM8: the rules for outputs and DMA requests. They count in C (native/c/timer.c)."""

from __future__ import annotations

from typing import NoReturn

from neuroflight.sim.board.native.library import Native, NativeDevice
from neuroflight.sim.board.peripherals.dma import DmaSystem
from neuroflight.sim.board.peripherals.gpio import Pins
from neuroflight.sim.board.registers.bus import load_table

TIMERS = ("TIM1", "TIM2", "TIM3", "TIM4", "TIM5", "TIM8")  # in C's order
ADVANCED = ("TIM1", "TIM8")  # with a main output switch; on APB2
CHANNELS = 4
_UPDATE_IRQ = {"TIM1": "TIM1_UP_TIM10", "TIM8": "TIM8_UP_TIM13"}
_PWM_1 = 6  # OCxM: high while the counter is below the compare value
_CCR1 = 13  # DCR counts words from CR1
_FED = ("CCR", "ARR", "PSC")  # what registers that DMA may write begin with


class Timer(NativeDevice):
    """One timer, counting up."""

    def __init__(self, native: Native, name: str, dma: DmaSystem, pins: Pins) -> None:
        lib, place = native.library, TIMERS.index(name)
        irq = load_table().interrupt(_UPDATE_IRQ.get(name, name))
        super().__init__(
            native, name, lib.TIMER, place,
            alarm=f"{name.lower()}.update", interrupts=(irq,), advanced=name in ADVANCED,
        )  # fmt: skip
        self._pins = pins
        first = lib.TIMER_SOURCE + (1 + CHANNELS) * place
        self._update = dma.request(f"{name}_UP", first)
        self._channels = [dma.request(f"{name}_CH{i}", first + i) for i in range(1, 1 + CHANNELS)]
        self.queries = {
            lib.QUERY_OUTPUT: lambda channel, _: self._validate_output(channel),
            lib.QUERY_TARGET: lambda request, _: self._validate_targets(request),
            lib.QUERY_COMPARE: "{name}_CH{a} feeds a register of the timer with CR2 CCDS 0: modelled at "
            "updates only, expected CCDS 1",
            lib.QUERY_DMAR: lambda write, _: self._reject_dmar(bool(write)),
        }

    def _reject_dmar(self, write: bool) -> NoReturn:
        if write:
            self.engine.fail(f"{self.name}_DMAR is written by the program, expected by DMA")
        self.engine.fail(f"{self.name}_DMAR is read, expected DMA to write it")

    def _validate_output(self, channel: int) -> None:
        """Fail unless channel 1..4 may make pulses."""
        register = "CCMR1" if channel < 3 else "CCMR2"
        mode = self.get(register, f"OC{channel}M")
        signal = f"{self.name}_CH{channel}"
        if self.name in ADVANCED and not self.get("BDTR", "MOE"):
            self.engine.fail(f"{signal} makes pulses while {self.name}_BDTR MOE is 0, expected 1")
        if mode != _PWM_1:
            self.engine.fail(f"{signal} is driven with OC{channel}M {mode}, expected 6: PWM mode 1")
        self._pins.expect(signal, f"{self.name} makes pulses on channel {channel}")

    def _validate_targets(self, request: int) -> None:
        """Fail unless a request feeds registers that it may: one, or a burst of them through DMAR."""
        asks = (self._update, *self._channels)[request]
        names = {r.offset: r.name for r in self.block.registers.values()}
        name = names.get(asks.target - self.block.base)
        if name != "DMAR":
            if name is None or not name.startswith(_FED):
                source = f"{self.name}_{f'CH{request}' if request else 'UP'}"
                self.engine.fail(f"{source} feeds {name or 'nothing'}, expected a CCR, ARR, PSC or DMAR")
            return
        first, count = self.get("DCR", "DBA"), self.get("DCR", "DBL") + 1
        burst = [names.get(4 * (first + i), "?") for i in range(count)]
        if not all(one.startswith(_FED) for one in burst):
            self.engine.fail(
                f"{self.name}_DCR bursts into {', '.join(burst)}, expected ARR, PSC or CCR1 ({_CCR1}) and on"
            )
