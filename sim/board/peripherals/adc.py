"""ADC1: conversions of a regular sequence, each with its sampling time, of voltages that the loop sets."""

from __future__ import annotations

from neuroflight.sim.board.core.context import TIME_HZ
from neuroflight.sim.board.core.engine import Engine
from neuroflight.sim.board.peripherals.dma import DmaSystem
from neuroflight.sim.board.peripherals.gpio import Pins
from neuroflight.sim.board.peripherals.rcc import MICROSECOND, Clocks
from neuroflight.sim.board.peripherals.signals import CONVERTED
from neuroflight.sim.board.registers.bus import Device, load_table
from neuroflight.toolchain.boards.facts import Board

REFERENCE_V = 3.3
CLOCK_MAX_HZ = 36_000_000  # data sheet, ADC characteristics
STABILIZATION = 3 * MICROSECOND  # from ADON to the first conversion
_SAMPLING = (3, 15, 28, 56, 84, 112, 144, 480)  # SMP [converter's cycles]
_BITS = (12, 10, 8, 6)  # CR1 RES; as many cycles to convert
_TIMING = ("SQR1", "SQR2", "SQR3", "SMPR1", "SMPR2", "CR1")  # what a sequence's times depend on
_EOC, _STRT, _OVR = 1 << 1, 1 << 4, 1 << 5


class AdcCommon(Device):
    """The registers that the chip's converters share."""

    def __init__(self, engine: Engine) -> None:
        super().__init__(engine, "ADC_Common")

    @property
    def divider(self) -> int:
        """Divider of APB2's clock."""
        return 2 * self.get("CCR", "ADCPRE") + 2


