"""Choice of a reading of the sticks by the gyro: an aircraft that follows its commands shows what they were.

An aircraft in rate mode turns as it was told, some hundredths of a second later. So the gyro, regressed on
the commands of the right reading at the best lag, has a slope near 1; a wrong reading gives another slope,
or, where its curve is another one, a larger error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from neuroflight.sim.arrays import Array, Flags
from neuroflight.sim.blackbox.rates import RatesError, Reading

ASKED_DEG_S = 15.0  # smaller commands are not compared: the gyro's noise is as large
ASKED_ROWS_S = 0.2  # least duration of such commands on an axis
ROWS_MIN = 20
LAG_MAX_S = 0.12  # greatest lag of an aircraft behind its command
LAGS = 13  # number of lags that are tried
SLOPE = (0.7, 1.4)  # range of the gyro's slope on commands that it follows
ERROR_MOST = 0.5  # largest error over the mean size of commands that are followed
CLEARER = 1.3  # a reading is chosen if the next one's error is so many times as large
SAME, SAME_DEG_S = 0.03, 2.0  # readings agree within this part of the commands, or a step of our sticks


@dataclass(frozen=True)
class Fit:
    """The fit of the gyro to the commands of a reading, over the axes that are commanded to turn."""

    slope: tuple[float | None, ...]  # of the gyro on each axis' command; None: too little asked
    error: float  # mean of |gyro - command| over the mean of |command|

    @property
    def told(self) -> bool:
        """True if any axis was commanded to turn."""
        return any(one is not None for one in self.slope)

    @property
    def followed(self) -> bool:
        """True if the gyro follows the commands."""
        slopes = [one for one in self.slope if one is not None]
        return self.error <= ERROR_MOST and all(SLOPE[0] <= one <= SLOPE[1] for one in slopes)


def fit(commands: Array, gyro: Array, rows: Flags, rate_hz: float) -> Fit:
    """Fit gyro (N, 3) to commands (N, 3), both [deg/s], on these rows (N,), logged at `rate_hz`."""
    slopes: list[float | None] = []
    left = asked = 0.0
    for axis in range(3):
        found = _axis(commands[:, axis], gyro[:, axis], rows, rate_hz)
        slopes.append(None if found is None else found[0])
        if found is not None:
            left, asked = left + found[1], asked + found[2]
    return Fit(tuple(slopes), left / asked if asked else 0.0)


def choose(
    readings: Sequence[Reading],
    sticks: Array,
    gyro: Array | None,
    rows: Flags,
    rate_hz: float,
    *,
    told: bool = False,
) -> tuple[Reading, str]:
    """Return the reading that the gyro follows, and a note for the user ("": none).

    sticks (N, 3): rcCommand; rows (N,): True in flight and in rate mode; told: the user gave the rates, so a
    single reading is taken even if the gyro does not follow it. Raises RatesError where the gyro follows no
    reading, or several that differ.
    """
    if gyro is None or not rows.any() or not rate_hz:
        return _unproven(readings, sticks, "no row of it is a flight by rates with a gyro")
    fits = [fit(one.curve(sticks), gyro, rows, rate_hz) for one in readings]
    if not all(one.told for one in fits):
        return _unproven(readings, sticks, "too little was asked of the sticks")
    followed = sorted(
        ((one.error, reading) for one, reading in zip(fits, readings, strict=True) if one.followed),
        key=lambda pair: pair[0],
    )
    if not followed:
        nearest, reading = min(zip(fits, readings, strict=True), key=lambda pair: pair[0].error)
        slopes = ", ".join("-" if one is None else f"{one:.2f}" for one in nearest.slope)
        words = (
            f"the gyro does not follow the sticks by {reading.name}: on roll, pitch, yaw it turns {slopes} "
            f"times what they ask for, expected {SLOPE[0]:g} to {SLOPE[1]:g}"
        )
        if told and len(readings) == 1:
            return reading, words
        raise RatesError(words)
    error, best = followed[0]
    for other_error, other in followed[1:]:
        if other_error < CLEARER * error and _differ(best, other, sticks[rows]):
            raise RatesError(f"the gyro follows {_named(best)} as well as {_named(other)}")
    return best, ""


def _unproven(readings: Sequence[Reading], sticks: Array, why: str) -> tuple[Reading, str]:
    """Return the reading if there is one, or several with the same commands. Raises RatesError otherwise."""
    first = readings[0]
    for other in readings[1:]:
        if _differ(first, other, sticks):
            raise RatesError(
                f"its rates may be {' or '.join(_named(one) for one in readings)}, between which its gyro "
                f"does not decide: {why}"
            )
    return first, f"not held against the gyro: {why}"


def _named(reading: Reading) -> str:
    """Return the name of a reading, with the header line that chooses it."""
    return f"{reading.name} ({reading.choice})" if reading.choice else reading.name


def _differ(one: Reading, other: Reading, sticks: Array) -> bool:
    """Return True if two readings give different rates for these sticks."""
    commands = one.curve(sticks)
    apart = np.abs(commands - other.curve(sticks)).max(initial=0.0)
    return bool(apart > max(SAME_DEG_S, SAME * np.abs(commands).max(initial=0.0)))


def _axis(command: Array, gyro: Array, rows: Flags, rate_hz: float) -> tuple[float, float, float] | None:
    """Return slope, sum of |gyro - command| and sum of |command| at the best lag; None: too few commands."""
    best: tuple[float, float, float] | None = None
    for lag in sorted({round(part * LAG_MAX_S * rate_hz / (LAGS - 1)) for part in range(LAGS)}):
        if lag >= len(command):
            break
        end = len(command) - lag
        asked = rows[:end] & rows[lag:] & (np.abs(command[:end]) >= ASKED_DEG_S)
        if asked.sum() < max(ROWS_MIN, ASKED_ROWS_S * rate_hz):
            continue
        told, seen = command[:end][asked], gyro[lag:][asked]
        left, size = float(np.abs(seen - told).sum()), float(np.abs(told).sum())
        slope = float((seen * told).sum() / (told * told).sum())
        if best is None or left * best[2] < best[1] * size:
            best = (slope, left, size)
    return best
