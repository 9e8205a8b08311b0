"""Temperature of the motors' windings: heated by their resistance, cooled by the air around them.

    C dT/dt = R I^2 - (T - T_ambient) / R_th

with the time constant R_th C of the aircraft file's [esc.thermal]. I is the current that a motor draws from
the supply, so R is the resistance as seen from there. Each step is exact for a constant current.
"""

from __future__ import annotations

import math

import numpy as np

from neuroflight.sim.aircraft.model import Thermal
from neuroflight.sim.arrays import Array, Indices


class Heat:
    """Windings of N aircraft with M motors."""

    def __init__(self, thermal: Thermal, shape: tuple[int, int], dt: float) -> None:
        """Start at ambient; shape: N, M; dt: of a step [s]."""
        self._thermal = thermal
        self._share = -math.expm1(-dt / thermal.time_constant)  # of the way that a step goes
        self.temperature = np.full(shape, thermal.ambient)  # [degC], (N, M)

    def reset(self, index: Indices) -> None:
        """Cool the motors of the aircraft of `index` to ambient."""
        self.temperature[index] = self._thermal.ambient

    def step(self, current: Array) -> None:
        """Advance by `dt` with the current of each motor [A], (N, M)."""
        heating = self._thermal.winding_resistance * self._thermal.thermal_resistance * current * current
        self.temperature += self._share * (self._thermal.ambient + heating - self.temperature)
