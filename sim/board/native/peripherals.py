"""The classes of the busy peripherals with their registers and time in C: see `sim.board.native.callbacks`.

Each is its parent until `adopt` moves its registers. The parent's judgements stay and read the same registers
through `_Words`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, MutableMapping, Sequence
from ctypes import c_uint32
from typing import TYPE_CHECKING, Any

from sim.board.core.context import Alarm, Context
from sim.board.core.engine import NEVER
from sim.board.core.engine import Alarm as EngineAlarm
from sim.board.peripherals.dma import Dma, DmaSystem, Driver
from sim.board.peripherals.exti import Exti
from sim.board.peripherals.gpio import PORTS, Pins, Port
from sim.board.peripherals.spi import Spi
from sim.board.peripherals.syscfg import Syscfg
from sim.board.peripherals.timer import CHANNELS, Timer
from sim.board.registers.bus import Block, Device, Register

if TYPE_CHECKING:
    from sim.board.native.callbacks import Hot

TIMER_NAMES = ("TIM1", "TIM2", "TIM3", "TIM4", "TIM5", "TIM8")  # in C's order
TIMER_SOURCE, PYTHON_SOURCE = 2, 32  # enum source of native.h


class _Words(MutableMapping[str, int]):
    """A device's registers by name, kept in C."""

    def __init__(self, block: Block, array: Any) -> None:  # noqa: ANN401 - a pointer of ctypes
        self._places = {r.name: r.offset >> 2 for r in block.registers.values() if r.modelled}
        self._array = array

    def __getitem__(self, name: str) -> int:
        return int(self._array[self._places[name]])

    def __setitem__(self, name: str, value: int) -> None:
        self._array[self._places[name]] = value

    def __delitem__(self, name: str) -> None:
        raise TypeError("a register stays")

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)


class InC(Device):
    """What all devices in C have in common. Until `adopt`, a plain device."""

    _hot: Hot | None = None
    _number = 0
    _clocked = True

    def adopt(self, hot: Hot, number: int) -> None:
        """From now on the registers are those of C's device `number`."""
        self._hot, self._number = hot, number
        array = hot.library.hot_words(hot.handle, number)
        self.words = _Words(self.block, array)  # type: ignore[assignment]
        hot.library.hot_clock(hot.handle, number, self._clocked)

    @property
    def clocked(self) -> bool:  # type: ignore[override]
        return self._clocked

    @clocked.setter
    def clocked(self, on: bool) -> None:
        self._clocked = on
        if self._hot is not None:
            self._hot.library.hot_clock(self._hot.handle, self._number, on)

    def reset(self) -> None:
        if self._hot is not None:
            self._hot.library.hot_reset(self._hot.handle, self._number)

    def counts(self, register: Register) -> tuple[int, int] | None:
        if self._hot is None:
            return None
        touched, handle, slot = self._hot.library.hot_touched, self._hot.handle, register.offset >> 2
        return int(touched(handle, self._number, slot, False)), int(touched(handle, self._number, slot, True))

    def state(self) -> Any:  # noqa: ANN401
        return self._clocked  # the rest is Hot's

    def restore(self, state: Any) -> None:  # noqa: ANN401
        self._clocked = state


class HotPort(InC, Port):
    """GPIO in C."""

    def level(self, pin: int) -> bool:
        assert self._hot is not None
        return bool(self._hot.library.hot_level(self._hot.handle, PORTS.index(self.letter), pin))


class HotPins(Pins):
    """All ports in C."""

    _hot: Hot | None = None

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self.ports = {letter: HotPort(context, letter) for letter in PORTS}
        self._context = context

    def adopt(self, hot: Hot) -> None:
        """The ports are C's from now on."""
        self._hot = hot

    def drive(self, name: str, level: bool) -> None:
        if self._hot is not None:
            self._hot.library.hot_drive(self._hot.handle, PORTS.index(name[1]), int(name[2:]), level)

    def pulse(self, name: str) -> None:
        if self._hot is not None:
            self._hot.library.hot_pulse(self._hot.handle, PORTS.index(name[1]), int(name[2:]))

    def watch(self, name: str, listener: Callable[[bool], None]) -> None:
        port, pin = self._place(name)
        port.listeners[pin] = listener
        if self._hot is not None:
            self._hot.library.hot_watch(self._hot.handle, PORTS.index(name[1]), pin)

    def expect(self, signal: str, user: str) -> None:
        self._good.clear()
        super().expect(signal, user)


class HotSyscfg(InC, Syscfg):
    """SYSCFG in C."""