class Adc(Device):
    """ADC1, started by software, once or continuously."""

    kept = ("words", "_pins_v", "_on_at", "_running", "_next", "_at", "_apb2", "_stalled", "_same")

    def __init__(self, engine: Engine, common: AdcCommon, dma: DmaSystem, pins: Pins, board: Board) -> None:
        super().__init__(engine, "ADC1")
        self._common, self._pins, self._board = common, pins, board
        self._irq = load_table().interrupt("ADC")
        self._alarm = engine.alarm("adc1.end", self.sync)
        self._pins_v: dict[int, float] = {}  # by channel
        self._apb2 = TIME_HZ // 2
        # The sequence and its times, for registers and clocks of these values.
        self._order: tuple[tuple[int, ...], list[int], list[int]] = ((), [], [])
        self._begin()
        self._dma = dma.connect("ADC1", self, lazy=True)

    def _begin(self) -> None:
        self._on_at = 0
        self._running = False
        self._stalled = False  # DMA asked for no more, or came too late
        self._at = 0  # cycle at which the conversion under way began
        self._next = 0  # place of that conversion in the sequence
        self._same = 0  # conversions to memory since anything changed

    def reset(self) -> None:
        super().reset()
        self._begin()
        self._alarm.cancel()
        self.engine.irq(self._irq, False)

    def set_clock(self, clocks: Clocks) -> None:
        """Take over a changed clock tree."""
        self.sync()
        self._apb2 = clocks.apb2
        self._plan()

    # For the loop

    def set_battery(self, volts: float, amps: float) -> None:
        """Set the battery from now on, as measured by conversions that end later."""
        board = self._board
        if board.volts is not None:
            self.set_pin(CONVERTED[str(board.volts)], volts / (board.volts_scale / 10))
        if board.amps is not None:
            self.set_pin(CONVERTED[str(board.amps)], amps * board.amps_scale / 10_000)

    def set_pin(self, channel: int, volts: float) -> None:
        if self._pins_v.get(channel) != volts:
            self.sync()
            self._pins_v[channel] = volts
            self._changed()

    # What the image reads and writes

    def read_sr(self) -> int:
        self.sync()
        return self.words["SR"]

    def write_sr(self, value: int) -> None:
        self.sync()
        self.words["SR"] &= value
        if not self.words["SR"] & _OVR:
            self._stalled = False
        self._update_irq()

    def read_dr(self) -> int:
        self.sync()
        self.words["SR"] &= ~_EOC
        self._update_irq()
        return self.words["DR"]

    def write_cr1(self, value: int) -> None:
        self.sync()
        self.keep("CR1", value)
        self._changed()

    def write_cr2(self, value: int) -> None:
        self.sync()
        start = value & self.mask("CR2", "SWSTART")
        changed = self.keep("CR2", value & ~self.mask("CR2", "SWSTART"))
        if changed & self.mask("CR2", "ADON"):
            self._on_at = self.engine.cycle
            self._running = False
        if changed & self.mask("CR2", "DMA"):
            self._stalled = False
        if not self.get("CR2", "CONT") and changed & self.mask("CR2", "CONT"):
            self._running = self._running and self._next != 0
        if start:
            self._start()
        self._changed()

    def _start(self) -> None:
        fail, now = self.engine.fail, self.engine.cycle
        if not self.get("CR2", "ADON"):
            fail("ADC1 is started while it is off, expected CR2 ADON 1 for 3 us before SWSTART")
        if now - self._on_at < STABILIZATION:
            waited = (now - self._on_at) / MICROSECOND
            fail(f"ADC1 is started {waited:.2f} us after CR2 ADON, expected 3 us")
        clock = self._apb2 / self._common.divider
        if clock > CLOCK_MAX_HZ:
            fail(f"ADC1 is clocked at {clock / 1e6:g} MHz, expected {CLOCK_MAX_HZ / 1e6:g} MHz at most")
        if self._running:
            fail("ADC1 is started while a conversion is under way")
        for channel in set(self._sequence()):
            self._pins.expect(f"ADC1_IN{channel}", f"ADC1 converts channel {channel}")
        if not self.get("CR1", "SCAN") and self.get("SQR1", "L"):
            fail(f"ADC1 has a sequence of {self.get('SQR1', 'L') + 1} with CR1 SCAN 0, expected SCAN 1")
        self.words["SR"] |= _STRT
        self._running, self._at, self._next = True, now, 0

    # Conversions

    def _sequence(self) -> list[int]:
        rows = (("SQR3", 6), ("SQR2", 6), ("SQR1", 4))
        places = [self.words[name] >> 5 * i & 31 for name, count in rows for i in range(count)]
        return places[: self.get("SQR1", "L") + 1]

    def _times(self) -> list[int]:
        """Return the cycles of each conversion of a sequence."""
        words = self.words
        key = (*(words[name] for name in _TIMING), self._common.divider, self._apb2)
        if key != self._order[0]:
            sequence, self._same = self._sequence(), 0
            self._order = (key, sequence, [self._cycles(channel) for channel in sequence])
        return self._order[2]

    def _cycles(self, channel: int) -> int:
        register, place = ("SMPR1", channel - 10) if channel >= 10 else ("SMPR2", channel)
        sampling = _SAMPLING[self.words[register] >> 3 * place & 7]
        cycles = sampling + _BITS[self.get("CR1", "RES")]
        return cycles * self._common.divider * TIME_HZ // self._apb2

    def _code(self, channel: int) -> int:
        full = (1 << _BITS[self.get("CR1", "RES")]) - 1
        return max(0, min(full, round(self._pins_v.get(channel, 0.0) / REFERENCE_V * full)))

    def sync(self) -> None:
        """Do the conversions that have ended by now."""
        if not self._running:
            return
        times, now = self._times(), self.engine.cycle
        left = now - self._at
        if left < times[self._next]:
            return
        codes = [self._code(channel) for channel in self._order[1]]
        ended: list[int] = []
        endless, whole = self.get("CR2", "CONT"), sum(times)
        while left >= times[self._next]:
            if self._next == 0 and endless and left >= whole:
                ended += codes * (left // whole)
                left %= whole
                continue
            left -= times[self._next]
            ended.append(codes[self._next])
            self._next += 1
            if self._next == len(times):
                self._next = 0
                if not endless:
                    self._running = False
                    break
        self._at = now - left
        if ended:
            self._deliver(ended)
            self._same += len(ended)
            self._plan()

    def dma_changed(self) -> None:
        self.sync()
        self._changed()

    def _changed(self) -> None:
        self._same = 0
        self._plan()

    def _deliver(self, codes: list[int]) -> None:
        self.words["DR"] = codes[-1]
        if not self.get("CR2", "DMA"):
            self.words["SR"] |= _EOC
        elif not self._stalled:
            available = self._dma.available
            endless = available and self._dma.circular and self.get("CR2", "DDS")
            if endless and self._writes_the_same(len(self._order[2])):
                # Whole rounds of the buffer change nothing once it has gone round.
                total = self._dma.total
                codes = codes[-(total + len(codes) % total) :]
            taken = len(codes) if endless else min(available, len(codes))
            if taken:
                self._dma.give(codes[:taken])
            if taken < len(codes):
                self.words["SR"] |= _OVR
            # The last transfer, or one that came too late: no more requests until the image says so.
            self._stalled = taken < len(codes) or (taken == available and not self.get("CR2", "DDS"))
        self._update_irq()

    def _plan(self) -> None:
        by_dma = self.get("CR2", "DMA")
        # Conversions until something shows.
        wanted = self._dma.until_flag * (not self._stalled) if by_dma else self.get("CR1", "EOCIE")
        if not wanted or not self._running:
            self._alarm.cancel()
            self._dma.wake(self._alarm, None)
            return
        times = self._times()
        rounds, rest = divmod(wanted, len(times))
        cycles = rounds * sum(times) + sum(times[(self._next + i) % len(times)] for i in range(rest))
        if by_dma and not self.get("CR1", "OVRIE"):
            self._dma.wake(self._alarm, self._at + cycles, quiet=self._writes_the_same(len(times)))
        else:
            self._dma.wake(self._alarm, None)
            self._alarm.set(self._at + cycles)

    def _writes_the_same(self, places: int) -> bool:
        """Return True if every further conversion writes the value that its place in memory holds already."""
        total = self._dma.total
        endless = self._dma.circular and self.get("CR2", "DDS")
        return bool(endless and self._same >= total + places and total % places == 0)

    def _update_irq(self) -> None:
        status = self.words["SR"]
        ended = status & _EOC and self.get("CR1", "EOCIE")
        self.engine.irq(self._irq, bool(ended or (status & _OVR and self.get("CR1", "OVRIE"))))
