"""The gyro's filters before N controllers: notches at rotors' turns, and the mean of a control period.

The gyro runs faster than the controllers: the NF1's four times. One sample in four has twice the noise of
the mean of four, which comes three eighths of a control period late. The notches are the firmware's C; the
mean is float32, as gyro_mean.c.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from neuroflight.sim.arrays import Array32, Which
from neuroflight.sim.control.library import library
from neuroflight.toolchain.contract import GYRO_RATE_DEFAULT_HZ
from neuroflight.toolchain.policy.gyro_filters import GyroFilters, RpmFilter


def samples_per_step(filters: GyroFilters, control_rate_hz: int) -> int:
    """Return the gyro samples in a control period of a batch: as many as the filters take, otherwise one."""
    return max(1, GYRO_RATE_DEFAULT_HZ // control_rate_hz) if filters.every_sample else 1


class GyroFilter:
    """The filters of N gyros."""

    def __init__(
        self, filters: GyroFilters, count: int, motors: int, control_rate_hz: int, samples: int
    ) -> None:
        """Begin with rotors at rest; samples: of the gyro in a control period, each of which is added.

        Raises BuildError, one line, if the notches find no C compiler.
        """
        self._last = np.zeros((samples if filters.mean else 1, count, 3), np.float32)  # the oldest first
        self._share = np.float32(1.0 / len(self._last))
        self._fresh = np.ones(count, bool)
        self._everyone = np.arange(count)
        self._speed = np.zeros((count, motors), np.float32)
        rpm = filters.rpm
        self._notches = None if rpm is None else _Notches(rpm, count, motors, samples * control_rate_hz)

    def reset(self, index: Which) -> None:
        """Let the next sample of the aircraft of `index` be their first; their rotors stand.

        The mean is as if it had been there before.
        """
        self._fresh[index] = True
        self._speed[index] = 0.0
        if self._notches is not None:
            self._notches.reset(self._everyone[index])

    def told(self, rotor_speed: Array32) -> None:
        """Take the rotors' speeds (N, M) [rad/s] as ESCs tell them, before a control step's sample."""
        self._speed[:] = rotor_speed

    def add(self, rate: Array32, which: Which = slice(None)) -> None:
        """Add a sample (K, 3) [rad/s] of the gyros of `which`."""
        if self._notches is not None:
            rate = self._notches.step(self._everyone[which], self._speed[which], rate)
        last = self._last[:, which]
        last[:-1] = last[1:]
        last[-1] = rate
        fresh = self._fresh[which]
        if fresh.any():
            last[:, fresh] = rate[fresh]
            self._fresh[which] = False
        self._last[:, which] = last

    def add_all(self, rates: Array32) -> None:
        """Add samples (S, N, 3) [rad/s] of all gyros in turn, the oldest first."""
        if self._notches is None and len(rates) >= len(self._last):
            self._last[:] = rates[-len(self._last) :]
            self._fresh[:] = False
            return
        for rate in rates:
            self.add(rate)

    def read(self, which: Which = slice(None)) -> Array32:
        """Compute what the controllers of `which` see, (K, 3) [rad/s]."""
        total = self._last[0, which]
        for sample in self._last[1:]:
            total = total + sample[which]
        mean: Array32 = total * self._share
        return mean


class _Notches:
    """The firmware's notches at rotors' turns."""

    def __init__(self, rpm: RpmFilter, count: int, motors: int, gyro_rate_hz: int) -> None:
        self._ffi, self._c = (found := library(motors)).ffi, found.lib
        self._memory = self._ffi.new("uint64_t[]", self._c.rpm_filters_size(count) // 8 + 1)
        self._filters = self._ffi.cast("struct rpm_filters *", self._memory)
        self._c.rpm_filters_init(self._filters, rpm.harmonics, rpm.min_hz, rpm.q, gyro_rate_hz)
        self.reset(np.arange(count))

    def reset(self, index: Any) -> None:  # noqa: ANN401 - numbers of aircraft
        self._c.rpm_filters_reset(self._filters, len(index), self._numbers(index))

    def step(self, index: Any, speed: Array32, rate: Array32) -> Array32:  # noqa: ANN401
        """Return the filtered sample (K, 3) of the aircraft with these numbers."""
        filtered = np.array(rate, np.float32, order="C")
        told = np.ascontiguousarray(speed, np.float32)
        self._c.rpm_filters_step(
            self._filters,
            len(index),
            self._numbers(index),
            self._ffi.from_buffer("float[]", told),
            self._ffi.from_buffer("float[]", filtered),
        )
        return filtered

    def _numbers(self, index: Any) -> Any:  # noqa: ANN401 - a pointer of cffi, which keeps them alive
        return self._ffi.from_buffer("int64_t[]", np.ascontiguousarray(index, np.int64))