class HotExti(InC, Exti):
    """EXTI in C."""

    def edge(self, port: str, line: int, rising: bool) -> None:
        raise AssertionError("edges come by the pins, in C")


class HotSpi(InC, Spi):
    """SPI1 in C; what the chip answers comes from Python, but for its data."""

    on_errors: Callable[[bool], None] = staticmethod(lambda any_: None)  # hears whether there are any

    @property
    def bit_error_rate(self) -> float:  # type: ignore[override]
        """Of received bits, as injected by a fault campaign."""
        return self._bit_error_rate

    @bit_error_rate.setter
    def bit_error_rate(self, rate: float) -> None:
        self._bit_error_rate = rate
        self.on_errors(rate > 0.0)

    def state(self) -> Any:  # noqa: ANN401
        return {"clocked": self._clocked, "rate": self.bit_error_rate, "random": self._random.getstate()}

    def restore(self, state: Any) -> None:  # noqa: ANN401
        self._clocked, self.bit_error_rate = state["clocked"], state["rate"]
        self._random.setstate(state["random"])

    @property
    def clock_hz(self) -> float:
        assert self._hot is not None
        return self._hot.clocks.apb2 / (2 << self.get("CR1", "BR"))


class HotTimer(InC, Timer):
    """A timer in C; its pulses come to `outputs` as ever."""


class HotDma(InC, Dma):
    """A controller in C."""

    def sync(self) -> None:
        assert self._hot is not None
        self._hot.library.hot_sync(self._hot.handle, self.number - 1)


class HotDmaSystem(DmaSystem):
    """Both controllers in C, for the drivers in Python."""

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self.controllers = {number: HotDma(context, number, self) for number in (1, 2)}
        self._hot: Hot | None = None
        self._names: dict[int, str] = {}
        self._ids = {"SPI1_RX": 0, "SPI1_TX": 1}
        for number, timer in enumerate(TIMER_NAMES):
            names = (f"{timer}_UP", *(f"{timer}_CH{i}" for i in range(1, CHANNELS + 1)))
            self._ids |= {name: TIMER_SOURCE + 5 * number + k for k, name in enumerate(names)}

    def adopt(self, hot: Hot) -> None:
        """The controllers are C's from now on."""
        self._hot = hot

    def connect(self, source: str, driver: Driver) -> None:
        if source not in self._ids:
            self._ids[source] = max(PYTHON_SOURCE, *(i + 1 for i in self._ids.values()))
        self._names[self._ids[source]] = source
        super().connect(source, driver)

    def id(self, source: str) -> int:
        """C's number of a request."""
        return self._ids[source]

    def name(self, number: int) -> str:
        """The inverse."""
        return self._names[number]

    def available(self, source: str) -> int:
        assert self._hot is not None
        return int(self._hot.library.hot_available(self._hot.handle, self._ids[source]))

    def total(self, source: str) -> int:
        assert self._hot is not None
        return int(self._hot.library.hot_total(self._hot.handle, self._ids[source]))

    def wake(self, source: str, alarm: Alarm, cycle: int | None, *, quiet: bool = True) -> None:
        assert self._hot is not None
        assert isinstance(alarm, EngineAlarm)
        when = NEVER if cycle is None else cycle
        self._hot.library.hot_wake(self._hot.handle, self._ids[source], alarm.number, when, quiet)

    def until_flag(self, source: str) -> int:
        assert self._hot is not None
        return int(self._hot.library.hot_until_flag(self._hot.handle, self._ids[source]))

    def target(self, source: str) -> int:
        assert self._hot is not None
        return int(self._hot.library.hot_target(self._hot.handle, self._ids[source]))

    def circular(self, source: str) -> bool:
        assert self._hot is not None
        return bool(self._hot.library.hot_circular(self._hot.handle, self._ids[source]))

    def take(self, source: str, count: int) -> list[int]:
        assert self._hot is not None
        items = (c_uint32 * count)()
        taken = self._hot.library.hot_take(self._hot.handle, self._ids[source], items, count)
        self._hot.engine.raise_now()
        return list(items[:taken])

    def give(self, source: str, items: Sequence[int]) -> None:
        assert self._hot is not None
        array = (c_uint32 * len(items))(*items)
        self._hot.library.hot_give(self._hot.handle, self._ids[source], array, len(items))
        self._hot.engine.raise_now()

    def forget(self, number: int) -> None:
        """C forgets by itself."""

    def relink(self) -> None:
        """C's state says what serves what."""

    def driver(self, source: str) -> Driver:
        """Who makes a request."""
        return self._drivers[source]
