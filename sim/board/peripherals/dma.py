"""DMA1 and DMA2: streams between memory and the peripherals that ask for them.

Peripherals know the time and move many items at once: a driver says with `take` and `give` what it has moved
up to now, and is asked to `sync` before the program looks. So a transfer costs one event and still shows the
right count at every cycle. A stream is judged when it is enabled: the request behind its channel, its
addresses, and whether the data cache would hide what it writes.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import NoReturn, Protocol

from sim.board.core.context import Alarm, Context
from sim.board.peripherals.dma_requests import REQUESTS, serves
from sim.board.registers.bus import Device, load_table
from toolchain.contract import DTCM, FLASH_BASE, FLASH_BYTES, SRAM1, SRAM2

STREAMS = 8
_TO_PERIPHERAL = 1  # DIR; 0 from peripheral, 2 memory to memory
_FLAGS = ("FEIF", "DMEIF", "TEIF", "HTIF", "TCIF")
_SHIFTS = (0, 6, 16, 22)  # of the flags of streams 0 to 3 in LISR, 4 to 7 in HISR (RM0431 8.5.1)
_DME, _TE, _HT, _TC = 1 << 2, 1 << 3, 1 << 4, 1 << 5
_ALL_FLAGS = 0x3D
_EN = 1 << 0
_APB1_END = 0x40008000  # DMA1's peripheral port reaches APB1 only (RM0431 2.1, bus matrix)
_FORMATS = {1: "B", 2: "H", 4: "I"}


class Driver(Protocol):
    """A peripheral that moves data by DMA."""

    def sync(self) -> None:
        """Move what has been moved up to now."""
        ...

    def dma_changed(self) -> None:
        """A stream for one of its requests was enabled or disabled."""
        ...


class Dma(Device):
    """One controller."""

    kept = ("_totals", "_moved", "_sources")

    def __init__(self, context: Context, number: int, system: DmaSystem) -> None:
        super().__init__(context, f"DMA{number}")
        self.number = number
        self._system = system
        interrupt = load_table().interrupt
        self._irqs = [interrupt(f"DMA{number}_STREAM{i}") for i in range(STREAMS)]
        self._totals = [0] * STREAMS  # items of the transfer under way
        self._moved = [0] * STREAMS  # of them
        self._sources: list[tuple[str, ...]] = [()] * STREAMS  # requests that drive each enabled stream
        for i in range(STREAMS):
            setattr(self, f"write_s{i}cr", lambda value, i=i: self._write_cr(i, value))
            setattr(self, f"read_s{i}cr", lambda i=i: self._synced(f"S{i}CR"))
            setattr(self, f"read_s{i}ndtr", lambda i=i: self._synced(f"S{i}NDTR"))
            for name in ("NDTR", "PAR", "M0AR", "FCR"):
                setattr(
                    self, f"write_s{i}{name.lower()}", lambda value, i=i, name=name: self._set(i, name, value)
                )

    def restore(self, state: object) -> None:
        super().restore(state)
        self._system.relink()

    @property
    def interrupts(self) -> tuple[int, ...]:
        return tuple(self._irqs)

    def reset(self) -> None:
        super().reset()
        self._totals, self._moved = [0] * STREAMS, [0] * STREAMS
        self._sources = [()] * STREAMS
        self._system.forget(self.number)
        for irq in self._irqs:
            self.context.irq(irq, False)

    def read_lisr(self) -> int:
        return self._synced("LISR")

    def read_hisr(self) -> int:
        return self._synced("HISR")

    def write_lifcr(self, value: int) -> None:
        self._clear("LISR", value)

    def write_hifcr(self, value: int) -> None:
        self._clear("HISR", value)

    def available(self, stream: int) -> int:
        """Items that the stream moves before it ends or begins anew."""
        return self._totals[stream] - self._moved[stream]

    def total(self, stream: int) -> int:
        """Items of the transfer under way."""
        return self._totals[stream]

    @property
    def sources(self) -> list[tuple[str, ...]]:
        """The requests that drive each enabled stream."""
        return self._sources

    def until_flag(self, stream: int) -> int:
        """Items until the stream is half through or at its end."""
        total, moved = self._totals[stream], self._moved[stream]
        half = total - total // 2
        return (half if moved < half else total) - moved

    def target(self, stream: int) -> int:
        """The peripheral address."""
        return self.words[f"S{stream}PAR"]

    def take(self, stream: int, count: int) -> list[int]:
        """The next `count` items for the peripheral."""
        items: list[int] = []
        while count:
            part = min(count, self.available(stream))
            address, size = self._place(stream)
            step = size if self._increments(stream) else 0
            if step:
                data = self.context.memory(address + self._moved[stream] * step, part * size)
                items += struct.unpack(f"<{part}{_FORMATS[size]}", data)
            else:
                items += [int.from_bytes(self.context.memory(address, size), "little")] * part
            self._advance(stream, part)
            count -= part
        return items

    def give(self, stream: int, items: Sequence[int]) -> None:
        """The peripheral's next items go to memory."""
        done = 0
        while done < len(items):
            part = min(len(items) - done, self.available(stream))
            address, size = self._place(stream)
            some = [item & (1 << 8 * size) - 1 for item in items[done : done + part]]
            if self._increments(stream):
                data = struct.pack(f"<{part}{_FORMATS[size]}", *some)
                self.context.set_memory(address + self._moved[stream] * size, data)
            else:
                self.context.set_memory(address, some[-1].to_bytes(size, "little"))
            self._advance(stream, part)
            done += part

    def _place(self, stream: int) -> tuple[int, int]:
        """Address and item size; the data cache may have been switched on since the stream was enabled."""
        address, size = self.words[f"S{stream}M0AR"], 1 << self.get(f"S{stream}CR", "PSIZE")
        self.refuse_cached(stream, address)
        return address, size

    def _increments(self, stream: int) -> int:
        return self.get(f"S{stream}CR", "MINC")

    def _advance(self, stream: int, count: int) -> None:
        total = self._totals[stream]
        before = self._moved[stream]
        after = before + count
        flags = 0
        if before < total - total // 2 <= after:
            flags |= _HT
        if after == total:
            flags |= _TC
            if self.get(f"S{stream}CR", "CIRC"):
                after = 0
            else:
                self.words[f"S{stream}CR"] &= ~_EN
                self._end(stream)
        self._moved[stream] = after
        self.words[f"S{stream}NDTR"] = total - after
        if flags:
            self._raise(stream, flags)

    def _end(self, stream: int) -> None:
        self._system.unlink(self._sources[stream])
        self._sources[stream] = ()

    def _raise(self, stream: int, flags: int) -> None:
        register = "LISR" if stream < 4 else "HISR"
        self.words[register] |= flags << _SHIFTS[stream % 4]
        self._update_irq(stream)

    def _clear(self, register: str, value: int) -> None:
        self.sync()
        self.words[register] &= ~value
        for stream in range(4) if register == "LISR" else range(4, 8):
            if value >> _SHIFTS[stream % 4] & _ALL_FLAGS:
                self._update_irq(stream)

    def _update_irq(self, stream: int) -> None:
        register = self.words["LISR" if stream < 4 else "HISR"]
        flags = register >> _SHIFTS[stream % 4] & _ALL_FLAGS
        # DMEIE TEIE HTIE TCIE are bits 1 to 4 of the stream's register, their flags bits 2 to 5.
        enabled = self.words[f"S{stream}CR"] << 1 & (_DME | _TE | _HT | _TC)
        self.context.irq(self._irqs[stream], bool(flags & enabled))

    def sync(self) -> None:
        """Bring all streams up to now."""
        for sources in self._sources:
            if sources:
                self._system.sync(sources)

    def _synced(self, register: str) -> int:
        self.sync()
        return self.words[register]

    def _set(self, stream: int, name: str, value: int) -> None:
        self.sync()
        if self.words[f"S{stream}CR"] & _EN:
            self.refuse_frozen(stream, name)
        self.keep(f"S{stream}{name}", value)

    def _write_cr(self, stream: int, value: int) -> None:
        register = f"S{stream}CR"
        self.sync()
        before = self.words[register]
        if before & _EN and (before ^ value) & ~(_EN | 0x1E):
            self.refuse_changed(stream, value)
        self.keep(register, value)
        if value & _EN and not before & _EN:
            self._enable(stream)
        elif before & _EN and not value & _EN:
            sources = self._sources[stream]
            self._end(stream)
            self._raise(stream, _TC)  # a stream that is stopped says that it has ended (RM0431 8.3.15)
            self._system.tell(sources)
        self._update_irq(stream)

    # Judging a stream

    def refuse_frozen(self, stream: int, name: str) -> NoReturn:
        """A register of an enabled stream is written."""
        self.context.fail(f"{self.name} stream {stream}: {name} is written while the stream is enabled")

    def refuse_changed(self, stream: int, value: int) -> NoReturn:
        """The configuration of an enabled stream is changed."""
        before = self.words[f"S{stream}CR"]
        self.context.fail(
            f"{self.name} stream {stream}: its configuration is changed while it is enabled "
            f"(0x{before:08X} to 0x{value:08X})"
        )

    def judge_sleep(self) -> None:
        """The core sleeps. Fail if a stream reads DTCM, which does not answer then."""
        for stream in range(STREAMS):
            if self._reads_dtcm(stream):
                self.sync()  # it may have ended
                if self._reads_dtcm(stream):
                    self.refuse_asleep(stream)

    def _reads_dtcm(self, stream: int) -> bool:
        control, address = self.words[f"S{stream}CR"], self.words[f"S{stream}M0AR"]
        reads = control & _EN and self.get(f"S{stream}CR", "DIR") == _TO_PERIPHERAL
        return bool(reads) and DTCM.address <= address < DTCM.address + DTCM.size

    def refuse_asleep(self, stream: int) -> NoReturn:
        """A stream reads DTCM while the core sleeps (the vendor's errata for the STM32F7)."""
        self.context.fail(
            f"{self.name} stream {stream} reads DTCM (0x{self.words[f'S{stream}M0AR']:08X}) while the core "
            f"sleeps, which gives nothing; expected its buffer in SRAM1 or SRAM2, or no WFI meanwhile"
        )

    def refuse_twice(self, stream: int, source: str, other: str) -> NoReturn:
        """Another stream serves `source` already."""
        self.context.fail(
            f"{self.name} stream {stream} is enabled for {source}, which {other} serves already"
        )

    def _enable(self, stream: int) -> None:
        sources = self.judge(stream)
        self._totals[stream], self._moved[stream] = self.words[f"S{stream}NDTR"], 0
        self._sources[stream] = sources
        self._system.link(sources, self, stream)

    def judge(self, stream: int) -> tuple[str, ...]:
        """The requests that will drive a stream about to be enabled. Fails for what it may not be."""
        who, fail = f"{self.name} stream {stream}", self.context.fail
        channel, to_peripheral = self.get(f"S{stream}CR", "CHSEL"), self.get(f"S{stream}CR", "DIR")
        count = self.words[f"S{stream}NDTR"]
        flags = self.words["LISR" if stream < 4 else "HISR"] >> _SHIFTS[stream % 4] & _ALL_FLAGS
        if flags:
            names = [name for name, bit in zip(_FLAGS, (0, 2, 3, 4, 5), strict=True) if flags >> bit & 1]
            fail(f"{who} is enabled while {', '.join(names)} is set, expected its flags cleared before")
        if to_peripheral > _TO_PERIPHERAL:
            fail(f"{who}: memory to memory is not modelled")
        if not count:
            fail(f"{who} is enabled with NDTR 0")
        msize, psize = self.get(f"S{stream}CR", "MSIZE"), self.get(f"S{stream}CR", "PSIZE")
        if psize == 3 or (self.get(f"S{stream}FCR", "DMDIS") and msize != psize):
            fail(f"{who}: items of MSIZE {msize} and PSIZE {psize} are not modelled, expected the same size")
        sources = self._judge_channel(stream, channel, to_peripheral)
        self._judge_memory(stream, to_peripheral, count, 1 << psize)
        return sources

    def _judge_channel(self, stream: int, channel: int, to_peripheral: int) -> tuple[str, ...]:
        """The requests that drive the stream, which must be its peripheral's."""
        who, fail = f"{self.name} stream {stream}", self.context.fail
        address = self.words[f"S{stream}PAR"]
        found = load_table().find(address)
        if found is None or found[1] is None or found[0].name not in self._system.devices:
            fail(f"{who}: the peripheral address 0x{address:08X} is no register that the emulator models")
        block, register = found
        assert register is not None
        place = f"{block.name}_{register.name}"
        device = self._system.devices[block.name]
        if not device.clocked:
            fail(f"{who} is enabled for {place}, but {device.gate} is 0")
        if self.number == 1 and address >= _APB1_END:
            fail(f"{who}: DMA1 reaches peripherals on APB1 only, but its address is {place}")
        there = REQUESTS.get((self.number, stream, channel), ())
        wanted = [name for name in there if serves(name, block.name)]
        if not wanted:
            is_ = " or ".join(there) or "no request"
            right = [
                f"channel {c} ({name})"
                for (n, s, c), names in REQUESTS.items()
                for name in names
                if (n, s) == (self.number, stream) and serves(name, block.name)
            ]
            fail(
                f"{who}: channel {channel} is driven by {is_}, but its peripheral address is {place}; "
                f"expected {' or '.join(right) or 'another stream'}"
            )
        for name in wanted:
            if (name.endswith("_RX") or name == "ADC1") and to_peripheral:
                fail(f"{who}: {name} moves from the peripheral, but DIR is {to_peripheral}")
            if name.endswith("_TX") and not to_peripheral:
                fail(f"{who}: {name} moves to the peripheral, but DIR is 0")
        if address % (1 << self.get(f"S{stream}CR", "PSIZE")):
            fail(f"{who}: the peripheral address 0x{address:08X} is not aligned to its items")
        return tuple(wanted)

    def _judge_memory(self, stream: int, to_peripheral: int, count: int, size: int) -> None:
        who, fail = f"{self.name} stream {stream}", self.context.fail
        address = self.words[f"S{stream}M0AR"]
        end = address + size * (count if self._increments(stream) else 1)
        if address % size:
            fail(f"{who}: the memory address 0x{address:08X} is not aligned to items of {size} bytes")
        places = [(r.address, r.address + r.size) for r in (DTCM, SRAM1, SRAM2)]
        if to_peripheral:
            places.append((FLASH_BASE, FLASH_BASE + FLASH_BYTES))
        # DTCM, SRAM1 and SRAM2 follow each other without a gap.
        joined = [(DTCM.address, SRAM2.address + SRAM2.size), *places[3:]]
        if not any(begin <= address and end <= stop for begin, stop in joined):
            fail(
                f"{who}: memory 0x{address:08X} to 0x{end - 1:08X} is out of the reach of DMA, "
                f"expected DTCM, SRAM1{', SRAM2 or flash' if to_peripheral else ' or SRAM2'}"
            )
        self.refuse_cached(stream, end - 1)

    def refuse_cached(self, stream: int, address: int) -> None:
        """Fail if the data cache holds what lies at `address`."""
        if SRAM1.address <= address < SRAM2.address + SRAM2.size and self.context.is_cached(address):
            self.context.fail(
                f"{self.name} stream {stream}: 0x{address:08X} lies in cached RAM while the data cache "
                f"is on, expected DTCM"
            )


