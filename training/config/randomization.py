"""Domain randomization: the ranges that the aircraft of an episode are drawn from."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.arrays import Array
from neuroflight.sim.physics.variation import Variation
from neuroflight.toolchain.contract import MOTOR_COUNT_MAX

Range = tuple[float, float]
SAME: Range = (1.0, 1.0)
AS_DRAWN = ("charge", "vibration", "motors")  # see `draw_near`
LIMITS: dict[str, Range] = {"delay_s": (0.0, 0.1), "charge": (0.0, 1.0), "vibration_deg_s": (0.0, 1000.0)}


@dataclass(frozen=True)
class Randomization:
    """Least and greatest value of each parameter, drawn for every episode; factors log-uniformly."""

    mass: Range = SAME  # factor of the whole aircraft's
    inertia: Range = SAME  # likewise
    thrust: Range = SAME  # factor of every rotor's
    torque: Range = SAME  # factor of every rotor's drag torque at the same thrust
    speed: Range = SAME  # factor of rotor speed at the same command
    lag: Range = SAME  # factor of the rotors' time constant: 2 responds half as fast
    noise: Range = SAME  # factor of the gyro's noise and bias
    motors: Range = SAME  # factor of a rotor's thrust at the same command; each motor's is drawn apart
    delay_s: Range | None = None  # [s] from command to rotor; none: the aircraft's own
    charge: Range | None = None  # of the battery at the start, 0..1; none: the bench supply
    # Of the gyro's worst axis, by one rotor at full speed; none: the aircraft's own.
    vibration_deg_s: Range | None = None

    @property
    def active(self) -> bool:
        """True if any parameter varies."""
        return self != Randomization()

    def errors(self) -> Iterator[str]:
        """Yield errors of the ranges, one line each."""
        for field in fields(self):
            value: Range | None = getattr(self, field.name)
            low_end, high_end = LIMITS.get(field.name, (0.01, 100.0))
            if value is not None and not low_end <= value[0] <= value[1] <= high_end:
                yield (
                    f"randomization {field.name} {list(value)}, expected [least, greatest] "
                    f"within {low_end:g} to {high_end:g}"
                )

    def draw(self, count: int, rng: np.random.Generator, delay_s: float | Array) -> Variation:
        """Draw `count` aircraft; delay_s: the aircraft's own, or those of each (count,)."""

        def factor(bounds: Range) -> NDArray[np.float64]:
            return np.exp(rng.uniform(math.log(bounds[0]), math.log(bounds[1]), count))

        delay = (
            np.broadcast_to(delay_s, count).copy()
            if self.delay_s is None
            else rng.uniform(*self.delay_s, count)
        )
        charge = np.full(count, np.nan) if self.charge is None else rng.uniform(*self.charge, count)
        names = ("mass", "inertia", "thrust", "torque", "speed", "lag", "noise")
        factors = {name: factor(getattr(self, name)) for name in names}
        shaken = self.vibration_deg_s
        vibration = np.full(count, np.nan) if shaken is None else np.deg2rad(rng.uniform(*shaken, count))
        motors = np.ones((count, MOTOR_COUNT_MAX))
        if self.motors != SAME:
            low, high = (math.log(end) for end in self.motors)
            motors = np.exp(rng.uniform(low, high, motors.shape))
        return Variation(**factors, delay_s=delay, charge=charge, vibration=vibration, motors=motors)

    def draw_near(self, count: int, rng: np.random.Generator, delay_s: float | Array) -> Variation:
        """Draw `count` aircraft as `draw`, then bring each nearer to its file by a share of its own, 0..1.

        All deviations at their ends at once are rare then, as they are among real aircraft; a policy that
        must fly those corners as well as the middle flies the aircraft of the file by some percent worse.
        The battery's charge, which every flight goes through, stays as drawn, and so do the vibration and the
        differences between motors.
        """
        drawn, alike = self.draw(count, rng, delay_s), Variation.nominal(count, delay_s)
        share = rng.random(count)
        near = {
            field.name: getattr(alike, field.name)
            + share * (getattr(drawn, field.name) - getattr(alike, field.name))
            for field in fields(drawn)
            if field.name not in AS_DRAWN
        }
        return Variation(**near | {name: getattr(drawn, name) for name in AS_DRAWN})
