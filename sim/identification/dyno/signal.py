"""Noise, outliers and steps of a recording, found without a model."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import median_filter, uniform_filter1d

from neuroflight.sim.arrays import Array, Flags, Indices
from neuroflight.sim.identification.dyno.recording import Recording
from neuroflight.toolchain.errors import DynoError

JUMP = 0.1  # throttle change between two rows that counts as a step
SETTLED_S = 0.5  # [s] after a jump, when a rotor is taken to have settled
WINDOW_S = 1.5  # [s] after a jump in which the response shows
STEADY = 0.2  # of the top speed a second: a rotor that accelerates less carries no transient
SPIKE_ROWS = 5  # length of the running medians that remove single slips of a logger
CALM_ROWS = 25  # of the running median of a noisy throttle
THROTTLE_NOISE = 0.002  # that a fifth of the rows exceed when it is noisy
SMOOTH_S = 0.05  # [s], over which speed residuals are averaged: the noise goes, the model's error stays
SMOOTH_ROWS = 9  # and at least so many rows
OUTLIER = 5.0  # standard deviations of its channel's noise, against the median of its neighbours
NOISE_FLOOR = 1e-3  # of full scale: noise is not taken to be less
UNEVEN = 0.1  # of the usual period: rows whose distances spread more are not taken when throttle changed
BINS = 12  # of a channel's value, each with its own noise


def without_spikes(values: Array, starts: tuple[int, ...] = (0,), rows: int = SPIKE_ROWS) -> Array:
    """Compute the running median of each run: it keeps steps and slopes, and removes single outliers."""
    pieces = np.split(values, starts[1:])
    return np.concatenate([median_filter(piece, rows, mode="nearest") for piece in pieces])


def commanded(recording: Recording) -> Array:
    """Return the throttle, (N,) 0..1, without slips of the logger and, if it was measured, most noise."""
    throttle = without_spikes(recording.throttle, recording.starts)
    if np.quantile(np.abs(recording.throttle - throttle), 0.8) > THROTTLE_NOISE:
        throttle = without_spikes(throttle, recording.starts, CALM_ROWS)
    return np.clip(throttle, 0.0, 1.0)


def jumps(recording: Recording) -> Indices:
    """Return the rows at which throttle has just jumped, without single slips of the logger."""
    throttle = commanded(recording)
    moved = np.flatnonzero(np.abs(np.diff(throttle)) > JUMP) + 1
    return np.setdiff1d(moved, recording.starts)


def since_jump(recording: Recording, rows: Indices) -> Array:
    """Compute the time since the last jump, or since the run began [s], (N,)."""
    marks = np.union1d(rows, recording.starts).astype(int)
    index = np.searchsorted(marks, np.arange(len(recording.time)), side="right") - 1
    since: Array = recording.time - recording.time[marks[index]]
    return since


def settled_rows(recording: Recording, rows: Indices) -> Flags:
    settled: Flags = since_jump(recording, rows) > SETTLED_S
    if not settled.any():
        raise DynoError(
            f"throttle jumps again within every {SETTLED_S:g} s, expected steps that are held; hold each "
            f"for 2 s"
        )
    return settled


def transient_rows(recording: Recording, rows: Indices) -> Flags:
    """Return the rows shortly after a jump."""
    shown = since_jump(recording, rows) < WINDOW_S
    for start in recording.starts:
        first = rows[rows > start]
        shown[start : int(first[0]) if len(first) else len(shown)] = False
    return shown


def steady_rows(recording: Recording, speed: Array, rows: Indices) -> Flags:
    """Return the rows at which the rotor hardly accelerates: others lag or contain inertia."""
    calm: Flags = np.abs(np.gradient(speed, recording.time)) < STEADY * speed.max()
    calm &= since_jump(recording, rows) > SMOOTH_S
    if calm.sum() < 5 * SMOOTH_ROWS:
        return np.ones(len(speed), bool)
    return calm


def deviation(values: Array) -> float:
    """Estimate the standard deviation of normal noise from the median of its size: outliers do not count."""
    return 1.4826 * float(np.median(np.abs(values)))


def noise_of(values: Array, starts: tuple[int, ...], full: float) -> float:
    """Estimate a channel's noise from the distance of rows from the median of their neighbours."""
    return max(deviation(values - _neighbours(values, starts)), NOISE_FLOOR * full)


def _neighbours(values: Array, starts: tuple[int, ...]) -> Array:
    pieces = np.split(values, starts[1:])
    return np.concatenate([median_filter(piece, SMOOTH_ROWS, mode="nearest") for piece in pieces])


def outliers(values: Array, starts: tuple[int, ...]) -> Flags:
    """Return the rows far from the median of their neighbours. Noise may grow with value."""
    middle = _neighbours(values, starts)
    away = values - middle
    low, high = float(middle.min()), float(middle.max())
    full = max(abs(low), abs(high))
    scale = np.full(len(values), max(deviation(away), NOISE_FLOOR * full))
    if high > low:
        bins = np.minimum(((middle - low) / (high - low) * BINS).astype(int), BINS - 1)
        for index in range(BINS):
            inside = bins == index
            if inside.sum() >= 5 * SMOOTH_ROWS:
                scale[inside] = max(deviation(away[inside]), NOISE_FLOOR * full)
    return np.abs(away) > OUTLIER * scale


def average(values: Array, kept: Flags, recording: Recording) -> Array:
    """Compute the running mean over SMOOTH_S of the rows that are kept; `values` are 0 elsewhere."""
    period = float(np.median(np.diff(recording.time)))
    width = max(SMOOTH_ROWS, round(SMOOTH_S / period))
    pieces = []
    for piece, weight in zip(
        np.split(values, recording.starts[1:]),
        np.split(kept.astype(float), recording.starts[1:]),
        strict=True,
    ):
        total = uniform_filter1d(weight, width, mode="constant")
        pieces.append(uniform_filter1d(piece, width, mode="constant") / np.maximum(total, 1e-9))
    return np.concatenate(pieces)


def uneven(time: Array) -> bool:
    low, middle, high = np.quantile(np.diff(time), [0.1, 0.5, 0.9])
    return bool(high - low > UNEVEN * middle)
