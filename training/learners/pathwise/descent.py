"""Updates: Adam along the gradient, and adapted loss weights that hold means at their limits."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import NDArray

from training.config.pathwise_config import PathwiseConfig
from training.learners.pathwise.loss import Figures, Weights

Floats = NDArray[np.float32]

MOMENTUM, SPREAD = 0.9, 0.99  # Adam's decays; the second is short because a run has few updates
MEMORY = 0.9  # decay of the running means that are compared with the limits
LENGTH_MEMORY = 0.95  # decay of the gradient's usual length
WEIGHT_MIN, WEIGHT_MAX = 0.02, 5000.0  # [deg/s] of an adapted weight
SLOPE = 3.0  # of the adaption, by the relative distance of a mean from its limit


@dataclass(frozen=True, eq=False)
class State:
    """The state of the learner between updates."""

    updates: int
    parameters: Floats  # of the network
    mean: Floats  # Adam's, of the gradient
    square: Floats  # likewise of its square
    weights: Weights
    figures: Figures | None  # running means; None before the first update
    length: float = 0.0  # usual length of the gradient; 0 before the first
    skipped: int = 0  # updates whose gradient was not followed

    @staticmethod
    def fresh(parameters: Floats, weights: Weights) -> State:
        """The state before the first update."""
        nothing = np.zeros_like(parameters)
        return State(0, parameters, nothing, nothing, weights, None)


def descended(state: State, found: Floats, rate: float, pathwise: PathwiseConfig) -> State:
    """A step of Adam (Kingma and Ba 2015) along the gradient `found`.

    None along one that is not finite or `outlier` times longer than usual: a few flights that diverge have
    gradients that say nothing of the others.
    """
    length = math.sqrt(float(np.square(found, dtype=np.float64).sum()))
    updates = state.updates + 1
    if not math.isfinite(length):
        return replace(state, updates=updates, skipped=state.skipped + 1)
    longest = pathwise.outlier * state.length
    outlying = 0.0 < longest < length
    # Outliers count too, cut: lengths that stay become usual some updates later.
    counted = longest if outlying else length
    usual = counted if state.length == 0.0 else LENGTH_MEMORY * state.length + (1.0 - LENGTH_MEMORY) * counted
    state = replace(state, updates=updates, length=usual)
    if outlying:
        return replace(state, skipped=state.skipped + 1)
    cut = np.float32(min(1.0, pathwise.gradient_max / (length + 1e-9)))
    a, b, step = np.float32(MOMENTUM), np.float32(SPREAD), np.float32(rate)
    fresh_mean, fresh_square = np.float32(1.0 - MOMENTUM**updates), np.float32(1.0 - SPREAD**updates)
    slope = found * cut
    mean = a * state.mean + (np.float32(1.0) - a) * slope
    square = b * state.square + (np.float32(1.0) - b) * slope * slope
    way = (mean / fresh_mean) / (np.sqrt(square / fresh_square) + np.float32(1e-8))
    return replace(state, parameters=state.parameters - step * way, mean=mean, square=square)


def adapted(state: State, figures: Figures, pathwise: PathwiseConfig, adapting: bool) -> State:
    """With `figures` in the running means and, if `adapting`, weights adapted to their limits."""
    running = figures if state.figures is None else _blended(state.figures, figures)
    weights = state.weights
    if adapting:
        weights = replace(
            weights,
            output=_held(weights.output, running.output, pathwise.output_limit, pathwise.adaption),
            change=_held(weights.change, running.change, pathwise.change_limit, pathwise.adaption),
        )
    return replace(state, weights=weights, figures=running)


def _blended(old: Figures, new: Figures) -> Figures:
    before, after = asdict(old), asdict(new)
    return Figures(**{name: MEMORY * before[name] + (1.0 - MEMORY) * after[name] for name in before})


def _held(weight: float, mean: float, limit: float | None, adaption: float) -> float:
    """`weight` of a figure whose running `mean` is to stay at `limit`."""
    if limit is None:
        return weight
    beyond = min(1.0, max(-1.0, SLOPE * (mean / limit - 1.0)))
    return min(WEIGHT_MAX, max(WEIGHT_MIN, weight * math.exp(adaption * beyond)))
