"""Thrust and torque of a propeller that moves along its axis: [propulsion.advance_ratio] of an aircraft file.

The advance ratio J = V / (n D) compares the speed V [m/s] along the axis with the n revolutions a second of a
propeller of diameter D [m]. C_T and C_Q fall as J grows: the blades meet the air at a smaller angle.
Source: Koch 2019, list of symbols and chapter 5 (its own figures are of J = 0); UIUC Propeller Data Site.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from neuroflight.sim.arrays import Array
from neuroflight.toolchain.strict_toml import StrictTable

Terms = tuple[float, float]  # a1, a2 of 1 + a1 J + a2 J^2
RATIO_LAST = 3.0  # J beyond which no propeller of the UIUC Propeller Data Site was measured
FACTOR_MAX = 2.0  # propellers lose thrust with J; those that stall at rest gain some of it first
TERM_MAX = 20.0


@dataclass(frozen=True)
class AdvanceRatio:
    """Factors of thrust and drag torque at the same rotor speed, over those at J = 0."""

    thrust: Terms
    torque: Terms
    ratio_least: float = 0.0  # least J of the factors: below it the rotor sinks into its own wake

    @property
    def ratio_max(self) -> float:
        """J up to which the factors are used; beyond it they stay as they are there.

        It is where thrust ends: beyond that the propeller brakes as a windmill, which is not modelled. If the
        parabola of the thrust does not reach 0 but turns upwards, it is used up to its lowest point.
        """
        first, second = self.thrust
        roots = np.roots([second, first, 1.0]) if any(self.thrust) else np.empty(0)
        ends = [float(root.real) for root in roots if abs(root.imag) < 1e-9 and root.real > 0.0]
        if second > 0.0 and first < 0.0:
            ends.append(-0.5 * first / second)
        return min([*ends, RATIO_LAST])

    def factors(self, ratio: ArrayLike) -> tuple[Array, Array]:
        """Compute the factors of thrust and torque at advance ratios of any shape, as rotor.c does."""
        at = np.clip(np.asarray(ratio, np.float64), self.ratio_least, self.ratio_max)
        thrust, torque = (1.0 + (first + second * at) * at for first, second in (self.thrust, self.torque))
        return np.maximum(thrust, 0.0), np.maximum(torque, 0.0)


def read_advance(table: StrictTable) -> AdvanceRatio:
    """Read the table's coefficients. Raises the table's error, one line, for an impossible propeller."""
    thrust = _terms(table, "thrust")
    torque = _terms(table, "torque")
    least = table.number("ratio_least", -RATIO_LAST, 0.0, 0.0)
    advance = AdvanceRatio(thrust, torque, least)
    ratios = np.linspace(least, advance.ratio_max, 301)
    for key, values in zip(("thrust", "torque"), advance.factors(ratios), strict=True):
        worst = int(np.argmax(values))
        if values[worst] > FACTOR_MAX:
            raise table.error(
                key,
                f"got {list(getattr(advance, key))}, which makes {values[worst]:.3g} times the {key} of "
                f"J = 0 at J = {ratios[worst]:.3g}; expected at most {FACTOR_MAX:g}: most coefficients are "
                f"negative",
            )
    return advance


def _terms(table: StrictTable, key: str) -> Terms:
    first, second = table.numbers(key, 2, 2, -TERM_MAX, TERM_MAX)
    return first, second
