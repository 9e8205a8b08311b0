"""The mean moment that an aircraft's motors have to hold against, and the centre of mass that makes it.

Weight off centre and a weak motor make moments that grow alike with the thrust, and a controller cannot tell
them apart: both are said as the place of the centre of mass that flies so with equal motors.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from neuroflight.sim.arrays import Array
from neuroflight.sim.identification.fit.estimate import Data, Estimate, Wiring, say
from neuroflight.sim.identification.fit.model import Layout, shaped
from neuroflight.sim.identification.fit.result import Parameter
from neuroflight.sim.physics.rotor import thrust_and_torque
from neuroflight.toolchain.contract import AXES

NORMAL = 1.96
TOLD = 0.02  # of the arm: half of an interval of the centre, from which a log does not tell it
BLOCK_S = 1.0


def standing(data: Sequence[Data], laid: Layout, found: Estimate, wiring: Wiring) -> list[Parameter]:
    """Report the centre of mass by the motors' mean thrust, and the angular acceleration that stays."""
    values = laid.values(found.theta)
    against: list[Array] = []
    pushed: list[Array] = []
    places = data[0].model.aircraft.rotor_positions[list(wiring.order), :2]
    for one in data:
        said, speeds, _ = say(one.model, values, wiring)
        finer, step = one.model.finer, one.model.piece.step_s
        rows = said[: len(said) // finer * finer].reshape(-1, finer, 3).sum(axis=1) / step
        change = np.diff(one.model.piece.gyro, axis=0)[: len(rows)] / step
        used = one.used[1 : len(rows) + 1]
        propulsion = shaped(one.model.aircraft.propulsion, values)
        thrust = thrust_and_torque(np.ascontiguousarray(speeds), propulsion)[0][::finer][1 : len(rows) + 1]
        count = max(1, int(used.sum()) // max(1, round(BLOCK_S / step)))
        against += [part.mean(axis=0) for part in np.array_split((change - rows)[used], count)]
        sums = np.column_stack([thrust @ places, thrust.sum(axis=1)])
        pushed += [part.mean(axis=0) for part in np.array_split(sums[used], count)]
    return [*_centre(np.array(pushed), float(np.abs(places).max())), *_steady(np.array(against))]


def _centre(sums: Array, arm: float) -> list[Parameter]:
    """Report where thrust pushes on average, by blocks of thrust times place, and thrust (B, 3)."""
    lift = sums[:, 2].mean()
    centre = sums[:, :2].mean(axis=0) / lift
    left = (sums[:, :2] - centre * sums[:, 2:]) / lift
    sigma = left.std(axis=0) / np.sqrt(max(1, len(sums) / 2))  # blocks beside each other err alike
    return [
        Parameter(
            f"centre.{name}",
            f"centre of mass, {words}, weak motors in it",
            "m",
            0.0,
            float(middle),
            float(middle - NORMAL * s),
            float(middle + NORMAL * s),
            bool(NORMAL * s < TOLD * arm),
            f"mean thrust of the motors over {len(sums)} s",
            "a minute of calm hover",
        )
        for name, words, middle, s in zip(("x", "y"), ("forward", "left"), centre, sigma, strict=True)
    ]


def _steady(each: Array) -> list[Parameter]:
    sigma = each.std(axis=0) / np.sqrt(max(1, len(each) / 2))
    return [
        Parameter(
            f"steady.{name}",
            f"steady {name} that motors hold against",
            "rad/s²",
            0.0,
            float(mean),
            float(mean - NORMAL * s),
            float(mean + NORMAL * s),
            True,
            f"mean over {len(each)} s",
        )
        for name, mean, s in zip(AXES, each.mean(axis=0), sigma, strict=True)
    ]
