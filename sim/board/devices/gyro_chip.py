"""The gyro chip behind SPI1: MPU6500 or ICM20689, as a register file with its times and limits.

The loop says what the sensors measure; at each sample time the chip latches that into its data registers and
pulses its data-ready line. Registers that the chip has but the model does not know are errors, so that a
configuration is never taken for done. Sources: MPU-6500 product specification (PS-MPU-6500A-01) and register
map (RM-MPU-6500A-00), ICM-20689 data sheet (DS-000143).
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from sim.board.core.context import TIME_HZ, Context
from sim.board.peripherals.gpio import Pins
from toolchain.contract import ACCEL_COUNTS, ACCEL_FULL_SCALE_G, GRAVITY, GYRO_COUNTS, GYRO_FULL_SCALE_DEG_S

CS, READY = "PC2", "PC3"

SMPLRT_DIV, CONFIG, GYRO_CONFIG, ACCEL_CONFIG, ACCEL_CONFIG2 = 0x19, 0x1A, 0x1B, 0x1C, 0x1D
INT_PIN_CFG, INT_ENABLE, INT_STATUS, DATA = 0x37, 0x38, 0x3A, 0x3B
SIGNAL_PATH_RESET, USER_CTRL, PWR_MGMT_1, PWR_MGMT_2, WHO_AM_I = 0x68, 0x6A, 0x6B, 0x6C, 0x75
DATA_BYTES = 14  # accelerometer, temperature, gyro: 16 bits each, the upper byte first

_DATA = struct.Struct(">7h")
_READ = 0x80
_DEVICE_RESET, _SLEEP = 0x80, 0x40  # PWR_MGMT_1
_MILLISECOND = TIME_HZ // 1000
_DEGREES = 180.0 / math.pi
PULSE = TIME_HZ // 20_000  # data-ready line: 50 us
REGISTER_HZ = 1_000_000  # SCK at most, all registers
FULL_SCALE = 3  # GYRO_CONFIG FS_SEL and ACCEL_CONFIG AFS_SEL of the counts that the loop sets

# Registers that the image may write, and the bits of each that the model knows.
_WRITABLE = {
    SMPLRT_DIV: 0xFF,
    CONFIG: 0x07,
    GYRO_CONFIG: 0x18,
    ACCEL_CONFIG: 0x18,
    ACCEL_CONFIG2: 0x0F,
    INT_PIN_CFG: 0x10,
    INT_ENABLE: 0x01,
    SIGNAL_PATH_RESET: 0x07,
    USER_CTRL: 0x11,
    PWR_MGMT_1: 0xC7,
    PWR_MGMT_2: 0x3F,
}
_READABLE = {*_WRITABLE, INT_STATUS, WHO_AM_I, *range(DATA, DATA + DATA_BYTES)}


@dataclass(frozen=True)
class GyroKind:
    """What the chips differ in."""

    name: str
    who_am_i: int
    data_hz: int  # SCK at most while data and interrupt registers are read
    power_management: int  # PWR_MGMT_1 after reset
    start_ms: int  # from power to answers, at most (specification: 11 typical)
    reset_ms: int = 100  # from DEVICE_RESET to answers (register map, PWR_MGMT_1)


MPU6500 = GyroKind("MPU6500", 0x70, 20_000_000, 0x01, 100)
ICM20689 = GyroKind("ICM20689", 0x98, 8_000_000, 0x41, 100)


class Alignment(IntEnum):
    """How the chip is turned on the board, clockwise seen from above."""

    CW0 = 0
    CW90 = 1
    CW180 = 2
    CW270 = 3


# Chip axis i is body axis (x forward, y left, z up) number `_AXES[i]` times `_SIGNS[i]`.
_AXES = {
    Alignment.CW0: (0, 1, 2),
    Alignment.CW90: (1, 0, 2),
    Alignment.CW180: (0, 1, 2),
    Alignment.CW270: (1, 0, 2),
}
_SIGNS = {
    Alignment.CW0: (1.0, 1.0, 1.0),
    Alignment.CW90: (-1.0, 1.0, 1.0),
    Alignment.CW180: (-1.0, -1.0, 1.0),
    Alignment.CW270: (1.0, -1.0, 1.0),
}

Counts = tuple[int, int, int]


def gyro_counts(rates: Sequence[float], alignment: Alignment) -> Counts:
    """Counts on the chip's axes at +-2000 deg/s of body rates (3,) [rad/s]: half to even, clamped to int16.

    The same arithmetic in the same order as the host build's, so that both see the same counts.
    """
    scaled = [rate * _DEGREES * GYRO_COUNTS / GYRO_FULL_SCALE_DEG_S for rate in rates]
    return _mounted(scaled, alignment, 1.0)


def accel_counts(force: Sequence[float], alignment: Alignment) -> Counts:
    """Counts on the chip's axes at +-16 g of specific force (3,) [m/s^2], body axes."""
    return _mounted(force, alignment, ACCEL_COUNTS / ACCEL_FULL_SCALE_G / GRAVITY)


