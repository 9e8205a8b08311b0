"""A battery's voltage as the firmware's background hands it to the PID: sampled and low-passed; battery.c."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from toolchain.contract import BATTERY_FILTER_S, BATTERY_RATE_HZ

Array = NDArray[np.float64]
_PERIOD_S = 1.0 / BATTERY_RATE_HZ
_SHARE = _PERIOD_S / (_PERIOD_S + BATTERY_FILTER_S)


class BatteryVoltage:
    """The voltages of N packs."""

    def __init__(self, control_rate_hz: int) -> None:
        self._every = max(1, control_rate_hz // BATTERY_RATE_HZ)
        self._filtered: Array | None = None

    def due(self, step: int) -> bool:
        """Whether the packs are measured at control step number `step`."""
        return step % self._every == 0

    def measure(self, voltage: Array) -> Array:
        """The filtered voltages after one more measurement (N,) [V]; NaN stays where a pack is not known."""
        if self._filtered is None:
            self._filtered = voltage.copy()
        self._filtered += _SHARE * (voltage - self._filtered)
        return self._filtered.copy()
