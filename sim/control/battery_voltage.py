"""A battery's voltage as the firmware's background hands it to the PID: in millivolts at the pin, low-passed.

float32 in the firmware's order of operations (housekeeping/battery.c), behind the host's converter
(hal/host/convert.c).
"""

from __future__ import annotations

import numpy as np

from neuroflight.sim.arrays import Array, Array32
from neuroflight.toolchain.contract import BATTERY_FILTER_S, BATTERY_RATE_HZ, SIM_VOLTS_SCALE

_PERIOD_S = np.float32(1.0) / np.float32(BATTERY_RATE_HZ)
_SHARE = _PERIOD_S / (_PERIOD_S + np.float32(BATTERY_FILTER_S))
_VOLTS_PER_MV = np.float32(0.001)
_SCALE = SIM_VOLTS_SCALE


class BatteryVoltage:
    """The voltages of N packs."""

    def __init__(self, control_rate_hz: int) -> None:
        self._every = max(1, control_rate_hz // BATTERY_RATE_HZ)
        self._filtered: Array32 | None = None

    def due(self, step: int) -> bool:
        """Return True if the packs are measured after control step number `step`, for the next steps."""
        return (step + 1) % self._every == 0

    def measure(self, voltage: Array) -> Array32:
        """Return the filtered voltages after one more measurement (N,) [V]; NaN stays for an unknown pack."""
        at_pin = np.rint(voltage / _SCALE * 1000.0).astype(np.float32)  # [mV]
        measured = at_pin * _VOLTS_PER_MV * np.float32(_SCALE)
        if self._filtered is None:
            self._filtered = measured
        self._filtered = self._filtered + _SHARE * (measured - self._filtered)
        return self._filtered
