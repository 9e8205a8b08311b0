"""The gyro's white noise and its shaking by the rotors, from what is above all turning.

A rotor that is out of balance shakes the gyro with the square of its speed: the power of what is quicker
than the aircraft, over blocks of a flight, is a straight line over the rotors' speeds to the fourth. Where
it meets standing rotors is the white noise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from neuroflight.sim.arrays import Array
from neuroflight.sim.identification.fit.estimate import Data
from neuroflight.sim.identification.fit.model import shaped
from neuroflight.sim.identification.fit.result import Parameter
from neuroflight.toolchain.contract import AXES

BLOCK_S = 0.25
QUICK = 0.3  # of half the rows' rate: above it nothing of an aircraft's turning is left
FLOOR = 0.05  # of the least block's power, that white noise has at least
CLEAR = 4.0  # standard deviations, from which rotors are said to shake


def shaking(
    data: Sequence[Data], values: Mapping[str, float], rate_hz: float, start: Array, raw: bool
) -> list[Parameter]:
    """Report white noise and shaking [deg/s] about each axis.

    rate_hz: rows a second of the log; start: noise and vibration (2, 3) [deg/s] of the start file; raw: the
    gyro was logged before its filters.
    """
    power, shaken = _blocks(data, values)
    merged = max(1, round(data[0].model.piece.step_s * rate_hz))
    rows = []
    for axis, name in enumerate(AXES):
        (floor, slope), sure = _line(shaken, power[:, axis])
        noise = float(np.rad2deg(np.sqrt(floor * merged / (1.0 - QUICK))))
        shakes = float(np.rad2deg(np.sqrt(slope)))
        wide = 1.0 / max(2.0, sure)  # relative standard deviation; that of an amplitude is half of a power's
        rows += [
            Parameter(
                f"gyro.noise.{name}", f"white noise of the gyro, {name}", "deg/s", float(start[0, axis]),
                noise, 0.85 * noise, 1.15 * noise, raw, "gyro above all turning",
                "log the unfiltered gyro (gyroUnfilt)",
            ),
            Parameter(
                f"gyro.vibration.{name}", f"shaking by a rotor at full speed, {name}", "deg/s",
                float(start[1, axis]), shakes, shakes * (1.0 - wide), shakes * (1.0 + wide),
                raw and sure > CLEAR, "gyro above all turning, over the rotors' speeds",
                "log the unfiltered gyro (gyroUnfilt), and a punch-out",
            ),
        ]  # fmt: skip
    return rows


def _blocks(data: Sequence[Data], values: Mapping[str, float]) -> tuple[Array, Array]:
    """Return the power (B, 3) [(rad/s)^2] of what is quick, and half the sum (B,) of rotors' (w / top)^4."""
    powers, shaken = [], []
    for one in data:
        model, step = one.model, one.model.piece.step_s
        top = sum(shaped(model.aircraft.propulsion, values).speed_curve)
        spectrum = np.fft.rfft(model.piece.gyro, axis=0)
        spectrum[: round(QUICK * len(spectrum))] = 0.0
        quick = np.fft.irfft(spectrum, len(model.piece.gyro), axis=0) ** 2
        turns = 0.5 * ((model.speeds(values)[:: model.finer] / top) ** 4).sum(axis=1)
        size = max(2, round(BLOCK_S / step))
        count = min(len(turns), len(quick)) // size
        whole = one.used[: count * size].reshape(count, size).all(axis=1)
        powers.append(quick[: count * size].reshape(count, size, 3).mean(axis=1)[whole])
        shaken.append(turns[: count * size].reshape(count, size).mean(axis=1)[whole])
    return np.concatenate(powers), np.concatenate(shaken)


def _line(at: Array, power: Array) -> tuple[tuple[float, float], float]:
    """Fit a line whose scatter grows with its height: height at 0 and slope, and the slope over its doubt."""
    least = FLOOR * float(np.quantile(power, 0.02))
    floor, slope, sure = float(np.median(power)), 0.0, 0.0
    columns = np.column_stack([np.ones(len(at)), at])
    for _ in range(6):
        weight = 1.0 / (floor + slope * at) ** 2
        inverse = np.linalg.inv(columns.T @ (weight[:, None] * columns))
        floor, slope = (inverse @ (columns.T @ (weight * power))).tolist()
        if floor < least:
            floor, slope = least, float((weight * at) @ (power - least) / ((weight * at) @ at))
        if slope < 0.0:
            floor, slope = float(np.average(power, weights=weight)), 0.0
        left = power - floor - slope * at
        sure = slope / float(np.sqrt(inverse[1, 1] * np.average(left**2 * weight)))
    return (floor, slope), sure
