"""The watchdog whose feeds are C's (`callbacks.py`). Whatever else is written to it is its parent's."""

from __future__ import annotations

import ctypes
from ctypes import c_uint64
from typing import TYPE_CHECKING, Any

from sim.board.core.context import Context
from sim.board.core.engine import NEVER
from sim.board.peripherals.iwdg import Iwdg
from sim.board.peripherals.rcc import LSI_HZ
from sim.board.registers.bus import Register

if TYPE_CHECKING:
    from sim.board.native.callbacks import Hot


class _State(ctypes.Structure):
    """`struct watchdog` of native.h."""

    _fields_ = tuple((name, c_uint64) for name in ("period", "feeds", "closest", "writes"))


class HotIwdg(Iwdg):
    """The independent watchdog, fed in C while it runs and is locked."""

    def __init__(self, context: Context, lsi_hz: int = LSI_HZ) -> None:
        self._in_c = _State(closest=NEVER)
        super().__init__(context, lsi_hz)

    def adopt(self, hot: Hot, window: int, offset: int) -> None:
        """From now on the state is in C's memory; `offset` of the engine's `window` is the key register."""
        place = hot.library.hot_watchdog(hot.handle, window, offset, hot.engine.alarms["iwdg.timeout"].number)
        ctypes.memmove(place, ctypes.addressof(self._in_c), ctypes.sizeof(_State))
        self._in_c = _State.from_address(place)
        self._tell()

    def _tell(self) -> None:
        plain = self._running and not self._unlocked
        self._in_c.period = self._ticks(self._reload + 1) if plain else 0

    @property
    def feeds(self) -> int:  # type: ignore[override]
        """How often it was fed."""
        return int(self._in_c.feeds)

    @feeds.setter
    def feeds(self, count: int) -> None:
        self._in_c.feeds = count

    @property
    def closest(self) -> int | None:  # type: ignore[override]
        """Cycles that were left at the latest feed of all."""
        closest = int(self._in_c.closest)
        return None if closest == NEVER else closest

    @closest.setter
    def closest(self, cycles: int | None) -> None:
        self._in_c.closest = NEVER if cycles is None else cycles

    @property
    def lsi_hz(self) -> int:  # type: ignore[override]
        """Of its oscillator; 17 to 47 kHz from chip to chip (data sheet)."""
        return self._lsi_hz

    @lsi_hz.setter
    def lsi_hz(self, hz: int) -> None:
        first = not hasattr(self, "_lsi_hz")
        self._lsi_hz = hz
        if not first:
            self._tell()

    def write_kr(self, value: int) -> None:
        self._in_c.writes += 1
        super().write_kr(value)
        self._tell()

    def counts(self, register: Register) -> tuple[int, int] | None:
        return (0, int(self._in_c.writes)) if register.name == "KR" else None

    def reset(self) -> None:
        super().reset()
        self._tell()

    def restore(self, state: Any) -> None:  # noqa: ANN401
        super().restore(state)
        self._tell()

    def _take_prescaler(self) -> None:
        super()._take_prescaler()
        self._tell()

    def _take_reload(self) -> None:
        super()._take_reload()
        self._tell()
