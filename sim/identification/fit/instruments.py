"""A fit by instruments: what the pilot asked decides, which no gust and no wash moves.

In flight a controller answers gusts and wash by the motors, so that motors correlate with what turns the
aircraft besides, and what least squares find of the one by the other is biased. Here each equation's residual
is multiplied by what the model would have said had motors and rates moved by the commands alone: their part
that a filter of the setpoints and the throttle makes, found on other stretches than it is used on. Source:
refined instrumental variables; Young, Recursive Estimation and Time-Series Analysis, from memory.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from itertools import pairwise

import numpy as np

from neuroflight.sim.arrays import Array, Indices
from neuroflight.sim.identification.fit.estimate import Data
from neuroflight.sim.identification.fit.noise import high_pass

LAGS_S = (-0.012, -0.008, -0.004, 0.0, 0.004, 0.008, 0.012, 0.016, 0.02, 0.025, 0.03, 0.04, 0.05, 0.065,
          0.08, 0.1, 0.13, 0.17, 0.22, 0.3)  # fmt: skip
LEAK = 2 * np.pi * 0.5  # [1/s] of the high-pass that motors and commands are compared behind
STRETCH_S = 3.0
FOLDS = 4
RIDGE = 1e-6
MOVED_MIN = np.deg2rad(2.0)  # [rad/s], standard deviation of a setpoint that tells something


def speaks(one: Data) -> bool:
    """Return True if commands were logged, and moved."""
    asked = one.model.piece.asked
    return asked is not None and bool((asked[:, :3].std(axis=0) > MOVED_MIN).any())


def quiet(data: Sequence[Data]) -> list[Data]:
    """Return the pieces as the commands alone move motors and rates; without commands they stand still."""
    laid = [_regressors(one) for one in data]
    count, width = laid[0][0].shape[1], laid[0][2].shape[1]
    squares, products = np.zeros((FOLDS, count, count)), np.zeros((FOLDS, count, width))
    for one, (quick, _, target, fold) in zip(data, laid, strict=True):
        for number in range(FOLDS):
            rows = one.used & (fold == number)
            squares[number] += quick[rows].T @ quick[rows]
            products[number] += quick[rows].T @ target[rows]
    filters = []
    for number in range(FOLDS):
        others = np.arange(FOLDS) != number
        square = squares[others].sum(axis=0)
        square += RIDGE * np.trace(square) / count * np.eye(count)
        filters.append(np.linalg.solve(square, products[others].sum(axis=0)))
    found = []
    for one, (_, level, _, fold) in zip(data, laid, strict=True):
        piece = one.model.piece
        moved = np.zeros((len(fold), width))
        for number, taps in enumerate(filters):
            moved[fold == number] = level[fold == number] @ taps
        moved -= moved[one.used].mean(axis=0)
        motors = piece.motors.shape[1]
        model = copy(one.model)
        usual = piece.motors[one.used].mean(axis=0)
        model.motors = np.clip(model.fine(usual + moved[:, :motors]), 0.0, 1.0)
        model.rate = model.fine(moved[:, motors:])
        found.append(replace(one, model=model))
    return found


def _regressors(one: Data) -> tuple[Array, Array, Array, Indices]:
    """Return commands at all lags (N, K), high-passed and as they are, motors and rates, and folds."""
    piece, step = one.model.piece, one.model.piece.step_s
    asked = np.zeros((len(piece.motors), 4)) if piece.asked is None else piece.asked
    asked = asked - asked.mean(axis=0)
    edges = np.unique(np.round(np.array(LAGS_S) / step).astype(int))
    times = piece.start_s + np.arange(len(asked)) * step
    fold = (times // STRETCH_S).astype(np.intp) % FOLDS
    target = _high(np.column_stack([piece.motors, piece.gyro]), step)
    return _lagged(_high(asked, step), edges), _lagged(asked, edges), target, fold


def _high(values: Array, step: float) -> Array:
    return high_pass(np.diff(values, axis=0), LEAK, step)


def _lagged(values: Array, edges: Indices) -> Array:
    """Return means of rows (N, K) between lags, those of all `edges` beside each other; ends go on."""
    first, last = max(0, int(edges[-1])), max(0, -int(edges[0]))
    padded = np.concatenate(
        [np.repeat(values[:1], first + 1, axis=0), values, np.repeat(values[-1:], last, axis=0)]
    )
    sums = np.cumsum(padded, axis=0)
    rows = np.arange(len(values)) + first + 1
    bins = [(sums[rows - low] - sums[rows - high]) / (high - low) for low, high in pairwise(edges)]
    return np.concatenate(bins, axis=1)
