"""IWDG: the watchdog on its own 32 kHz oscillator. Once started nothing stops it but a reset."""

from __future__ import annotations

from collections.abc import Callable

from neuroflight.sim.board.core.context import TIME_HZ
from neuroflight.sim.board.core.engine import NEVER, Alarm
from neuroflight.sim.board.native.library import Native
from neuroflight.sim.board.peripherals.rcc import LSI_HZ
from neuroflight.sim.board.registers.bus import WINDOW, Device, Register

_RELOAD, _UNLOCK, _START = 0xAAAA, 0x5555, 0xCCCC  # KR (RM0431 IWDG)
_UPDATE_TICKS = 5  # of LSI divided by the prescaler, until PR or RLR takes effect


class Iwdg(Device):
    """The independent watchdog. `on_timeout` handles a missed one; a reset by default.

    C feeds it while it runs (native/c/watchdog.c), and has what that needs.
    """

    kept = ("words", "_prescaler", "_reload")

    def __init__(self, native: Native) -> None:
        engine = native.engine
        super().__init__(engine, "IWDG")
        self._native = native
        self.on_timeout: Callable[[], None] = lambda: engine.system_reset("iwdg")
        self.by_hardware: Callable[[], bool] = lambda: False  # runs from reset on, by the option bytes
        self._timeout = engine.alarm("iwdg.timeout", lambda: self.on_timeout())
        self._pr_done = engine.alarm("iwdg.pr", self._take_prescaler)
        self._rlr_done = engine.alarm("iwdg.rlr", self._take_reload)
        self._in_c = native.library.native_watchdog(native.handle, self._timeout.number)
        self._stop()

    def place(self, window: int) -> None:
        """Place it in the engine's `window`."""
        offset = self.block.base % WINDOW
        self._native.library.native_place_watchdog(self._native.handle, window, offset)

    def _stop(self) -> None:
        self._in_c.unlocked = self._in_c.period = 0
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
        """Time from a feed to the reset."""
        return self._ticks(self._reload + 1) / TIME_HZ

    @property
    def running(self) -> bool:
        """True if it counts: only a reset stops it."""
        return bool(self._in_c.period)

    @property
    def feeds(self) -> int:
        return int(self._in_c.feeds)

    @property
    def closest(self) -> int | None:
        """Cycles that were left at the latest feed of all."""
        closest = int(self._in_c.closest)
        return None if closest == NEVER else closest

    def counts(self, register: Register) -> tuple[int, int] | None:
        return (0, int(self._in_c.writes)) if register.name == "KR" else None

    def _start(self) -> None:
        if not self._in_c.period:
            self._in_c.period = self._ticks(self._reload + 1)
            self._in_c.feeds += 1
            self._timeout.set(self.engine.cycle + self._in_c.period)

    def write_kr(self, value: int) -> None:
        """Handle a write that does not feed a running watchdog."""
        self._in_c.writes += 1
        self._in_c.unlocked = value == _UNLOCK
        if value == _START:
            self._start()
        elif value not in (_UNLOCK, _RELOAD):
            self.engine.fail(f"IWDG_KR = 0x{value:04X}, expected 0xAAAA, 0x5555 or 0xCCCC")

    def write_pr(self, value: int) -> None:
        self._update("PR", "PVU", value, self._pr_done)

    def write_rlr(self, value: int) -> None:
        self._update("RLR", "RVU", value, self._rlr_done)

    def _update(self, register: str, flag: str, value: int, done: Alarm) -> None:
        if not self._in_c.unlocked:
            self.engine.fail(f"IWDG_{register} is written while it is locked, expected IWDG_KR 0x5555 before")
        if self.get("SR", flag):
            self.engine.fail(f"IWDG_{register} is written while IWDG_SR {flag} is 1, expected 0")
        self.keep(register, value)
        self.put("SR", flag, 1)
        done.set(self.engine.cycle + self._ticks(_UPDATE_TICKS))

    def _take_prescaler(self) -> None:
        self.put("SR", "PVU", 0)
        left = self._timeout.due
        ticks = 0 if left is None else (left - self.engine.cycle) // self._ticks(1)
        self._prescaler = 4 << min(self.words["PR"], 6)
        if left is not None:
            self._timeout.set(self.engine.cycle + ticks * self._ticks(1))
        self._change_period()

    def _take_reload(self) -> None:
        self.put("SR", "RVU", 0)
        self._reload = self.words["RLR"]
        self._change_period()

    def _change_period(self) -> None:
        if self._in_c.period:
            self._in_c.period = self._ticks(self._reload + 1)

    def _ticks(self, count: int) -> int:
        return count * self._prescaler * TIME_HZ // LSI_HZ
