"""A controller's holding over a flight of a minute: errors by the flight's age, and drift. Pure functions.

A policy whose memory winds up flies its first command well and its tenth badly, and turns on when the sticks
are centred; figures of single commands do not show it. A flight here is `commands` equal parts of a command
and rests, one after another, and then a hover: centred sticks to its end.

Axes last: roll, pitch, yaw. E is a number of flights, N one of commands.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from neuroflight.sim.analysis.confidence import Mean, mean_of
from neuroflight.sim.arrays import Array, Flags

SETTLED_S = 0.5  # after the sticks are centred: the aircraft rests, or should
FIFTHS = 5  # parts of the time before the hover, each with an error at rest
DRIFT_S = 10.0  # of the hover, its last part


@dataclass(frozen=True, eq=False)
class Holding:
    """Figures of each of E flights."""

    mae: Array  # (E, N, 3) [deg/s], of each command and the rests around it
    mse: Array  # (E, N, 3) [(deg/s)^2], likewise
    rest: Array  # (E, FIFTHS, 3) [deg/s], mean |rate| at rest, by age; NaN in a fifth without rest
    hover: Array  # (E, 3) [deg/s], mean |rate| of the hover's last DRIFT_S
    drift: Array  # (E, 3) [deg], turned in that time about each axis of the body

    @property
    def early(self) -> Array:
        """Error at rest in the first fifth, (E, 3) [deg/s]."""
        first: Array = self.rest[:, 0]
        return first

    @property
    def late(self) -> Array:
        """Error at rest in the last fifth, (E, 3) [deg/s]."""
        last: Array = self.rest[:, -1]
        return last


@dataclass(frozen=True)
class HoldingFigures:
    """Means over flights with their 95 % confidence."""

    mae: Mean  # (N,) [deg/s], of each command and the rests around it, mean of the axes
    mse: Mean  # (N,) [(deg/s)^2], likewise
    rest: Mean  # (FIFTHS, 3) [deg/s]
    hover: Mean  # (3,) [deg/s]
    drift: Mean  # (3,) [deg], of its size: drifts of either sign do not cancel


def holding(setpoint: ArrayLike, rate: ArrayLike, step_s: float, commands: int, before: int) -> Holding:
    """Compute the figures of flights.

    setpoint, rate: (E, T, 3) [rad/s], true, rows `step_s` apart; before: rows before the hover; commands: the
    equal parts of these, of which errors are told. Raises ValueError on a hover shorter than DRIFT_S, on one
    that is commanded, and on rows that do not divide.
    """
    wanted, flown = np.asarray(setpoint), np.asarray(rate)
    last = round(DRIFT_S / step_s)
    if wanted.shape[1] - before < last or before % commands:
        raise ValueError(
            f"{before} and {wanted.shape[1] - before} rows of {step_s:g} s: expected {commands} equal "
            f"commands, and a hover of at least {DRIFT_S:g} s"
        )
    if wanted[:, -last:].any():
        raise ValueError("the sticks are not centred in the hover")
    found: dict[str, list[Array]] = {"mae": [], "mse": [], "rest": [], "hover": [], "drift": []}
    for one, turned in zip(wanted, flown, strict=True):  # flight by flight, because float64 copies are large
        speed = np.rad2deg(turned, dtype=np.float64)
        error = np.abs(np.rad2deg(one, dtype=np.float64) - speed)
        parts = error[:before].reshape(commands, -1, 3)
        found["mae"].append(parts.mean(axis=1))
        found["mse"].append(np.square(parts).mean(axis=1))
        found["rest"].append(_rest(error[:before], settled(one[:before], step_s)))
        found["hover"].append(error[-last:].mean(axis=0))
        found["drift"].append(speed[-last:].sum(axis=0) * step_s)
    return Holding(**{name: np.array(each) for name, each in found.items()})


def holding_figures(each: Holding) -> HoldingFigures:
    """Average over the flights."""
    parts = {
        "mae": each.mae.mean(axis=2),
        "mse": each.mse.mean(axis=2),
        "rest": each.rest,
        "hover": each.hover,
        "drift": np.abs(each.drift),
    }
    return HoldingFigures(**{name: mean_of(values, np.isfinite(values)) for name, values in parts.items()})


def settled(setpoint: ArrayLike, step_s: float) -> Flags:
    """Return True for each row of setpoints (T, 3) at which all sticks have been centred for SETTLED_S."""
    steps = np.arange(len(np.asarray(setpoint)))
    moved = np.asarray(setpoint).any(axis=1)
    last = np.maximum.accumulate(np.where(moved, steps, -1))
    rested: Flags = steps - last > round(SETTLED_S / step_s)
    return rested


def _rest(error: Array, resting: Flags) -> Array:
    """Compute the mean error of the rows at rest in each fifth, (FIFTHS, 3)."""
    fifths = zip(np.array_split(error, FIFTHS), np.array_split(resting, FIFTHS), strict=True)
    return np.array([part[at].mean(axis=0) if at.any() else np.full(3, np.nan) for part, at in fifths])
