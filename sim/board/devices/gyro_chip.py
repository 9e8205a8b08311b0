"""The gyro chip behind SPI1: an ICM20602 or one of its kin, as a register file with its times and limits.

The loop says what the sensors measure; at each sample time the chip latches that into its data registers and
pulses its data-ready line, in C (native/c/gyro_chip.c). Registers that the chip has but the model does not
know are errors, so that a configuration is never taken for done; so are samples of a chip that is not set up
as its data sheet asks. Sources: MPU-6500 product specification (PS-MPU-6500A-01) and register map
(RM-MPU-6500A-00), ICM-20689 data sheet (DS-000143); of ICM-20602 (DS-000176), ICM-20608-G and MPU-9250 what
PX4's register headers tell of their data sheets, of the ICM-20601 (DS-000191) I2Cdev's. Thermometer and speed
of the ICM-20601 are those of its kin.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from neuroflight.sim.board.core.context import TIME_HZ, Kept
from neuroflight.sim.board.core.engine import NEVER
from neuroflight.sim.board.devices.gyro_mount import Counts
from neuroflight.sim.board.native.library import Native, in_c
from neuroflight.sim.board.peripherals.gpio import Pins

CS, READY = "PC2", "PC3"  # pins.c and gyro_chip.c know them too

SMPLRT_DIV, CONFIG, GYRO_CONFIG, ACCEL_CONFIG, ACCEL_CONFIG2 = 0x19, 0x1A, 0x1B, 0x1C, 0x1D
INT_PIN_CFG, INT_ENABLE, INT_STATUS, DATA = 0x37, 0x38, 0x3A, 0x3B
SIGNAL_PATH_RESET, USER_CTRL, PWR_MGMT_1, PWR_MGMT_2, I2C_IF, WHO_AM_I = 0x68, 0x6A, 0x6B, 0x6C, 0x70, 0x75
DATA_BYTES = 14  # accelerometer, temperature, gyro: 16 bits each, the upper byte first

_VALUES = struct.Struct("=7h")  # `measured` of struct gyro
_READ = 0x80
_DEVICE_RESET, _SLEEP = 0x80, 0x40  # PWR_MGMT_1
_MILLISECOND = TIME_HZ // 1000
PULSE = TIME_HZ // 20_000  # data-ready line: 50 us
_CLOCK, _GOOD_CLOCK = 0x07, 0x01  # PWR_MGMT_1 CLKSEL: the gyro performs as it should with this one only
_FAST = 0x03  # GYRO_CONFIG FCHOICE_B: past the low-pass, at 32 kHz
REGISTER_HZ = 1_000_000  # SCK at most, all registers of the older chips

Bits = tuple[tuple[int, int], ...]  # registers, and bits or values of each

# Registers that the image may write, and the bits of each that the model knows. Of an MPU6500:
_WRITABLE: Bits = (
    *((SMPLRT_DIV, 0xFF), (CONFIG, 0x07), (GYRO_CONFIG, 0x18), (ACCEL_CONFIG, 0x18), (ACCEL_CONFIG2, 0x0F)),
    *((INT_PIN_CFG, 0x10), (INT_ENABLE, 0x01), (USER_CTRL, 0x11), (PWR_MGMT_1, 0xC7), (PWR_MGMT_2, 0x3F)),
)
_READ_ONLY = {INT_STATUS, WHO_AM_I, *range(DATA, DATA + DATA_BYTES)}


@dataclass(frozen=True)
class GyroKind:
    """The differences between the chips."""

    name: str
    who_am_i: int
    data_hz: int  # SCK at most while data and interrupt registers are read
    reset: Bits  # registers that are not 0 after reset
    signal_paths: int  # SIGNAL_PATH_RESET: those that there are
    counts_per_degree: float  # of the thermometer
    zero_deg_c: float  # where it counts 0
    start_ms: int  # from power to answers, at most (specification: 11 typical)
    reset_ms: int = 100  # from DEVICE_RESET to answers (register map, PWR_MGMT_1)
    register_hz: int = REGISTER_HZ
    writable: Bits = _WRITABLE
    spi_only: tuple[int, int] = (USER_CTRL, 0x10)  # register and bit that switch I2C off
    full_scale: int = 3  # FS_SEL and ACCEL_FS_SEL of +-2000 deg/s and +-16 g, the counts that the loop sets

    @property
    def known(self) -> dict[int, int]:
        """Registers that may be written, and the bits of each that the model knows, as last stated."""
        return {**dict(self.writable), SIGNAL_PATH_RESET: self.signal_paths}

    def temperature(self, deg_c: float) -> int:
        return round((deg_c - self.zero_deg_c) * self.counts_per_degree)


MPU6500 = GyroKind(
    name="MPU6500",
    who_am_i=0x70,
    data_hz=20_000_000,
    reset=((PWR_MGMT_1, 0x01),),
    signal_paths=0x07,
    counts_per_degree=333.87,
    zero_deg_c=21.0,
    start_ms=100,
)
ICM20689 = GyroKind(
    name="ICM20689",
    who_am_i=0x98,
    data_hz=8_000_000,
    reset=((PWR_MGMT_1, 0x41),),  # asleep
    signal_paths=0x03,  # the gyro's is reserved
    counts_per_degree=326.8,
    zero_deg_c=25.0,
    start_ms=100,
)
# By its data sheet it answers 2 ms after power-up; the model asks for as long a wait as its kin.
ICM20602 = GyroKind(
    name="ICM20602",
    who_am_i=0x12,
    data_hz=10_000_000,
    register_hz=10_000_000,
    reset=((PWR_MGMT_1, 0x41), (CONFIG, 0x80)),
    writable=(
        *_WRITABLE,
        (GYRO_CONFIG, 0x1B),
        (USER_CTRL, 0x01),
        (I2C_IF, 0x40),
    ),
    spi_only=(I2C_IF, 0x40),
    signal_paths=0x03,
    counts_per_degree=326.8,
    zero_deg_c=25.0,
    start_ms=100,
)
ICM20608G = replace(ICM20689, name="ICM20608G", who_am_i=0xAF)
ICM20601 = replace(ICM20689, name="ICM20601", who_am_i=0xAC, full_scale=2)  # +-500 to 4000 deg/s, +-4 to 32 g
MPU9250 = replace(MPU6500, name="MPU9250", who_am_i=0x71)


class GyroChip(Kept):
    """One chip, powered since cycle 0; a reset of the board's processor does not reset it.

    C takes the samples and answers plain reads of data; this class answers for all other registers.
    """

    kept = ("_registers", "_ready_why", "_powered_at")

    def __init__(self, native: Native, pins: Pins, kind: GyroKind = ICM20602) -> None:
        self.engine, self.kind = native.engine, kind
        self._native, self._pins = native, pins
        self.phase = 0  # by how much later its samples begin: its clock is its own [cycles]
        self._sample_alarm = self.engine.alarm("gyro.sample", in_c)
        self._fall_alarm = self.engine.alarm("gyro.fall", in_c)
        alarms = (self._sample_alarm.number, self._fall_alarm.number)
        self._in_c = native.library.native_gyro(native.handle, *alarms, PULSE, float(kind.data_hz))
        native.on_exchange = self._exchange
        self._measured = memoryview(native.ffi.buffer(self._in_c.measured))
        self._no_address = native.library.NO_ADDRESS
        self._powered_at = 0
        self._start()
        self.rest()

    def rest(self) -> None:
        """Set the lines to rest: select by the board's pull-up, nothing ready."""
        self._pins.drive(CS, True)
        self._pins.drive(READY, False)

    def processor_reset(self) -> None:
        """Restore the alarms after a reset of the processor, during which the chip continues."""
        self._fall_alarm.cancel()
        self._pins.drive(READY, False)
        if self.next_sample is not None:
            self._sample_alarm.set(self.next_sample)

    def power_on(self) -> None:
        self._powered_at = self.engine.cycle
        self._in_c.due = NEVER
        self._sample_alarm.cancel()
        self._fall_alarm.cancel()
        self._start()
        self._pins.drive(READY, False)

    def _start(self) -> None:
        state = self._in_c
        state.samples = 0  # taken since power-up
        self.measure((0, 0, 0), 0, (0, 0, 0))
        state.ready_at = self._powered_at + self.kind.start_ms * _MILLISECOND
        self._ready_why = "power-up"
        state.address, state.reads = self._no_address, False
        state.shadow = bytes(DATA_BYTES)
        self._clear()

    def _clear(self) -> None:
        self._registers = {**dict.fromkeys(self.kind.known, 0), **dict(self.kind.reset)}
        self._in_c.data = bytes(DATA_BYTES)
        self._in_c.interrupt = False

    # For the loop

    def measure(self, accel: Counts, temperature: int, gyro: Counts) -> None:
        """Set the sensors' values from now on: int16 counts on the chip's axes, +-16 g and +-2000 deg/s."""
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

    def _configured_period(self) -> int:
        if self._registers[GYRO_CONFIG] & _FAST:
            return TIME_HZ // 32_000
        filtered = self._registers[CONFIG] & 7
        if filtered in (0, 7):
            return TIME_HZ // 8000  # whatever the divider says
        return TIME_HZ // 1000 * (1 + self._registers[SMPLRT_DIV])

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
            state.shadow = bytes(state.data)
            self._validate_time()
            self._validate_clock(hz)
            return 0
        self._validate_clock(hz)
        state.address = address + 1 & 0x7F
        if state.reads:
            return self._read(address)
        self._write(address, value)
        return 0

    def _validate_end(self) -> None:
        """Check at the end of a transaction that it has read whole values."""
        address = int(self._in_c.address)
        if not self._in_c.reads or address == self._no_address:
            return
        count = address - DATA
        if count & 1 and 0 < count < DATA_BYTES:
            self.engine.fail(
                f"the data of the {self.kind.name} was read up to 0x{address - 1:02X}, the upper half "
                f"of a value; expected both its bytes in one transaction"
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
        address = int(self._in_c.address)
        fast = self._in_c.reads and INT_STATUS <= address < DATA + DATA_BYTES
        limit = self.kind.data_hz if fast else self.kind.register_hz
        if hz > limit:
            what = "data" if fast else f"register 0x{address:02X}"
            self.engine.fail(
                f"SPI1 reads or writes {what} of the {self.kind.name} at {hz / 1e6:g} MHz, expected "
                f"{limit / 1e6:g} MHz at most"
            )

    def _validate_set_up(self) -> None:
        """Check the set-up before samples begin."""
        clock = self._registers[PWR_MGMT_1] & _CLOCK
        if clock != _GOOD_CLOCK:
            self.engine.fail(
                f"the {self.kind.name} samples with CLKSEL {clock}, expected {_GOOD_CLOCK}: its gyro needs it"
            )
        register, bit = self.kind.spi_only
        if not self._registers[register] & bit:
            self.engine.fail(
                f"the {self.kind.name} samples while it may take its bus for I2C, expected register "
                f"0x{register:02X} with bit 0x{bit:02X}"
            )

    def _read(self, address: int) -> int:
        if DATA <= address < DATA + DATA_BYTES:
            return int(self._in_c.shadow[address - DATA])
        if address == WHO_AM_I:
            return self.kind.who_am_i
        if address == INT_STATUS:
            status, self._in_c.interrupt = int(self._in_c.interrupt), False
            return status
        if address not in self._registers and address not in _READ_ONLY:
            self.engine.fail(
                f"register 0x{address:02X} of the {self.kind.name} is read, which is not modelled"
            )
        return self._registers[address]

    def _write(self, address: int, value: int) -> None:
        known = self.kind.known.get(address)
        if known is None or value & ~known:
            self.engine.fail(
                f"register 0x{address:02X} of the {self.kind.name} = 0x{value:02X}: the model knows "
                f"{'none of it' if known is None else f'bits 0x{known:02X}'}"
            )
        if address == PWR_MGMT_1 and value & _DEVICE_RESET:
            self._clear()
            self._in_c.ready_at = self.engine.cycle + self.kind.reset_ms * _MILLISECOND
            self._ready_why = "its reset"
        elif address == SIGNAL_PATH_RESET:
            self._in_c.data = bytes(DATA_BYTES)  # the bits clear themselves
        elif address == USER_CTRL:
            self._registers[address] = value & ~0x01  # SIG_COND_RST clears itself
        else:
            self._registers[address] = value
        self._plan()

    def _plan(self) -> None:
        """Take over changed registers."""
        state = self._in_c
        state.gyro_shift = self.kind.full_scale - (self._registers[GYRO_CONFIG] >> 3 & 3)
        state.accel_shift = self.kind.full_scale - (self._registers[ACCEL_CONFIG] >> 3 & 3)
        awake = not self._registers[PWR_MGMT_1] & _SLEEP and not self._registers[PWR_MGMT_2] & 0x07
        if not awake or not self._registers[INT_ENABLE] & 1:
            state.due = NEVER
            self._sample_alarm.cancel()
            return
        self._validate_set_up()
        state.period = self._configured_period()
        if state.due == NEVER:
            state.due = self.engine.cycle + state.period + self.phase
            self._sample_alarm.set(state.due)
