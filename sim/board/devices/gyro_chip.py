"""The gyro chip on its SPI, as a register file with its times and limits.

The loop says what the sensors measure; at each sample time the chip latches that into its data registers and
pulses its data-ready line, in C (native/c/gyro_chip.c). Registers that the chip has but the model does not
know are errors, so that a configuration is never taken for done; so are samples of a chip that is not set up
as its data sheet asks. The kinds of chips, and what their registers mean, are in gyro_mpu.py, gyro_icm.py,
gyro_lsm.py and gyro_bmi.py.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from neuroflight.sim.board.core.context import TIME_HZ, Kept
from neuroflight.sim.board.core.engine import NEVER
from neuroflight.sim.board.devices.gyro_mount import Counts
from neuroflight.sim.board.native.library import Native, in_c
from neuroflight.sim.board.peripherals.gpio import Pins, place
from neuroflight.toolchain.boards.facts import GyroPlace
from neuroflight.toolchain.contract import GYRO_COUNTS, GYRO_FULL_SCALE_DEG_S

DATA_BYTES = 14  # accelerometer, temperature and gyro in some order, 16 bits each

_VALUES = struct.Struct("=7h")  # `measured` of struct gyro
_READ = 0x80
MICROSECOND = TIME_HZ // 1_000_000
_MILLISECOND = TIME_HZ // 1000

Registers = dict[int, int]  # values, by GyroKind.place


@dataclass(frozen=True)
class Setup:
    """The effect of the registers on the samples."""

    period: int | None  # of samples and data-ready pulses [cycles]; None: there are none
    gyro_shift: int = 0  # by how much +-2000 deg/s are more than the range that is set, as a power of two
    accel_shift: int = 0  # and +-16 g


@dataclass(frozen=True, kw_only=True)
class GyroKind:
    """The differences between the chips; a subclass for each family says what registers mean."""

    name: str
    who_am_i: int
    told_at: int  # its register
    data: int  # the first data register
    order: tuple[int, ...]  # of the data: 0 to 2 accelerometer, 3 temperature, 4 to 6 gyro
    data_hz: int  # SCK at most while data and interrupt registers are read
    register_hz: int  # SCK at most else
    counts_per_degree: float  # of the thermometer
    zero_deg_c: float  # where it counts 0
    start_ms: int  # from power to answers, at most
    pulse: int  # data-ready line, high [cycles]
    little: bool = False  # a value's lower byte comes first
    gyro_scale: tuple[int, int] = (GYRO_COUNTS, GYRO_FULL_SCALE_DEG_S)  # counts at a rate [deg/s]
    ready_bit: int = 0x01  # of the register `status_at`
    dummies: int = 0  # bytes of a read before the first that tells something

    def temperature(self, deg_c: float) -> int:
        return round((deg_c - self.zero_deg_c) * self.counts_per_degree)

    def after_reset(self) -> Registers:
        """Return the registers that the model keeps, as a reset leaves them."""
        raise NotImplementedError

    def known(self, register: int) -> int | None:
        """Return the bits of a register that the image may write; None: none of it."""
        raise NotImplementedError

    def told(self, register: int) -> int | None:
        """Return what a register says that cannot be written; None: no such one is modelled."""
        return self.who_am_i if register == self.told_at else None

    def status_at(self) -> int | None:
        """Return the register that tells of the data-ready interrupt, cleared when read; None: none."""
        return None

    def place(self, registers: Mapping[int, int], address: int) -> int:
        """Return the register at an address of the bus: bank << 8 | address."""
        return address

    def write(self, chip: GyroChip, register: int, value: int) -> None:
        """Take over a value that `known` allows."""
        chip.registers[register] = value

    def listens(self, registers: Registers) -> bool:
        """Return whether a transaction that begins is for it; one that is not may wake it (`wake`)."""
        return True

    def wake(self, registers: Registers) -> None:
        """Take over that a transaction has begun which it did not listen to."""

    def window(self) -> range:
        """Return the addresses of its data and of the status beside them, which are read together."""
        status = self.status_at()
        ends = (self.data, self.data + DATA_BYTES - 1, *(() if status is None else (status,)))
        return range(min(ends), max(ends) + 1)

    def stays(self, register: int) -> bool:
        """Return whether all bytes of a transaction go to this register, none to those behind it."""
        return False

    def setup(self, chip: GyroChip) -> Setup:
        """Return what the registers mean for samples; fails where the data sheet forbids to sample so."""
        raise NotImplementedError


class GyroChip(Kept):
    """One chip, powered since cycle 0; a reset of the board's processor does not reset it.

    C takes the samples and answers plain reads of data; this class answers for all other registers.
    """

    kept = ("registers", "_ready_why", "_powered_at", "_deaf", "quiet_until")

    def __init__(self, native: Native, pins: Pins, where: GyroPlace, kind: GyroKind) -> None:
        self.engine, self.kind = native.engine, kind
        self._native, self._pins, self._where = native, pins, where
        lib = native.library
        lib.native_chip(native.handle, lib.CHIP_GYRO, where.spi - 1, *place(where.select))
        if where.ready is not None:
            lib.native_gyro_ready(native.handle, *place(where.ready))
        self.phase = 0  # by how much later its samples begin: its clock is its own [cycles]
        self._sample_alarm = self.engine.alarm("gyro.sample", in_c)
        self._fall_alarm = self.engine.alarm("gyro.fall", in_c)
        alarms = (self._sample_alarm.number, self._fall_alarm.number)
        self._in_c = native.library.native_gyro(native.handle, *alarms, kind.pulse, float(kind.data_hz))
        self._in_c.data_at, self._in_c.order, self._in_c.little = kind.data, list(kind.order), kind.little
        self._in_c.ready_bit, self._in_c.dummies = kind.ready_bit, kind.dummies
        native.on_exchange = self._exchange
        self._measured = memoryview(native.ffi.buffer(self._in_c.measured))
        self._no_address = native.library.NO_ADDRESS
        self._powered_at = 0
        self._start()
        self.rest()

    def rest(self) -> None:
        """Set the lines to rest: select by the board's pull-up, nothing ready."""
        self._pins.drive(str(self._where.select), True)
        self._lower_ready()

    def _lower_ready(self) -> None:
        if self._where.ready is not None:
            self._pins.drive(str(self._where.ready), False)

    def processor_reset(self) -> None:
        """Restore the alarms after a reset of the processor, during which the chip continues.

        A transaction that was under way has ended wherever it was.
        """
        self._in_c.address = self._no_address
        self._fall_alarm.cancel()
        self._lower_ready()
        if self.next_sample is not None:
            self._sample_alarm.set(self.next_sample)

    def power_on(self) -> None:
        self._powered_at = self.engine.cycle
        self._in_c.due = NEVER
        self._sample_alarm.cancel()
        self._fall_alarm.cancel()
        self._start()
        self._lower_ready()

    def _start(self) -> None:
        state = self._in_c
        state.samples = 0  # taken since power-up
        self.measure((0, 0, 0), 0, (0, 0, 0))
        state.ready_at = self._powered_at + self.kind.start_ms * _MILLISECOND
        self._ready_why = "power-up"
        state.address, state.reads = self._no_address, False
        state.dummies_left = 0
        self._deaf = False  # to the transaction that is under way
        state.shadow = bytes(DATA_BYTES)
        self._clear()

    def _clear(self) -> None:
        self.registers = self.kind.after_reset()
        self.quiet_until = 0  # no write before this cycle
        self._in_c.interrupt = False
        self._hide()
        self.clear_data()

    # For the loop

    def measure(self, accel: Counts, temperature: int, gyro: Counts) -> None:
        """Set the sensors' values from now on: int16 counts on the chip's axes.

        +-16 g, and of the gyro so many at so many deg/s as `gyro_scale` of its kind says.
        """
        _VALUES.pack_into(self._measured, 0, *accel, temperature, *gyro)

    @property
    def before_sample(self) -> Callable[[int], None]:
        """Callback with the number of each sample before it is taken; may call `measure`."""
        return self._native.on_sample

    @before_sample.setter
    def before_sample(self, callback: Callable[[int], None]) -> None:
        self._native.on_sample = callback
        self._native.library.native_hear_samples(self._native.handle, True)

    @property
    def samples(self) -> int:
        return int(self._in_c.samples)

    @property
    def silent(self) -> bool:
        """True: no data-ready pulses, as injected by a fault campaign."""
        return bool(self._in_c.silent)

    @silent.setter
    def silent(self, silent: bool) -> None:
        self._in_c.silent = silent

    @property
    def next_sample(self) -> int | None:
        """The cycle of the next sample and data-ready pulse; None: the chip is not set up to give any."""
        due = int(self._in_c.due)
        return None if due == NEVER else due

    def begin_at(self, cycle: int, slower: float = 1.0) -> None:
        """Let its next sample come at that cycle, as its clock is its own, and periods be so much longer."""
        if self.next_sample is not None:
            self._in_c.period = round(self._in_c.period * slower)
            self._in_c.due = cycle
            self._sample_alarm.set(cycle)

    # For its kind

    def fail(self, what: str) -> None:
        """Fail for what the image does wrong."""
        self.engine.fail(what)

    def clear_data(self) -> None:
        self._in_c.data = bytes(DATA_BYTES)

    def reset(self, ms: float) -> None:
        """Reset it, which takes so long; then it must not be addressed."""
        self._clear()
        self.rest_for(ms, "its reset")

    def rest_for(self, ms: float, why: str) -> None:
        """Let nobody address it for so long. why: "its reset"."""
        self._in_c.ready_at = self.engine.cycle + round(ms * _MILLISECOND)
        self._ready_why = why

    # On the bus

    def _exchange(self, sent: Sequence[int], transaction: int, hz: float, mode: int) -> bytes:
        """Exchange bytes. transaction: its number; hz: of the clock; mode: 0..3."""
        state = self._in_c
        if transaction != state.transaction:
            state.transaction = transaction
            self._validate_end()
            state.address = self._no_address
        if mode not in (0, 3):
            self.engine.fail(f"the {self.kind.name} is addressed in SPI mode {mode}, expected 0 or 3")
        return bytes(self._byte(value, hz) for value in sent)

    def _byte(self, value: int, hz: float) -> int:
        state = self._in_c
        address = int(state.address)
        if address == self._no_address:
            state.address, state.reads = value & ~_READ, bool(value & _READ)
            state.first = state.address
            state.shadow = bytes(state.data)
            state.dummies_left = self.kind.dummies if state.reads else 0
            self._deaf = not self.kind.listens(self.registers)
            if self._deaf:
                self.kind.wake(self.registers)
                self._hide()
            self._validate_time()
            self._validate_clock(hz)
            return 0
        self._validate_clock(hz)
        if self._deaf:
            return 0
        if state.dummies_left:
            state.dummies_left -= 1
            return 0
        if state.reads or not self.kind.stays(address):
            state.address = address + 1 & 0x7F
        if state.reads:
            return self._read(address)
        self._write(address, value)
        return 0

    def _validate_end(self) -> None:
        """Check at the end of a transaction that it has read whole values."""
        address = int(self._in_c.address)
        if not self._in_c.reads or address in (self._no_address, self._in_c.first) or self._in_c.hidden:
            return
        count = address - self.kind.data
        if count & 1 and 0 < count < DATA_BYTES:
            self.engine.fail(
                f"the data of the {self.kind.name} was read up to 0x{address - 1:02X}, the "
                f"{'lower' if self.kind.little else 'upper'} half of a value; expected both its bytes in one "
                f"transaction"
            )

    def _validate_time(self) -> None:
        ready_at = int(self._in_c.ready_at)
        if self.engine.cycle < ready_at:
            left = (ready_at - self.engine.cycle) / _MILLISECOND
            self.engine.fail(
                f"the {self.kind.name} is addressed {left:.1f} ms before it answers after {self._ready_why}, "
                f"expected a wait"
            )

    def _validate_clock(self, hz: float) -> None:
        address, kind = int(self._in_c.address), self.kind
        place = address - kind.data
        fast = self._in_c.reads and (0 <= place < DATA_BYTES or address == kind.status_at())
        limit = kind.data_hz if fast else kind.register_hz
        if hz > limit:
            what = "data" if fast else f"register 0x{address:02X}"
            self.engine.fail(
                f"SPI{self._where.spi} reads or writes {what} of the {kind.name} at {hz / 1e6:g} MHz, "
                f"expected {limit / 1e6:g} MHz at most"
            )

    def _named(self, register: int) -> str:
        bank = f" of bank {register >> 8}" if register >> 8 else ""
        return f"register 0x{register & 0xFF:02X}{bank} of the {self.kind.name}"

    def _read(self, address: int) -> int:
        kind = self.kind
        register = kind.place(self.registers, address)
        if kind.data <= register < kind.data + DATA_BYTES:
            return int(self._in_c.shadow[register - kind.data])
        if register == kind.status_at():
            status, self._in_c.interrupt = int(self._in_c.interrupt) * kind.ready_bit, False
            return status
        told = kind.told(register)
        if told is not None:
            return told
        if register not in self.registers:
            self.engine.fail(f"{self._named(register)} is read, which is not modelled")
        return self.registers[register]

    def _write(self, address: int, value: int) -> None:
        register = self.kind.place(self.registers, address)
        known = self.kind.known(register)
        if known is None or value & ~known:
            self.engine.fail(
                f"{self._named(register)} = 0x{value:02X}: the model knows "
                f"{'none of it' if known is None else f'bits 0x{known:02X}'}"
            )
        if self.engine.cycle < self.quiet_until:
            left = (self.quiet_until - self.engine.cycle) / MICROSECOND
            self.engine.fail(f"{self._named(register)} is written {left:.0f} us too early, expected a wait")
        self.kind.write(self, register, value)
        self._plan()

    def _hide(self) -> None:
        """Tell C whether it can answer reads of the data, and what it says there."""
        kind, state, registers = self.kind, self._in_c, self.registers
        state.hidden = not kind.listens(registers) or kind.place(registers, kind.data) != kind.data
        if not state.hidden:
            entries = [self._entry(address) for address in kind.window()]
            state.window_at, state.window_count = kind.window().start, len(entries)
            state.window[0 : len(entries)] = entries

    def _entry(self, address: int) -> int:
        kind, lib = self.kind, self._native.library
        register = kind.place(self.registers, address)
        if kind.data <= register < kind.data + DATA_BYTES:
            return register - kind.data
        if register == kind.status_at():
            return int(lib.GYRO_STATUS)
        told = kind.told(register)
        return int(lib.GYRO_VALUE) | (self.registers[register] if told is None else told)

    def _plan(self) -> None:
        """Take over changed registers."""
        state = self._in_c
        self._hide()
        setup = self.kind.setup(self)
        state.gyro_shift, state.accel_shift = setup.gyro_shift, setup.accel_shift
        if setup.period is None:
            state.due = NEVER
            self._sample_alarm.cancel()
            return
        state.period = setup.period
        if state.due == NEVER:
            state.due = self.engine.cycle + state.period + self.phase
            self._sample_alarm.set(state.due)
