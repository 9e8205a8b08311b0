"""The busy peripherals in C: `c/` stands between the engine and the classes of `peripherals.py`.

C moves registers and time. It asks Python to judge a set-up that it has not seen yet, for what the gyro chip
answers, and for pulses that are no ordinary DShot frame.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from ctypes import (
    CFUNCTYPE,
    POINTER,
    c_bool,
    c_double,
    c_int,
    c_int32,
    c_uint8,
    c_uint32,
    c_uint64,
    c_void_p,
)
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.board.core.context import TIME_HZ
from sim.board.core.engine import Engine, Outcome
from sim.board.core.library import AlarmCallback, ReadCallback, SleepCallback, WriteCallback
from sim.board.devices.esc import SILENT_S, Frame
from sim.board.native.esc import HotEsc
from sim.board.native.gyro_chip import HotGyroChip
from sim.board.native.iwdg import HotIwdg
from sim.board.native.peripherals import TIMER_NAMES, HotDmaSystem, HotPins, HotSpi, InC
from sim.board.peripherals.dma import Dma
from sim.board.peripherals.exti import Exti
from sim.board.peripherals.gpio import PORTS, Port
from sim.board.peripherals.rcc import Clocks
from sim.board.peripherals.spi import Spi
from sim.board.peripherals.syscfg import Syscfg
from sim.board.peripherals.timer import CHANNELS, Timer
from sim.board.registers.bus import WINDOW, Device, Registers

NEVER = 2**64 - 1
PORT, SYSCFG, EXTI, DMA, SPI, TIMER = range(1, 7)  # enum kind of native.h
ASK_ENABLE, ASK_CHANGED, ASK_FROZEN, ASK_TWICE, ASK_CACHED = range(5)  # enum question
ASK_SPI, ASK_SPI_BUSY, ASK_SPI_FULL, ASK_OUTPUT, ASK_TARGET, ASK_COMPARE, ASK_DMAR = range(5, 12)
ASK_ASLEEP = 12
_STREAM_WORDS = ("CR", "NDTR", "PAR", "M0AR", "M1AR", "FCR")
_DRAIN = 64  # in place of a source
_MOTORS = 8  # MOTORS of native.h
_SILENT = round(SILENT_S * TIME_HZ)  # [cycles]

_Refuse = CFUNCTYPE(None, c_uint32, c_uint32, c_uint32, c_uint32, c_uint32)
_Judge = CFUNCTYPE(c_int, c_uint32, c_uint32, c_uint32, c_uint32)
_Source = CFUNCTYPE(None, c_uint32, c_uint32)
_Exchange = CFUNCTYPE(None, POINTER(c_uint8), c_uint32, c_uint32, c_double, c_uint32)
_Pulses = CFUNCTYPE(None, c_uint32, c_uint32, c_uint64, c_uint64, c_uint32, POINTER(c_uint32))
_Pin = CFUNCTYPE(None, c_uint32, c_uint32, c_uint32)


class _Rule(ctypes.Structure):
    """`struct rule` of native.h."""

    _fields_ = (
        *((name, c_uint32) for name in ("reset", "fixed", "writable")),
        *((name, c_uint8) for name in ("known", "sizes", "readable", "writeable")),
    )


class _Frame(ctypes.Structure):
    """`struct frame` of native.h."""

    _fields_ = (("cycle", c_uint64), *((name, c_uint32) for name in ("timer", "channel", "data")))


_SIGNATURES: dict[str, tuple[Any, ...]] = {
    "new": (
        c_void_p, c_void_p, ReadCallback, WriteCallback, AlarmCallback, _Refuse, _Judge, _Source, _Exchange,
        _Pulses, _Pin,
    ),
    "free": (None, c_void_p),
    "select": (None, c_void_p),
    "device": (None, c_void_p, *[c_uint32] * 6, c_bool),
    "rule": (None, c_void_p, c_uint32, c_uint32, POINTER(_Rule)),
    "esc": (c_void_p, c_void_p, c_uint32, c_uint32, c_uint32),
    "obeyed": (None, c_void_p, c_uint32, c_uint64, c_void_p),
    "listen": (None, c_void_p, c_bool),
    "watchdog": (c_void_p, c_void_p, c_uint32, c_uint32, c_uint32),
    "frames": (c_uint32, c_void_p, POINTER(POINTER(_Frame))),
    "wake": (None, c_void_p, c_uint32, c_uint32, c_uint64, c_bool),
    "total": (c_uint32, c_void_p, c_uint32),
    "lazy": (None, c_void_p, c_uint32),
    "sync": (None, c_void_p, c_uint32),
    "irq": (None, c_void_p, c_uint32, c_uint32, c_uint32),
    "clock": (None, c_void_p, c_uint32, c_bool),
    "clocks": (None, c_void_p, c_uint64, c_uint64, c_uint64),
    "reset": (None, c_void_p, c_uint32),
    "words": (POINTER(c_uint32), c_void_p, c_uint32),
    "touched": (c_uint64, c_void_p, c_uint32, c_uint32, c_bool),
    "touch_epoch": (None, c_void_p),
    "state": (c_void_p, c_void_p),
    "state_bytes": (c_uint32,),
    "gyro": (None, c_void_p, c_uint32, c_uint32, c_uint64, c_double),
    "gyro_plain": (None, c_void_p, c_bool, c_bool),
    "gyro_state": (c_void_p, c_void_p),
    "drive": (None, c_void_p, c_uint32, c_uint32, c_bool),
    "pulse": (None, c_void_p, c_uint32, c_uint32),
    "level": (c_bool, c_void_p, c_uint32, c_uint32),
    "watch": (None, c_void_p, c_uint32, c_uint32),
    "available": (c_uint32, c_void_p, c_uint32),
    "until_flag": (c_uint32, c_void_p, c_uint32),
    "target": (c_uint32, c_void_p, c_uint32),
    "circular": (c_bool, c_void_p, c_uint32),
    "take": (c_uint32, c_void_p, c_uint32, POINTER(c_uint32), c_uint32),
    "give": (c_uint32, c_void_p, c_uint32, POINTER(c_uint32), c_uint32),
    "set_source": (None, c_void_p, c_uint32, c_uint32, c_uint32, c_int32),
}  # fmt: skip


class BoardEngine(Engine):
    """An engine that tells C whose peripherals it is about to use: its callbacks carry no handle."""

    hot: Hot | None = None

    def run(self, cycle: int = NEVER, instructions: int = NEVER) -> Outcome:
        hot = self.hot
        if hot is None:
            return super().run(cycle, instructions)
        self.library.hot_select(hot.handle)
        try:
            return super().run(cycle, instructions)
        finally:
            if hot.listening:
                hot.drain()

    def load(self, address: int, size: int) -> int:
        self._select()
        return super().load(address, size)

    def store(self, address: int, size: int, value: int) -> None:
        self._select()
        super().store(address, size, value)

    def raise_later(self, error: BaseException) -> None:
        """Raise `error` when the core has come to a stop: nothing unwinds through C."""
        self._note_error(error)

    def raise_now(self) -> None:
        """Raise what `raise_later` was given outside a run."""
        error, self._error = self._error, None
        if error is not None:
            raise error

    def listen_through(self, read: Any, write: Any, alarm: Any, sleep: Any) -> tuple[Any, ...]:  # noqa: ANN401
        """Let C functions answer the core first; returns the callbacks that answered until now."""
        before = self._callbacks
        self._callbacks = (read, write, alarm, before[3], sleep, before)
        self.library.engine_callbacks(self.handle, read, write, alarm, before[3], sleep)
        return before

    def _select(self) -> None:
        if self.hot is not None:
            self.library.hot_select(self.hot.handle)


class Hot:
    """The part in C of one board: made last, when all devices are there."""

    def __init__(
        self, engine: BoardEngine, registers: Registers, dma: HotDmaSystem, pins: HotPins, chip: HotGyroChip
    ) -> None:
        """The devices' registers move into C, with their values of power-up."""
        self.engine, self.library = engine, engine.library
        self._registers, self._dma, self._pins, self._chip = registers, dma, pins, chip
        self._escs: dict[tuple[int, int], HotEsc] = {}
        self.listening = False  # somebody wants to hear of every frame
        self._obeyed = np.zeros(_MOTORS, np.uint16)
        self._obeyed_at = self._obeyed.ctypes.data
        self.clocks = Clocks(16_000_000, 16_000_000, 16_000_000, 16_000_000, 16_000_000)
        for name, (result, *arguments) in _SIGNATURES.items():
            function = getattr(self.library, f"hot_{name}")
            function.restype, function.argtypes = result, arguments
        self._devices = [
            *pins.ports.values(),
            *(registers.devices[name] for name in ("SYSCFG", "EXTI", "DMA1", "DMA2", "SPI1", *TIMER_NAMES)),
        ]
        through = (
            ReadCallback(("hot_read", self.library)),
            WriteCallback(("hot_write", self.library)),
            AlarmCallback(("hot_alarm", self.library)),
            SleepCallback(("hot_sleep", self.library)),
        )
        before = engine.listen_through(*through)
        self._callbacks = (
            _Refuse(self._guarded(self._refuse)),
            _Judge(self._judge),
            _Source(self._guarded(self._source)),
            _Exchange(self._guarded(self._exchange)),
            _Pulses(self._guarded(self._pulses)),
            _Pin(self._guarded(self._pin)),
        )
        self.handle: int = self.library.hot_new(engine.handle, *before[:3], *self._callbacks)
        self._hang_up()
        for number, device in enumerate(self._devices):
            assert isinstance(device, InC)
            device.adopt(self, number)
        self.library.hot_lazy(self.handle, dma.id("ADC1"))  # USARTs move by alarms alone
        dma.adopt(self)
        pins.adopt(self)
        chip.adopt(self)
        watchdog = registers.devices["IWDG"]
        assert isinstance(watchdog, HotIwdg)
        name = registers.window_name(watchdog)
        watchdog.adopt(self, engine.windows[name], watchdog.block.base % WINDOW)
        engine.hot = self

    def __del__(self) -> None:
        if getattr(self, "handle", 0):
            self.library.hot_free(self.handle)
            self.handle = 0

    def set_clock(self, clocks: Clocks) -> None:
        """The clock tree has changed."""
        self.clocks = clocks
        self.library.hot_clocks(self.handle, clocks.apb2, clocks.timer1, clocks.timer2)

    def wire(self, timer: str, channel: int, esc: HotEsc) -> None:
        """`esc` is on the line of a timer's channel: C takes the frames that are as they should be."""
        number = TIMER_NAMES.index(timer)
        self._escs[number, channel] = esc
        esc.adopt(self.library.hot_esc(self.handle, esc.motor - 1, number, channel), self.listen)

    def listen(self) -> None:
        """From now on every frame is told to its ESC's `on_frame`."""
        self.listening = True
        self.library.hot_listen(self.handle, True)

    def obeyed(self, count: int) -> NDArray[np.uint16]:
        """What the ESCs of the first `count` motors obey now."""
        self.library.hot_obeyed(self.handle, count, _SILENT, self._obeyed_at)
        return self._obeyed[:count].copy()

    def drain(self) -> None:
        """Tell of the frames that C has taken."""
        frames = POINTER(_Frame)()
        count = self.library.hot_frames(self.handle, ctypes.byref(frames))
        for i in range(count):
            found = frames[i]
            esc = self._escs[found.timer, found.channel]
            assert esc.protocol is not None
            data = found.data
            esc.on_frame(Frame(esc.motor, found.cycle, data >> 1, bool(data & 1), esc.protocol))

    def state(self) -> Any:  # noqa: ANN401
        """All of C's state."""
        data = ctypes.string_at(self.library.hot_state(self.handle), self.library.hot_state_bytes())
        return (data, self.clocks)

    def restore(self, state: Any) -> None:  # noqa: ANN401
        data, self.clocks = state
        ctypes.memmove(self.library.hot_state(self.handle), data, len(data))

    def _hang_up(self) -> None:
        """Tell C where its devices are, their rules, interrupts and alarms."""
        library, handle = self.library, self.handle
        counted: dict[int, int] = {}
        for number, device in enumerate(self._devices):
            kind = _kind(device)
            window = self.engine.windows[self._registers.window_name(device)]
            alarm = {"SPI1": "spi1.byte"}.get(device.name, f"{device.name.lower()}.update")
            alarms = self.engine.alarms
            library.hot_device(
                handle, number, kind, counted.get(kind, 0), window, device.block.base,
                alarms[alarm].number if alarm in alarms else 0xFFFFFFFF, device.name in ("TIM1", "TIM8"),
            )  # fmt: skip
            counted[kind] = counted.get(kind, 0) + 1
            for register in device.block.registers.values():
                if register.modelled:
                    rule = _Rule(
                        register.reset, register.reserved | register.unmodelled, register.writable, 1,
                        sum(register.sizes), "r" in register.access, "w" in register.access,
                    )  # fmt: skip
                    library.hot_rule(handle, number, register.offset >> 2, ctypes.byref(rule))
            for place, irq in enumerate(device.interrupts):
                library.hot_irq(handle, number, place, irq)

    def _guarded(self, function: Callable[..., None]) -> Callable[..., None]:
        """`function` as C may call it."""

        def call(*arguments: Any) -> None:  # noqa: ANN401
            try:
                function(*arguments)
            except BaseException as error:
                self.engine.raise_later(error)

        return call

    # What C asks

    def _refuse(self, window: int, offset: int, size: int, value: int, write: int) -> None:
        device = next(
            d for d in self._devices if self.engine.windows[self._registers.window_name(d)] == window
        )
        self._registers.explain(device, offset, size, value if write else None)

    def _judge(self, question: int, a: int, b: int, c: int) -> int:
        try:
            if question in (ASK_OUTPUT, ASK_TARGET, ASK_COMPARE, ASK_DMAR):
                self._judge_timer(question, a, b)
            elif question in (ASK_SPI, ASK_SPI_BUSY, ASK_SPI_FULL):
                self._judge_spi(question)
            else:
                self._judge_stream(question, a, b, c)
        except BaseException as error:
            self.engine.raise_later(error)
            return 1
        return 0

    def _judge_stream(self, question: int, controller: int, stream: int, c: int) -> None:
        dma = self._dma.controllers[controller + 1]
        if question == ASK_ENABLE:
            for place, source in enumerate(dma.judge(stream)):
                self.library.hot_set_source(self.handle, controller, stream, place, self._dma.id(source))
        elif question == ASK_CHANGED:
            dma.refuse_changed(stream, c)
        elif question == ASK_FROZEN:
            dma.refuse_frozen(stream, _STREAM_WORDS[(c - 4) % 6])
        elif question == ASK_TWICE:
            dma.refuse_twice(stream, self._dma.name(c), "another stream")
        elif question == ASK_ASLEEP:
            dma.refuse_asleep(stream)
        else:
            dma.refuse_cached(stream, c)

    def _judge_spi(self, question: int) -> None:
        spi = self._registers.devices["SPI1"]
        assert isinstance(spi, Spi)
        {ASK_SPI: spi.judge, ASK_SPI_BUSY: spi.refuse_busy, ASK_SPI_FULL: spi.refuse_full}[question]()

    def _judge_timer(self, question: int, number: int, b: int) -> None:
        timer = self._registers.devices[TIMER_NAMES[number]]
        assert isinstance(timer, Timer)
        names = ("UP", *(f"CH{i}" for i in range(1, CHANNELS + 1)))
        if question == ASK_OUTPUT:
            timer.judge_output(b)
        elif question == ASK_TARGET:
            timer.targets(f"{timer.name}_{names[b]}")
        elif question == ASK_COMPARE:
            timer.refuse_compare(f"CC{b}DE")
        elif b:
            timer.write_dmar(0)
        else:
            timer.read_dmar()

    def _source(self, source: int, sync: int) -> None:
        if source == _DRAIN:
            self.drain()
            return
        driver = self._dma.driver(self._dma.name(source))
        if sync:
            driver.sync()
        else:
            driver.dma_changed()

    def _exchange(self, data: Any, count: int, transaction: int, hz: float, mode: int) -> None:  # noqa: ANN401
        if transaction != self._chip.transaction:
            self._chip.transaction = transaction
            self._chip.select(False)
        spi = self._registers.devices["SPI1"]
        assert isinstance(spi, HotSpi)
        answer = spi.answer(data[:count], hz, mode)
        ctypes.memmove(data, bytes(answer), count)

    def _pulses(
        self,
        timer: int,
        channel: int,
        start: int,
        length: int,
        count: int,
        highs: Any,  # noqa: ANN401
    ) -> None:
        device = self._registers.devices[TIMER_NAMES[timer]]
        assert isinstance(device, Timer)
        output = device.outputs.get(channel)
        if output is not None:
            self.drain()
            output(start, length, highs[:count])

    def _pin(self, port: int, pin: int, level: int) -> None:
        self._pins.ports[PORTS[port]].listeners[pin](bool(level))


def _kind(device: Device) -> int:
    kinds = ((Port, PORT), (Syscfg, SYSCFG), (Exti, EXTI), (Dma, DMA), (Spi, SPI), (Timer, TIMER))
    return next(kind for type_, kind in kinds if isinstance(device, type_))
