"""The gyro chip with its state in C: see `sim.board.native.callbacks`.

Samples and reads of data are C's while they are plain: at full scale, and nobody else waits for a sample. The
rest, as configuring the chip, is its parent's.
"""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Callable
from ctypes import c_int16, c_uint8, c_uint32, c_uint64
from typing import TYPE_CHECKING, Any

from sim.board.core.context import Context
from sim.board.devices.gyro_chip import (
    ACCEL_CONFIG,
    DATA_BYTES,
    FULL_SCALE,
    GYRO_CONFIG,
    MPU6500,
    PULSE,
    Counts,
    GyroChip,
    GyroKind,
)
from sim.board.peripherals.gpio import Pins

if TYPE_CHECKING:
    from sim.board.native.callbacks import Hot

_NEVER = 2**64 - 1
_NO_ADDRESS = 0xFFFFFFFF
_VALUES = struct.Struct("=7h")


class _State(ctypes.Structure):
    """`struct gyro` of native.h."""

    _fields_ = (
        *((name, c_uint64) for name in ("due", "period", "samples", "ready_at")),
        *((name, c_uint32) for name in ("address", "transaction")),
        ("measured", c_int16 * 7),
        *((name, c_uint8 * DATA_BYTES) for name in ("data", "shadow")),
        *((name, c_uint8) for name in ("interrupt", "reads", "selected")),
    )


def _number(name: str) -> Any:  # noqa: ANN401 - a property
    def get(chip: HotGyroChip) -> int:
        return int(getattr(chip.in_c, name))

    def put(chip: HotGyroChip, value: int) -> None:
        setattr(chip.in_c, name, value)

    return property(get, put)


def _flag(name: str) -> Any:  # noqa: ANN401
    def get(chip: HotGyroChip) -> bool:
        return bool(getattr(chip.in_c, name))

    def put(chip: HotGyroChip, value: bool) -> None:
        setattr(chip.in_c, name, value)

    return property(get, put)


def _optional(name: str, none: int) -> Any:  # noqa: ANN401
    def get(chip: HotGyroChip) -> int | None:
        value = int(getattr(chip.in_c, name))
        return None if value == none else value

    def put(chip: HotGyroChip, value: int | None) -> None:
        setattr(chip.in_c, name, none if value is None else value)

    return property(get, put)


def _bytes(name: str) -> Any:  # noqa: ANN401
    def get(chip: HotGyroChip) -> bytes:
        return bytes(getattr(chip.in_c, name))

    def put(chip: HotGyroChip, value: bytes) -> None:
        getattr(chip.in_c, name)[:] = value

    return property(get, put)


class HotGyroChip(GyroChip):
    """One chip whose state is C's."""

    samples = _number("samples")
    transaction = _number("transaction")  # the bus's that the chip knows of
    _period = _number("period")
    _ready_at = _number("ready_at")
    _due = _optional("due", _NEVER)
    _address = _optional("address", _NO_ADDRESS)
    _interrupt = _flag("interrupt")
    _reads = _flag("reads")
    _selected = _flag("selected")
    _data = _bytes("data")
    _shadow = _bytes("shadow")

    def __init__(self, context: Context, pins: Pins, kind: GyroKind = MPU6500) -> None:
        self._hot: Hot | None = None
        self.in_c = _State(due=_NEVER, address=_NO_ADDRESS)
        self._place = ctypes.addressof(self.in_c) + _State.measured.offset
        self._buffer: Any = (ctypes.c_char * _VALUES.size).from_address(self._place)
        self._heard: Callable[[int], None] | None = None
        self._silent = False
        self._bit_errors = False
        super().__init__(context, pins, kind)

    def adopt(self, hot: Hot) -> None:
        """From now on the state is in C's memory."""
        library, handle = hot.library, hot.handle
        place = library.hot_gyro_state(handle)
        ctypes.memmove(place, ctypes.addressof(self.in_c), ctypes.sizeof(_State))
        self.in_c = _State.from_address(place)
        self._buffer = (ctypes.c_char * _VALUES.size).from_address(place + _State.measured.offset)
        alarms = hot.engine.alarms
        library.hot_gyro(
            handle, alarms["gyro.sample"].number, alarms["gyro.fall"].number, PULSE, float(self.kind.data_hz)
        )
        self._hot = hot
        self._judge_plain()

    def measure(self, accel: Counts, temperature: int, gyro: Counts) -> None:
        _VALUES.pack_into(self._buffer, 0, *accel, temperature, *gyro)

    @property
    def _measured(self) -> tuple[int, int, int, int, int, int, int]:  # type: ignore[override]
        a, b, c, d, e, f, g = _VALUES.unpack(self._buffer)
        return a, b, c, d, e, f, g

    @_measured.setter
    def _measured(self, values: tuple[int, int, int, int, int, int, int]) -> None:
        _VALUES.pack_into(self._buffer, 0, *values)

    # What makes samples and answers Python's

    @property
    def before_sample(self) -> Callable[[int], None]:  # type: ignore[override]
        """May call `measure`; gets the number of the sample."""
        return self._heard or (lambda number: None)

    @before_sample.setter
    def before_sample(self, callback: Callable[[int], None]) -> None:
        # The first one is the parent's, which does nothing.
        self._heard = callback if self._hot is not None else None
        self._judge_plain()

    @property
    def silent(self) -> bool:  # type: ignore[override]
        """No data-ready pulses, as injected by a fault campaign."""
        return self._silent

    @silent.setter
    def silent(self, silent: bool) -> None:
        self._silent = silent
        self._judge_plain()

    def errors_on_the_bus(self, any_: bool) -> None:
        """Whether bits that the chip sends may arrive wrong."""
        self._bit_errors = any_
        self._judge_plain()

    def _plan(self) -> None:
        super()._plan()
        self._judge_plain()

    def restore(self, state: Any) -> None:  # noqa: ANN401
        super().restore(state)
        self._judge_plain()

    def _judge_plain(self) -> None:
        if self._hot is None:
            return
        scales = (self._registers[GYRO_CONFIG] >> 3 & 3, self._registers[ACCEL_CONFIG] >> 3 & 3)
        samples = scales == (FULL_SCALE, FULL_SCALE) and self._heard is None and not self._silent
        self._hot.library.hot_gyro_plain(self._hot.handle, samples, not self._bit_errors)
