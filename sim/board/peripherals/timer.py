"""TIM1 to TIM5 and TIM8: counters with preload, compare outputs and DMA at their beat.

A free-running timer costs nothing: its updates are counted when somebody looks. While DMA feeds compare
registers, an alarm marks the end of the transfer; what the pins did meanwhile goes to `outputs` as the list
of pulses of each channel, period by period.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NoReturn

from sim.board.core.context import TIME_HZ, Context
from sim.board.peripherals.dma import DmaSystem
from sim.board.peripherals.gpio import SIGNALS, Pins
from sim.board.peripherals.rcc import Clocks
from sim.board.registers.bus import Device, load_table

ADVANCED = ("TIM1", "TIM8")  # with a main output switch; on APB2
CHANNELS = 4
_UPDATE_IRQ = {"TIM1": "TIM1_UP_TIM10", "TIM8": "TIM8_UP_TIM13"}
_PWM_1 = 6  # OCxM: high while the counter is below the compare value
_CCR1 = 13  # DCR counts words from CR1
_STEADY_PERIODS = 20  # of a pulse train that nobody ends, shown to the pin's listener

# Called with the cycle at which the first period began, its length and the high time of each [cycles].
Output = Callable[[int, int, Sequence[int]], None]


class Timer(Device):
    """One timer, counting up."""

    kept = ("_ccr", "_arr", "_psc", "_anchor", "_stopped_at", "_pending", "_clock", "_steady")

    def __init__(self, context: Context, name: str, dma: DmaSystem, pins: Pins) -> None:
        super().__init__(context, name)
        self._dma, self._pins = dma, pins
        self._irq = load_table().interrupt(_UPDATE_IRQ.get(name, name))
        self._alarm = context.alarm(f"{name.lower()}.update", self._wake)
        self.outputs: dict[int, Output] = {}  # by channel 1..4
        self._clock = TIME_HZ // 1  # [Hz], told by `set_clock`
        self._begin()
        self._sources = {"UDE": f"{name}_UP", **{f"CC{i}DE": f"{name}_CH{i}" for i in range(1, CHANNELS + 1)}}
        for source in self._sources.values():
            dma.connect(source, self)
        for i in range(1, CHANNELS + 1):
            setattr(self, f"read_ccr{i}", lambda i=i: self._read_ccr(i))
            setattr(self, f"write_ccr{i}", lambda value, i=i: self._write_ccr(i, value))

    def _begin(self) -> None:
        self._ccr = [0] * CHANNELS  # in effect; the registers hold what comes next
        self._arr = self.words["ARR"]
        self._psc = self.words["PSC"]
        self._anchor = 0  # cycle at which the counter was 0 last, while it counts
        self._stopped_at = 0  # the counter while it stands
        self._pending: list[str] = []  # DMA requests that no stream has served yet
        self._steady = False  # the pulses in effect have been shown

    @property
    def interrupts(self) -> tuple[int, ...]:
        return (self._irq,)

    def reset(self) -> None:
        super().reset()
        self._begin()
        self._alarm.cancel()
        self.context.irq(self._irq, False)

    def set_clock(self, clocks: Clocks) -> None:
        """The clock tree has changed."""
        self.sync()
        counter = self._count()
        self._clock = clocks.timer2 if self.name in ADVANCED else clocks.timer1
        self._anchor = self.context.cycle - self._cycles(counter)
        self._plan()

    @property
    def period(self) -> int:
        """Cycles from update to update."""
        return self._cycles(self._arr + 1)

    def sync(self) -> None:
        """Bring counter, pulses and DMA up to now."""
        if not self.words["CR1"] & 1 or self.words["CR1"] & 2:  # CEN, UDIS
            return
        updates = (self.context.cycle - self._anchor) // self.period
        while updates > 0:
            if self.get("CR1", "OPM"):
                updates = 1
            length = self.period  # of the periods that end now
            done = self._run(updates)
            self._anchor += done * length
            if self.get("CR1", "OPM"):
                self.put("CR1", "CEN", 0)
                self._stopped_at = 0
                break
            updates = (self.context.cycle - self._anchor) // self.period  # ARR or PSC may be others now

    def dma_changed(self) -> None:
        self.sync()
        for source in list(self._pending):
            if self._dma.available(source):
                self._pending.remove(source)
                self._feed(source, 1)
        self._plan()

    # What the image reads and writes

    def read_cnt(self) -> int:
        self.sync()
        return self._count()

    def read_sr(self) -> int:
        self.sync()
        if self.words["CR1"] & 1:
            for i, compare in enumerate(self._ccr):
                if compare and self._count() >= compare:
                    self.put("SR", f"CC{i + 1}IF", 1)
        return self.words["SR"]

    def write_sr(self, value: int) -> None:
        self.read_sr()
        self.words["SR"] &= value
        self._update_irq()

    def write_cr1(self, value: int) -> None:
        self.sync()
        counter = self._count()
        changed = self.keep("CR1", value)
        if changed & self.mask("CR1", "CEN"):
            if self.get("CR1", "CEN"):
                self._anchor = self.context.cycle - self._cycles(counter)
                self._steady = False
            else:
                self._stopped_at = counter
        self._plan()

    def write_dier(self, value: int) -> None:
        self.sync()
        self.keep("DIER", value)
        self._pending = [s for field, s in self._sources.items() if s in self._pending and self._asks(field)]
        self._update_irq()
        self._plan()

    def write_egr(self, value: int) -> None:
        self.sync()
        if value & self.mask("EGR", "UG"):
            self._anchor, self._stopped_at = self.context.cycle, 0
            self._load()
            if not self.get("CR1", "URS"):
                self.put("SR", "UIF", 1)
                self._request_all()
                self._update_irq()
        for i in range(1, CHANNELS + 1):
            if value & self.mask("EGR", f"CC{i}G"):
                self.put("SR", f"CC{i}IF", 1)
        self._plan()

    def write_cnt(self, value: int) -> None:
        self.sync()
        self._stopped_at = value
        self._anchor = self.context.cycle - self._cycles(value)
        self._plan()

    def write_arr(self, value: int) -> None:
        self.sync()
        self.keep("ARR", value)
        if not self.get("CR1", "ARPE"):
            self._arr = value
        self._plan()

    def read_cr1(self) -> int:
        self.sync()  # in one-pulse mode the counter stops by itself
        return self.words["CR1"]

    def write_psc(self, value: int) -> None:
        self.sync()
        self.keep("PSC", value)
        self._plan()

    def write_dcr(self, value: int) -> None:
        self.sync()
        self.keep("DCR", value)
        self._plan()

    def write_cr2(self, value: int) -> None:
        self.sync()
        self.keep("CR2", value)
        self._plan()

    def write_ccmr1(self, value: int) -> None:
        self.sync()
        self.keep("CCMR1", value)

    def write_ccmr2(self, value: int) -> None:
        self.sync()
        self.keep("CCMR2", value)

    def write_ccer(self, value: int) -> None:
        self.sync()
        self.keep("CCER", value)
        self._steady = False

    def write_bdtr(self, value: int) -> None:
        self.sync()
        self.keep("BDTR", value)
        self._steady = False

    def refuse_compare(self, field: str) -> NoReturn:
        """A channel's request without CCDS."""
        self.context.fail(
            f"{self.name}_DIER {field} with CR2 CCDS 0: requests at compare are not modelled, expected CCDS 1"
        )

    def read_dmar(self) -> int:
        self.context.fail(f"{self.name}_DMAR is read, expected DMA to write it")

    def write_dmar(self, value: int) -> None:
        self.context.fail(f"{self.name}_DMAR is written by the program, expected by DMA")

    def _read_ccr(self, channel: int) -> int:
        self.sync()
        return self.words[f"CCR{channel}"]

    def _write_ccr(self, channel: int, value: int) -> None:
        self.sync()
        self.keep(f"CCR{channel}", value)
        if not self._preloaded(channel):
            self._ccr[channel - 1] = value
        self._steady = False
        self._plan()

    # Time

    def _cycles(self, counts: int) -> int:
        return counts * (self._psc + 1) * TIME_HZ // self._clock

    def _count(self) -> int:
        if not self.words["CR1"] & 1:
            return self._stopped_at
        passed = self.context.cycle - self._anchor
        return min(passed * self._clock // (TIME_HZ * (self._psc + 1)), self._arr)

    def _plan(self) -> None:
        """Set the alarm for the next update that somebody waits for."""
        self._alarm.cancel()
        if not self.words["CR1"] & 1 or self.words["CR1"] & 2:
            return
        waits = []
        if self.words["DIER"] & 1:  # UIE
            waits.append(1)
        for field, source in self._sources.items():
            if self._asks(field) and self._dma.available(source):
                waits.append(-(-self._dma.available(source) // self._items(source)))
        if waits:
            self._alarm.set(self._anchor + min(waits) * self.period)

    def _wake(self) -> None:
        self.sync()
        self._plan()

    # Updates

    def _run(self, updates: int) -> int:
        """Go through `updates` updates or fewer; returns how many."""
        sources = [s for field, s in self._sources.items() if self._asks(field)]
        fed = [s for s in sources if self._dma.available(s)]
        self.put("SR", "UIF", 1)
        if len(fed) == 1 and self.words["ARR"] == self._arr and self.words["PSC"] == self._psc:
            count = min(updates, -(-self._dma.available(fed[0]) // self._items(fed[0])))
            self._pulses_fed(fed[0], count)
        else:
            count = 1
            self._pulses([[c] for c in self._ccr], 0)
            length = self.period
            self._load()
            if not fed and self.period == length:
                count = self._free_run(updates)
            for source in fed:
                self._feed(source, 1)
        for source in sources:
            if source not in fed and source not in self._pending:
                self._pending.append(source)
        self._update_irq()
        return count

    def _free_run(self, updates: int) -> int:
        """Nothing changes from update to update; an endless pulse train is shown for a while."""
        if any(self._ccr) and not self._steady:
            shown = min(updates - 1, _STEADY_PERIODS)
            self._pulses([[c] * shown for c in self._ccr], 1)
            self._steady = shown == _STEADY_PERIODS
            return 1 + shown
        return updates

    def _pulses_fed(self, source: str, updates: int) -> None:
        """`updates` updates, at each of which a period ends and DMA writes the compare values of the next."""
        lists: list[list[int]] = [[] for _ in range(CHANNELS)]
        registers = self.targets(source)
        step = len(registers)
        count = min(updates * step, self._dma.available(source))
        items = self._dma.take(source, count)
        for update in range(updates):
            for i in range(CHANNELS):
                lists[i].append(self._ccr[i])
            self._load()
            for register, item in zip(registers, items[update * step : (update + 1) * step], strict=False):
                self._store(register, item)
        self._steady = False
        self._pulses(lists, 0)

    def _feed(self, source: str, requests: int) -> None:
        registers = self.targets(source)
        count = min(requests * len(registers), self._dma.available(source))
        for register, item in zip(registers * requests, self._dma.take(source, count), strict=False):
            self._store(register, item)
        self._steady = False

    def _store(self, register: str, value: int) -> None:
        self.keep(register, value)
        if register.startswith("CCR") and not self._preloaded(int(register[3])):
            self._ccr[int(register[3]) - 1] = value

    def _load(self) -> None:
        """An update: what was preloaded takes effect."""
        self._arr, self._psc = self.words["ARR"], self.words["PSC"]
        for i in range(CHANNELS):
            self._ccr[i] = self.words[f"CCR{i + 1}"]

    def _pulses(self, compares: list[list[int]], first: int) -> None:
        """The periods that began with update `first` after the anchor had these compare values."""
        start, length = self._anchor + first * self.period, self.period
        for i, values in enumerate(compares):
            channel = i + 1
            if not values or not self.words["CCER"] >> 4 * i & 1:
                continue
            if any(values):
                self.judge_output(channel)
            output = self.outputs.get(channel)
            if output is not None:
                output(start, length, [self._cycles(v) for v in values])

    def judge_output(self, channel: int) -> None:
        """Fail unless channel 1..4 may make pulses."""
        register = "CCMR1" if channel < 3 else "CCMR2"
        mode = self.get(register, f"OC{channel}M")
        signal = f"{self.name}_CH{channel}"
        if self.name in ADVANCED and not self.get("BDTR", "MOE"):
            self.context.fail(f"{signal} makes pulses while {self.name}_BDTR MOE is 0, expected 1")
        if mode != _PWM_1:
            self.context.fail(f"{signal} is driven with OC{channel}M {mode}, expected 6: PWM mode 1")
        if signal not in SIGNALS:
            self.context.fail(f"{signal} makes pulses, but the board leads it to no pin")
        self._pins.expect(signal, f"{self.name} makes pulses on channel {channel}")

    def _preloaded(self, channel: int) -> int:
        return self.get("CCMR1" if channel < 3 else "CCMR2", f"OC{channel}PE")

    # Requests

    def _asks(self, field: str) -> bool:
        """Is the request of DIER's `field` made at each update?"""
        if not self.get("DIER", field):
            return False
        if field != "UDE" and not self.get("CR2", "CCDS"):
            self.refuse_compare(field)
        return True

    def _request_all(self) -> None:
        for field, source in self._sources.items():
            if self._asks(field):
                if self._dma.available(source):
                    self._feed(source, 1)
                elif source not in self._pending:
                    self._pending.append(source)

    def _items(self, source: str) -> int:
        return len(self.targets(source))

    def targets(self, source: str) -> list[str]:
        """What one request writes: a register, or a burst of them through DMAR."""
        offset = self._dma.target(source) - self.block.base
        names = {r.offset: r.name for r in self.block.registers.values()}
        name = names.get(offset)
        if name != "DMAR":
            if name is None or not name.startswith(("CCR", "ARR", "PSC")):
                self.context.fail(f"{source} feeds {name or 'pins'}, expected a CCR, ARR, PSC or DMAR")
            return [name]
        first, count = self.get("DCR", "DBA"), self.get("DCR", "DBL") + 1
        burst = [names.get(4 * (first + i), "?") for i in range(count)]
        if any(not n.startswith(("CCR", "ARR", "PSC")) for n in burst):
            self.context.fail(
                f"{self.name}_DCR bursts into {', '.join(burst)}, expected ARR, PSC or CCR1 ({_CCR1}) and on"
            )
        return burst

    def _update_irq(self) -> None:
        self.context.irq(self._irq, bool(self.words["SR"] & self.words["DIER"] & 1))
