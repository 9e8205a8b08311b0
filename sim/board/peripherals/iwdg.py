"""IWDG: the watchdog on its own 32 kHz oscillator. Once started nothing stops it but a reset."""

from __future__ import annotations

from collections.abc import Callable

from sim.board.core.context import TIME_HZ, Context
from sim.board.peripherals.rcc import LSI_HZ
from sim.board.registers.bus import Device

_RELOAD, _UNLOCK, _START = 0xAAAA, 0x5555, 0xCCCC  # KR (RM0431 IWDG)
_UPDATE_TICKS = 5  # of LSI divided by the prescaler, until PR or RLR takes effect


class Iwdg(Device):
    """The independent watchdog. `on_timeout` says what a missed one comes to; a reset by itself."""

    kept = ("_unlocked", "_running", "_prescaler", "_reload", "lsi_hz", "feeds", "closest")

    def __init__(self, context: Context, lsi_hz: int = LSI_HZ) -> None:
        super().__init__(context, "IWDG")
        self.lsi_hz = lsi_hz  # 17 to 47 kHz from chip to chip (data sheet)
        self.on_timeout: Callable[[], None] = lambda: context.system_reset("iwdg")
        self.by_hardware: Callable[[], bool] = lambda: False  # runs from reset on, by the option bytes
        self._timeout = context.alarm("iwdg.timeout", self._miss)
        self._pr_done = context.alarm("iwdg.pr", self._take_prescaler)
        self._rlr_done = context.alarm("iwdg.rlr", self._take_reload)
        self.feeds = 0
        self.closest: int | None = None  # cycles that were left at the latest feed of all
        self._stop()

    def _stop(self) -> None:
        self._unlocked = self._running = False
        self._prescaler, self._reload = 4, 0xFFF

    def reset(self) -> None:
        super().reset()
        self._stop()
        for alarm in (self._timeout, self._pr_done, self._rlr_done):
            alarm.cancel()
        if self.by_hardware():
            self._start()

    @property
    def timeout_s(self) -> float:
        """From a feed to the reset."""
        return self._ticks(self._reload + 1) / TIME_HZ

    def _start(self) -> None:
        if not self._running:
            self._running = True
            self._feed()

    def write_kr(self, value: int) -> None:
        self._unlocked = value == _UNLOCK
        if value == _START:
            self._start()
        elif value == _RELOAD:
            if self._running:
                self._note_left()
                self._feed()
        elif value != _UNLOCK:
            self.context.fail(f"IWDG_KR = 0x{value:04X}, expected 0xAAAA, 0x5555 or 0xCCCC")

    def write_pr(self, value: int) -> None:
        self._update("PR", "PVU", value)
        self._pr_done.set(self.context.cycle + self._ticks(_UPDATE_TICKS))

    def write_rlr(self, value: int) -> None:
        self._update("RLR", "RVU", value)
        self._rlr_done.set(self.context.cycle + self._ticks(_UPDATE_TICKS))

    def _update(self, register: str, flag: str, value: int) -> None:
        if not self._unlocked:
            self.context.fail(
                f"IWDG_{register} is written while it is locked, expected IWDG_KR 0x5555 before"
            )
        if self.get("SR", flag):
            self.context.fail(f"IWDG_{register} is written while IWDG_SR {flag} is 1, expected 0")
        self.keep(register, value)
        self.put("SR", flag, 1)

    def _take_prescaler(self) -> None:
        self.put("SR", "PVU", 0)
        left = self._timeout.due
        ticks = 0 if left is None else (left - self.context.cycle) // self._ticks(1)
        self._prescaler = 4 << min(self.words["PR"], 6)
        if left is not None:
            self._timeout.set(self.context.cycle + ticks * self._ticks(1))

    def _take_reload(self) -> None:
        self.put("SR", "RVU", 0)
        self._reload = self.words["RLR"]

    def _ticks(self, count: int) -> int:
        return count * self._prescaler * TIME_HZ // self.lsi_hz

    def _feed(self) -> None:
        self.feeds += 1
        self._timeout.set(self.context.cycle + self._ticks(self._reload + 1))

    def _note_left(self) -> None:
        if self._timeout.due is not None:
            left = self._timeout.due - self.context.cycle
            self.closest = left if self.closest is None else min(left, self.closest)

    def _miss(self) -> None:
        self.on_timeout()