class DmaSystem:
    """Both controllers, and which stream serves which request."""

    def __init__(self, context: Context) -> None:
        self.controllers = {number: Dma(context, number, self) for number in (1, 2)}
        self.devices: dict[str, Device] = {}  # all of the board, by name
        self._drivers: dict[str, Driver] = {}
        self._streams: dict[str, tuple[Dma, int]] = {}  # request: the enabled stream that serves it
        self._context = context
        context.on_sleep(self._judge_sleep)

    def connect(self, source: str, driver: Driver) -> None:
        """`driver` makes the requests called `source`, e.g. "SPI1_RX"."""
        self._drivers[source] = driver

    def available(self, source: str) -> int:
        """Items that a stream would move for `source` before it ends or wraps; 0: none is enabled."""
        found = self._streams.get(source)
        return found[0].available(found[1]) if found else 0

    def wake(self, source: str, alarm: Alarm, cycle: int | None, *, quiet: bool = True) -> None:
        """At `cycle` the driver of `source` has something to move: `alarm` rings then; None: it has nothing.

        quiet: nobody could notice but by looking at DMA's registers or the driver's. Then it may be asked to
        `sync` instead, when the program does.
        """
        if cycle is None:
            alarm.cancel()
        else:
            alarm.set(cycle)

    def total(self, source: str) -> int:
        """Items of the whole transfer for `source`; 0: no stream is enabled."""
        found = self._streams.get(source)
        return found[0].total(found[1]) if found else 0

    def until_flag(self, source: str) -> int:
        """Items until the stream that serves `source` raises its next flag; 0: none is enabled."""
        found = self._streams.get(source)
        return found[0].until_flag(found[1]) if found else 0

    def target(self, source: str) -> int:
        """The peripheral address of the stream that serves `source`."""
        controller, stream = self._streams[source]
        return controller.target(stream)

    def circular(self, source: str) -> bool:
        """Whether the stream that serves `source` begins anew at its end."""
        controller, stream = self._streams[source]
        return bool(controller.get(f"S{stream}CR", "CIRC"))

    def take(self, source: str, count: int) -> list[int]:
        """The next `count` items from memory; no more than are available unless the stream is circular."""
        controller, stream = self._streams[source]
        return controller.take(stream, count)

    def give(self, source: str, items: Sequence[int]) -> None:
        """Items to memory; no more than are available unless the stream is circular."""
        controller, stream = self._streams[source]
        controller.give(stream, items)

    def _judge_sleep(self) -> None:
        for controller in self.controllers.values():
            controller.judge_sleep()

    # Of the controllers

    def link(self, sources: tuple[str, ...], controller: Dma, stream: int) -> None:
        self.sync(sources)  # what has passed until now passed without the stream
        for source in sources:
            other = self._streams.get(source)
            if other is not None:
                controller.refuse_twice(stream, source, f"{other[0].name} stream {other[1]}")
            self._streams[source] = (controller, stream)
        self.tell(sources)

    def unlink(self, sources: tuple[str, ...]) -> None:
        for source in sources:
            self._streams.pop(source, None)

    def forget(self, number: int) -> None:
        """Controller `number` is reset."""
        for source in [s for s, (dma, _) in self._streams.items() if dma.number == number]:
            del self._streams[source]

    def relink(self) -> None:
        """After a snapshot: find again what serves what, silently."""
        self._streams = {
            source: (dma, stream)
            for dma in self.controllers.values()
            for stream, sources in enumerate(dma.sources)
            for source in sources
        }

    def sync(self, sources: tuple[str, ...]) -> None:
        """Requests of one stream are of one peripheral."""
        driver = self._drivers.get(sources[0])
        if driver is not None:
            driver.sync()

    def tell(self, sources: tuple[str, ...]) -> None:
        driver = self._drivers.get(sources[0])
        if driver is not None:
            driver.dma_changed()
