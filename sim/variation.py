"""How each of N aircraft differs from its file: what domain randomization draws and robustness tables set."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Which = NDArray[np.intp] | slice


@dataclass(frozen=True, eq=False)
class Variation:
    """One value an aircraft, (N,) each; factors of what the file says unless a unit stands there."""

    mass: Array
    inertia: Array  # all moments of the whole aircraft about its centre of mass
    thrust: Array  # of every rotor at the same speed
    torque: Array  # drag torque of every rotor at the same thrust
    speed: Array  # of every rotor at the same command
    lag: Array  # time that the rotors take: 2 answers half as fast
    noise: Array  # of the gyro, white noise and bias
    delay_s: Array  # [s], command to rotor, rounded to whole samples, at least one
    charge: Array  # state of charge of the battery, 0..1; NaN: the bench supply

    @staticmethod
    def nominal(count: int, delay_s: float) -> Variation:
        """`count` aircraft as the file says, on the bench supply."""
        one = np.ones(count)
        return Variation(one, one, one, one, one, one, one, np.full(count, delay_s), np.full(count, np.nan))

    def at(self, which: Which) -> Variation:
        """Of the aircraft of `which` alone."""
        return Variation(*(getattr(self, field.name)[which] for field in fields(self)))