def _mounted(vector: Sequence[float], alignment: Alignment, scale: float) -> Counts:
    (i, j, k), (a, b, c) = _AXES[alignment], _SIGNS[alignment]
    x, y, z = round(a * vector[i] * scale), round(b * vector[j] * scale), round(c * vector[k] * scale)
    if not (-32768 <= x <= 32767 and -32768 <= y <= 32767 and -32768 <= z <= 32767):
        x, y, z = (max(-32768, min(32767, value)) for value in (x, y, z))
    return x, y, z


class GyroChip:
    """One chip, powered since cycle 0; a reset of the board's processor does not reset it."""

    def __init__(self, context: Context, pins: Pins, kind: GyroKind = MPU6500) -> None:
        self.context, self.kind = context, kind
        self._pins = pins
        self.before_sample: Callable[[int], None] = lambda number: None  # may call `measure`
        self.watches_fall: Callable[[], bool] = lambda: True
        self.phase = 0  # by how much later its samples begin: its clock is its own [cycles]
        self.silent = False  # no data-ready pulses, as injected by a fault campaign
        self._sample_alarm = context.alarm("gyro.sample", self._sample)
        self._fall_alarm = context.alarm("gyro.fall", lambda: pins.drive(READY, False))
        self._powered_at = 0
        self._due: int | None = None  # cycle of the next sample
        self._period = 0  # between samples [cycles]
        self._start()
        pins.watch(CS, self.select)
        self.rest()

    def rest(self) -> None:
        """The lines at rest: select by the board's pull-up, nothing ready."""
        self._pins.drive(CS, True)
        self._pins.drive(READY, False)

    def processor_reset(self) -> None:
        """The processor was reset and with it all alarms: the chip goes on."""
        self._fall_alarm.cancel()
        self._pins.drive(READY, False)
        if self._due is not None:
            self._sample_alarm.set(self._due)

    def power_on(self) -> None:
        """The supply comes back after it was gone."""
        self._powered_at = self.context.cycle
        self._due = None
        self._sample_alarm.cancel()
        self._fall_alarm.cancel()
        self._start()
        self._pins.drive(READY, False)

    def _start(self) -> None:
        self.samples = 0  # taken since power-up
        self._measured = (0,) * 7  # accelerometer, temperature, gyro
        self._ready_at = self._powered_at + self.kind.start_ms * _MILLISECOND
        self._ready_why = "power-up"
        self._selected = False
        self._address: int | None = None  # of the next byte; None: the next byte is an address
        self._reads = False
        self._shadow = bytes(DATA_BYTES)  # data registers as the transaction under way sees them
        self._clear()

    def _clear(self) -> None:
        self._registers = dict.fromkeys(_WRITABLE, 0)
        self._registers[PWR_MGMT_1] = self.kind.power_management
        self._data = bytes(DATA_BYTES)
        self._interrupt = False

    # For the loop

    def measure(self, accel: Counts, temperature: int, gyro: Counts) -> None:
        """What the sensors measure from now on: int16 counts on the chip's axes, +-16 g and +-2000 deg/s."""
        self._measured = (*accel, temperature, *gyro)

    @property
    def next_sample(self) -> int | None:
        """The cycle of the next sample and data-ready pulse; None: the chip is not set up to give any."""
        return self._due

    def _configured_period(self) -> int:
        """Cycles between samples."""
        filtered = self._registers[CONFIG] & 7
        if filtered in (0, 7):
            return TIME_HZ // 8000  # whatever the divider says
        return TIME_HZ // 1000 * (1 + self._registers[SMPLRT_DIV])

    # On the bus

    @property
    def selected(self) -> bool:
        """Whether its select line is low."""
        return self._selected

    def exchange(self, sent: Sequence[int], hz: float, mode: int) -> list[int] | None:
        """Bytes of a transaction (sim.board.peripherals.spi.SpiSlave)."""
        if not self._selected:
            return None
        if mode not in (0, 3):
            self.context.fail(f"the {self.kind.name} is addressed in SPI mode {mode}, expected 0 or 3")
        if self._address is None and len(sent) > 2:
            first = self._byte(sent[0], hz)
            rest = len(sent) - 1
            assert self._address is not None
            place = self._address - DATA
            if self._reads and 0 <= place <= DATA_BYTES - rest:
                self._judge_clock(hz)
                self._address += rest
                return [first, *self._shadow[place : place + rest]]
            return [first, *(self._byte(value, hz) for value in sent[1:])]
        return [self._byte(value, hz) for value in sent]

    def _byte(self, value: int, hz: float) -> int:
        if self._address is None:
            self._address, self._reads = value & ~_READ, bool(value & _READ)
            self._shadow = self._data
            self._judge_time()
            self._judge_clock(hz)
            return 0
        address = self._address
        self._judge_clock(hz)
        self._address = address + 1 & 0x7F
        if self._reads:
            return self._read(address)
        self._write(address, value)
        return 0

    def select(self, level: bool) -> None:
        """The level of the chip's select line, low while it is spoken to."""
        self._judge_end()
        self._selected = not level
        self._address = None

    def _judge_end(self) -> None:
        """A transaction has ended: it has read whole values."""
        if not self._reads or self._address is None:
            return
        count = self._address - DATA
        if count & 1 and 0 < count < DATA_BYTES:
            self.context.fail(
                f"the data of the {self.kind.name} was read up to 0x{self._address - 1:02X}, the upper half "
                f"of a value; expected both its bytes in one transaction"
            )

    def _judge_time(self) -> None:
        if self.context.cycle < self._ready_at:
            left = (self._ready_at - self.context.cycle) / _MILLISECOND
            self.context.fail(
                f"the {self.kind.name} is addressed {left:.1f} ms before it answers after {self._ready_why}, "
                f"expected a wait"
            )

    def _judge_clock(self, hz: float) -> None:
        assert self._address is not None
        fast = self._reads and INT_STATUS <= self._address < DATA + DATA_BYTES
        limit = self.kind.data_hz if fast else REGISTER_HZ
        if hz > limit:
            what = "data" if fast else f"register 0x{self._address:02X}"
            self.context.fail(
                f"SPI1 reads or writes {what} of the {self.kind.name} at {hz / 1e6:g} MHz, expected "
                f"{limit / 1e6:g} MHz at most"
            )

    def _read(self, address: int) -> int:
        if DATA <= address < DATA + DATA_BYTES:
            return self._shadow[address - DATA]
        if address == WHO_AM_I:
            return self.kind.who_am_i
        if address == INT_STATUS:
            self._interrupt, status = False, int(self._interrupt)
            return status
        if address not in _READABLE:
            self.context.fail(
                f"register 0x{address:02X} of the {self.kind.name} is read, which is not modelled"
            )
        return self._registers[address]

    def _write(self, address: int, value: int) -> None:
        known = _WRITABLE.get(address)
        if known is None or value & ~known:
            self.context.fail(
                f"register 0x{address:02X} of the {self.kind.name} = 0x{value:02X}: the model knows "
                f"{'none of it' if known is None else f'bits 0x{known:02X}'}"
            )
        if address == PWR_MGMT_1 and value & _DEVICE_RESET:
            self._clear()
            self._ready_at = self.context.cycle + self.kind.reset_ms * _MILLISECOND
            self._ready_why = "its reset"
        elif address == SIGNAL_PATH_RESET:
            self._data = bytes(DATA_BYTES)  # the bits clear themselves
        elif address == USER_CTRL:
            self._registers[address] = value & ~0x01  # SIG_COND_RST clears itself
        else:
            self._registers[address] = value
        self._plan()

    # Samples

    def _plan(self) -> None:
        awake = not self._registers[PWR_MGMT_1] & _SLEEP and not self._registers[PWR_MGMT_2] & 0x07
        if not awake or not self._registers[INT_ENABLE] & 1:
            self._due = None
            self._sample_alarm.cancel()
            return
        self._period = self._configured_period()
        if self._due is None:
            self._due = self.context.cycle + self._period + self.phase
            self._sample_alarm.set(self._due)

    def _sample(self) -> None:
        assert self._due is not None
        now = self._due  # the core may have been in the middle of an instruction then
        self._due = now + self._period
        self._sample_alarm.set(self._due)
        self.before_sample(self.samples)
        self.samples += 1
        if self.silent:
            return
        self._latch()
        self._interrupt = True
        self._pins.pulse(READY)
        if self.watches_fall():
            self._fall_alarm.set(now + PULSE)

    def _latch(self) -> None:
        gyro_shift = FULL_SCALE - (self._registers[GYRO_CONFIG] >> 3 & 3)
        accel_shift = FULL_SCALE - (self._registers[ACCEL_CONFIG] >> 3 & 3)
        values: Sequence[int] = self._measured
        if gyro_shift or accel_shift:
            shifts = (*[accel_shift] * 3, 0, *[gyro_shift] * 3)
            scaled = (v << s for v, s in zip(self._measured, shifts, strict=True))
            values = [max(-32768, min(32767, v)) for v in scaled]
        self._data = _DATA.pack(*values)

    _KEPT = (
        "samples", "silent", "_measured", "_ready_at", "_ready_why", "_selected", "_address", "_reads",
        "_shadow", "_due", "_period", "_registers", "_data", "_interrupt", "_powered_at",
    )  # fmt: skip

    def state(self) -> Any:  # noqa: ANN401
        return {name: getattr(self, name) for name in self._KEPT} | {"_registers": dict(self._registers)}

    def restore(self, state: Any) -> None:  # noqa: ANN401
        for name in self._KEPT:
            setattr(self, name, state[name])
        self._registers = dict(state["_registers"])
