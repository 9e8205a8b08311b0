"""DMA1 and DMA2: the rules for a stream, checked when it is enabled; items move in C (native/c/dma.c).

A stream needs the request behind its channel, addresses that DMA reaches, and memory that the data cache does
not hide.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NoReturn

from neuroflight.sim.board.core.engine import NEVER, Alarm
from neuroflight.sim.board.native.library import Driver, Native, NativeDevice
from neuroflight.sim.board.peripherals.dma_requests import REQUESTS, serves
from neuroflight.sim.board.registers.bus import Device, load_table
from neuroflight.toolchain.contract import DTCM, FLASH_BASE, FLASH_BYTES, SRAM1, SRAM2

STREAMS = 8
_TO_PERIPHERAL = 1  # DIR; 0 from peripheral, 2 memory to memory
_FLAGS = ("FEIF", "DMEIF", "TEIF", "HTIF", "TCIF")
_SHIFTS = (0, 6, 16, 22)  # of the flags of streams 0 to 3 in LISR, 4 to 7 in HISR (RM0431 8.5.1)
_ALL_FLAGS = 0x3D
_APB1_END = 0x40008000  # DMA1's peripheral port reaches APB1 only (RM0431 2.1, bus matrix)
_OF_PORTS = (("IDR", "ODR"), ("BSRR", "ODR"))  # registers that may be read, and written
_WORDS = ("CR", "NDTR", "PAR", "M0AR", "M1AR", "FCR")  # of each stream, the first at word 4


class Dma(NativeDevice):
    """One controller, 1 or 2."""

    def __init__(self, native: Native, number: int, system: DmaSystem) -> None:
        name, lib = f"DMA{number}", native.library
        interrupts = tuple(load_table().interrupt(f"{name}_STREAM{i}") for i in range(STREAMS))
        super().__init__(native, name, lib.DMA, number - 1, interrupts=interrupts)
        self._number, self._system = number, system
        self.queries = {
            lib.QUERY_ENABLE: lambda stream, _: system.drive(number, stream, self.validate(stream)),
            lib.QUERY_CHANGED: self._reject_changed,
            lib.QUERY_FROZEN: self._reject_frozen,
            lib.QUERY_TWICE: self._reject_twice,
            lib.QUERY_CACHED: self._reject_cached,
            # ARMv7-M A3.7.3, B2.3: earlier stores may still wait.
            lib.QUERY_BARRIER: "{name} stream {a} is enabled without a barrier after the program's last "
            "store: DMA may overtake what was stored, expected a DSB or DMB between them",
            lib.QUERY_ASLEEP: self._reject_asleep,
        }

    def sync(self) -> None:
        self.native.library.native_sync(self.native.handle, self._number - 1)

    def _fail(self, stream: int, message: str) -> NoReturn:
        self.engine.fail(f"{self.name} stream {stream}{message}")

    def _reject_frozen(self, stream: int, word: int) -> NoReturn:
        self._fail(stream, f": {_WORDS[(word - 4) % 6]} is written while the stream is enabled")

    def _reject_changed(self, stream: int, value: int) -> NoReturn:
        before = self.words[f"S{stream}CR"]
        self._fail(
            stream,
            f": its configuration is changed while it is enabled (0x{before:08X} to 0x{value:08X})",
        )

    def _reject_asleep(self, stream: int, _: int) -> NoReturn:
        """Fail: a stream reads DTCM while the core sleeps (the vendor's errata for the STM32F7)."""
        self._fail(
            stream,
            f" reads DTCM (0x{self.words[f'S{stream}M0AR']:08X}) while the core sleeps, which gives nothing; "
            f"expected its buffer in SRAM1 or SRAM2, or no WFI meanwhile",
        )

    def _reject_twice(self, stream: int, source: int) -> NoReturn:
        self._fail(
            stream, f" is enabled for {self._system.names[source]}, which another stream serves already"
        )

    def validate(self, stream: int) -> tuple[str, ...]:
        """Check a stream about to be enabled; return the requests that will drive it."""
        who, fail = f"{self.name} stream {stream}", self.engine.fail
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
        sources = self._validate_channel(stream, channel, to_peripheral)
        self._validate_memory(stream, to_peripheral, count, 1 << psize)
        return sources

    def _validate_channel(self, stream: int, channel: int, to_peripheral: int) -> tuple[str, ...]:
        """Return the requests that drive the stream, which must be its peripheral's."""
        who, fail = f"{self.name} stream {stream}", self.engine.fail
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
        if self._number == 1 and address >= _APB1_END:
            fail(f"{who}: DMA1 reaches peripherals on APB1 only, but its address is {place}")
        there = REQUESTS.get((self._number, stream, channel), ())
        wanted = [name for name in there if serves(name, block.name)]
        if not wanted:
            is_ = " or ".join(there) or "no request"
            right = [
                f"channel {c} ({name})"
                for (n, s, c), names in REQUESTS.items()
                for name in names
                if (n, s) == (self._number, stream) and serves(name, block.name)
            ]
            fail(
                f"{who}: channel {channel} is driven by {is_}, but its peripheral address is {place}; "
                f"expected {' or '.join(right) or 'another stream'}"
            )
        if block.name.startswith("GPIO") and register.name not in _OF_PORTS[to_peripheral]:
            way = "from memory" if to_peripheral else "to memory"
            expected = " or ".join(_OF_PORTS[to_peripheral])
            fail(f"{who} moves {way}, but its peripheral is {place}, expected {expected}")
        for name in wanted:
            if (name.endswith("_RX") or name == "ADC1") and to_peripheral:
                fail(f"{who}: {name} moves from the peripheral, but DIR is {to_peripheral}")
            if name.endswith("_TX") and not to_peripheral:
                fail(f"{who}: {name} moves to the peripheral, but DIR is 0")
        if address % (1 << self.get(f"S{stream}CR", "PSIZE")):
            fail(f"{who}: the peripheral address 0x{address:08X} is not aligned to its items")
        return tuple(wanted)

    def _validate_memory(self, stream: int, to_peripheral: int, count: int, size: int) -> None:
        who, fail = f"{self.name} stream {stream}", self.engine.fail
        address = self.words[f"S{stream}M0AR"]
        end = address + size * (count if self.get(f"S{stream}CR", "MINC") else 1)
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
        self._reject_cached(stream, end - 1)

    def _reject_cached(self, stream: int, address: int) -> None:
        """Fail if the data cache covers `address`."""
        if SRAM1.address <= address < SRAM2.address + SRAM2.size and self.engine.is_cached(address):
            self._fail(
                stream,
                f": 0x{address:08X} lies in cached RAM while the data cache is on, expected DTCM, or SRAM2 "
                f"where the MPU keeps it out of the cache",
            )


class Request:
    """A request of a peripheral in Python to DMA, and the stream that serves it."""

    def __init__(self, native: Native, number: int) -> None:
        """Name what C calls by `number`."""
        self._native, self._library, self.number = native, native.library, number

    @property
    def available(self) -> int:
        """Items that the stream moves before it ends or wraps; 0 without one."""
        return int(self._library.native_available(self._native.handle, self.number))

    @property
    def total(self) -> int:
        """Items of the whole transfer; 0: no stream is enabled."""
        return int(self._library.native_total(self._native.handle, self.number))

    @property
    def until_flag(self) -> int:
        """Items until the stream raises its next flag; 0: none is enabled."""
        return int(self._library.native_until_flag(self._native.handle, self.number))

    @property
    def target(self) -> int:
        """Peripheral address of the stream."""
        return int(self._library.native_target(self._native.handle, self.number))

    @property
    def circular(self) -> bool:
        """True if the stream restarts at its end."""
        return bool(self._library.native_circular(self._native.handle, self.number))

    def wake(self, alarm: Alarm, cycle: int | None, *, quiet: bool = True) -> None:
        """Let `alarm` ring at `cycle`, when there is something to move; None: there is nothing.

        quiet: only a read of DMA's registers or the driver's could show the move. Then `sync` may be called
        at such a read instead.
        """
        when = NEVER if cycle is None else cycle
        self._library.native_wake(self._native.handle, self.number, alarm.number, when, quiet)

    def take(self, count: int) -> list[int]:
        """Take the next `count` items from memory; no more than available unless it is circular."""
        items = self._native.ffi.new("uint32_t[]", count)
        taken = self._library.native_take(self._native.handle, self.number, items, count)
        self._native.engine.raise_now()
        return list(items[0:taken])

    def give(self, items: Sequence[int]) -> None:
        """Write items to memory; no more than are available unless the stream is circular."""
        self._library.native_give(self._native.handle, self.number, list(items), len(items))
        self._native.engine.raise_now()


class DmaSystem:
    """Both controllers, and the requests by name. C's numbers up to PYTHON_SOURCE are of drivers in C."""

    def __init__(self, native: Native) -> None:
        self.controllers = {number: Dma(native, number, self) for number in (1, 2)}
        self.devices: dict[str, Device] = {}  # all of the board, by name
        self.names: dict[int, str] = {}  # of requests
        self.requests: dict[str, Request] = {}
        self._native, self._library = native, native.library
        for name in (f"SPI{i}_{way}" for i in (1, 2, 3) for way in ("RX", "TX")):
            self.request(name, getattr(self._library, name))

    def request(self, name: str, number: int) -> Request:
        """Let C call the request `name` by `number`."""
        self.names[number], self.requests[name] = name, Request(self._native, number)
        return self.requests[name]

    def connect(self, name: str, driver: Driver, *, lazy: bool = False) -> Request:
        """Let `driver` make the request `name`, e.g. "USART1_RX". lazy: not at each wake."""
        number = max(self._library.PYTHON_SOURCE, *(known + 1 for known in self.names))
        self._native.drivers[number] = driver
        if lazy:
            self._library.native_lazy(self._native.handle, number)
        return self.request(name, number)

    def drive(self, controller: int, stream: int, names: Sequence[str]) -> None:
        """Let the requests `names` drive a stream that is about to be enabled."""
        for place, name in enumerate(names):
            number = self.requests[name].number
            self._library.native_set_source(self._native.handle, controller - 1, stream, place, number)
