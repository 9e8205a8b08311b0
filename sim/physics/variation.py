"""Differences of N aircraft from their file: drawn by domain randomization, set by robustness tables."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from neuroflight.sim.arrays import Array, Which
from neuroflight.toolchain.contract import MOTOR_COUNT_MAX


@dataclass(frozen=True, eq=False)
class Variation:
    """One value an aircraft, (N,) each but for `motors`; factors of the file's value
    unless a unit is given.

    Raises ValueError on values that no aircraft can have.
    """

    mass: Array  # of the whole aircraft; its centre stays
    inertia: Array  # all moments of the whole aircraft about its centre of mass
    thrust: Array  # of every rotor at the same speed, and with it the drag torque
    torque: Array  # drag torque of every rotor at the same thrust
    speed: Array  # of every rotor at the same command
    lag: Array  # time that the rotors take: 2 answers half as fast
    noise: Array  # of the gyro, white noise and bias
    delay_s: Array  # [s], command to rotor, rounded to whole samples, at least one
    charge: Array  # state of charge of the battery, 0..1; NaN: the bench supply
    vibration: Array  # [rad/s], what one rotor at full speed shakes the gyro's worst axis by; NaN: the file's
    # (N, MOTOR_COUNT_MAX), of each rotor's thrust at the same command, by its speed; read as many
    # as the aircraft has motors.
    motors: Array

    def __post_init__(self) -> None:
        """Check shapes and ranges."""
        shape = self.mass.shape
        for field in fields(self):
            values: Array = getattr(self, field.name)
            expected_shape = (*shape, MOTOR_COUNT_MAX) if field.name == "motors" else shape
            if values.shape != expected_shape or len(shape) != 1:
                wanted = f"(N, {MOTOR_COUNT_MAX})" if field.name == "motors" else "(N,) as mass"
                raise ValueError(f"variation {field.name} has shape {values.shape}, expected {wanted}")
            if field.name == "vibration":
                fits, expected = ~((values < 0.0) | np.isinf(values)), "0 or more, or NaN for the file's"
            elif field.name == "charge":
                fits, expected = ~((values < 0.0) | (values > 1.0)), "0 to 1, or NaN for the bench supply"
            elif field.name in ("delay_s", "noise"):
                fits, expected = np.isfinite(values) & (values >= 0.0), "0 or more"
            else:
                fits, expected = np.isfinite(values) & (values > 0.0), "above 0"
            if not fits.all():
                raise ValueError(f"variation {field.name} is {values[~fits][0]}, expected {expected}")

    @staticmethod
    def nominal(count: int, delay_s: float | Array) -> Variation:
        """Return `count` aircraft as the file says, on the bench supply; delay_s: of all, or each (N,)."""
        one, own = np.ones(count), np.full(count, np.nan)
        motors = np.ones((count, MOTOR_COUNT_MAX))
        return Variation(
            one, one, one, one, one, one, one, np.broadcast_to(delay_s, count).copy(), own, own, motors
        )

    def __len__(self) -> int:
        """Return N, the number of aircraft."""
        return len(self.mass)

    def speeds(self, motors: int) -> Array:
        """Return factors (N, M) of the speed that each of M rotors settles at."""
        return self.speed[:, None] * np.sqrt(self.motors[:, :motors])

    def at(self, which: Which) -> Variation:
        """Return the rows of the aircraft of `which`."""
        return Variation(*(getattr(self, field.name)[which] for field in fields(self)))

    def changed(self, which: Which, other: Variation) -> Variation:
        """Return a copy with the rows of `which` replaced by those of `other`."""
        columns = []
        for field in fields(self):
            column: Array = getattr(self, field.name).copy()
            column[which] = getattr(other, field.name)
            columns.append(column)
        return Variation(*columns)
