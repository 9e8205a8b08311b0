"""Updates: Adam along the gradient, and adapted loss weights that hold means at their limits."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import NDArray

from training.config.pathwise_config import PathwiseConfig
from training.learners.pathwise.loss import Figures, Weights
from training.learners.pathwise.network import Layer, Network

Floats = NDArray[np.float32]

MOMENTUM, SPREAD = 0.9, 0.99  # Adam's decays; the second is short because a run has few updates
MEMORY = 0.9  # decay of the running means that are compared with the limits
WEIGHT_MIN, WEIGHT_MAX = 0.02, 5000.0  # [deg/s] of an adapted weight
SLOPE = 3.0  # of the adaption, by the relative distance of a mean from its limit


@dataclass(frozen=True, eq=False)
class State:
    """The state of the learner between updates."""

    updates: int
    network: Network
    mean: list[Floats]  # Adam's, of the gradient, by the network's parameters
    square: list[Floats]  # likewise of its square
    weights: Weights
    figures: Figures | None  # running means; None before the first update


def with_parameters(network: Network, parameters: list[Floats]) -> Network:
    """`network` with other weights and biases, in the order of its `parameters`."""
    pairs = zip(parameters[::2], parameters[1::2], strict=True)
    return replace(network, layers=tuple(Layer(weight, bias) for weight, bias in pairs))


def descended(state: State, found: list[Floats], rate: float, pathwise: PathwiseConfig) -> State:
    """A step of Adam (Kingma and Ba 2015) along the gradient `found`; none if that is not finite."""
    length = math.sqrt(sum(float(np.square(part, dtype=np.float64).sum()) for part in found))
    updates = state.updates + 1
    if not math.isfinite(length):
        return replace(state, updates=updates)
    cut = np.float32(min(1.0, pathwise.gradient_max / (length + 1e-9)))
    a, b, step = np.float32(MOMENTUM), np.float32(SPREAD), np.float32(rate)
    fresh_mean, fresh_square = np.float32(1.0 - MOMENTUM**updates), np.float32(1.0 - SPREAD**updates)
    parameters, means, squares = [], [], []
    for parameter, part, mean, square in zip(
        state.network.parameters, found, state.mean, state.square, strict=True
    ):
        slope = part * cut
        mean = a * mean + (np.float32(1.0) - a) * slope
        square = b * square + (np.float32(1.0) - b) * slope * slope
        parameters.append(
            parameter - step * (mean / fresh_mean) / (np.sqrt(square / fresh_square) + np.float32(1e-8))
        )
        means.append(mean)
        squares.append(square)
    return replace(
        state, updates=updates, network=with_parameters(state.network, parameters), mean=means, square=squares
    )


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
