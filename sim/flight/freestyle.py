"""Sticks of a pilot's freestyle flight: cruising with small corrections, aerobatics in between.

No logs of pilots can be shipped, so this stands in for them: the sticks move as a hand does, in smooth
strokes at the receiver's 50 Hz, from rest to rest in each figure.
"""

from __future__ import annotations

import numpy as np

from neuroflight.sim.arrays import Array

FRAME_S = 0.02  # between two positions of the sticks
FLIGHT_S = 60.0
CRUISE_DEG_S = (8.0, 8.0, 10.0)  # standard deviation of the corrections: roll, pitch, yaw
CRUISE_S = 0.25  # their correlation time
BETWEEN_S = (1.0, 3.0)  # cruising between two figures
HOVER, SWING = 0.3, 0.08  # throttle of a cruise, and the standard deviation of its changes
# Name: strokes in turn, each with an axis, the angle [deg] that it turns and its length [s].
FIGURES: tuple[tuple[str, tuple[tuple[int, float, float], ...]], ...] = (
    ("roll", ((0, 360.0, 0.9),)),
    ("flip", ((1, -360.0, 0.9),)),
    ("Split-S", ((0, 180.0, 0.5), (1, -180.0, 0.8))),
    ("loop", ((1, -360.0, 1.5),)),
    ("turn", ((2, 90.0, 0.8),)),
    ("dive", ((1, 60.0, 0.5), (1, -60.0, 0.6))),
)


def stick_strokes(seed: int) -> tuple[Array, Array]:
    """Draw commanded rates [deg/s] in the body frame (N, 3) and throttle 0..1 (N,), a row each FRAME_S."""
    rng = np.random.default_rng(seed)
    frames = round(FLIGHT_S / FRAME_S)
    rates = _corrections(rng, frames)
    at = 0.0
    while True:
        at += float(rng.uniform(*BETWEEN_S))
        _, strokes = FIGURES[int(rng.integers(len(FIGURES)))]
        side = float(rng.choice((-1.0, 1.0)))
        if at + sum(length for _, _, length in strokes) > FLIGHT_S - 1.0:
            break
        for axis, angle, length in strokes:
            # Loops and dives keep their sign: a pilot pulls through.
            _stroke(rates, axis, angle if axis == 1 else side * angle, at, length)
            at += length
    throttle = np.clip(HOVER + SWING * _correlated(rng, frames, 1.0), 0.05, 0.9)
    return rates, throttle


def calm_strokes(seed: int, flight_s: float, sigma_deg_s: float) -> Array:
    """Draw commanded rates [deg/s] of a flight without aerobatics: normal, of that standard deviation.

    Body frame (N, 3), a row each FRAME_S. Source: Koch 2019, chapter 5, figure 5.15: the commands of its
    pilots over all flights are about normal with 12.4 deg/s.
    """
    return _corrections(np.random.default_rng(seed), round(flight_s / FRAME_S), (sigma_deg_s,) * 3)


def _corrections(
    rng: np.random.Generator, frames: int, sigmas: tuple[float, float, float] = CRUISE_DEG_S
) -> Array:
    """Draw small stick movements of a cruise [deg/s], (frames, 3)."""
    return np.column_stack([sigma * _correlated(rng, frames, CRUISE_S) for sigma in sigmas])


def _correlated(rng: np.random.Generator, frames: int, seconds: float) -> Array:
    """Draw normal noise with that correlation time, smooth from frame to frame, (frames,)."""
    width = round(4 * seconds / FRAME_S)
    window = np.hanning(width + 2)[1:-1]
    drawn = np.convolve(rng.standard_normal(frames + width - 1), window, mode="valid")
    found: Array = drawn / np.sqrt(np.square(window).sum())
    return found


def _stroke(rates: Array, axis: int, angle: float, at: float, length: float) -> None:
    """Add a movement of one stick out and back that turns the aircraft by `angle` [deg]."""
    first, count = round(at / FRAME_S), round(length / FRAME_S)
    shape = np.hanning(count + 2)[1:-1]
    rates[first : first + count, axis] += angle * shape / (shape.sum() * FRAME_S)
