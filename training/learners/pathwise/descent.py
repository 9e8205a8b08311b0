"""Updates: Adam along the gradient, adapted loss weights that hold means at their limits, and setbacks.

A run can diverge within some hundred updates. It then goes back to the parameters with the least running
error, with a fresh Adam at half the rate.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace

import numpy as np

from neuroflight.sim.arrays import Array32
from neuroflight.toolchain.errors import TrainingError
from neuroflight.training.config.pathwise_config import PathwiseConfig
from neuroflight.training.learners.pathwise.loss import LossFigures, Weights

MOMENTUM, SPREAD = 0.9, 0.99  # Adam's decays; the second is short because a run has few updates
MEMORY = 0.9  # decay of the running means that are compared with the limits
LENGTH_MEMORY = 0.95  # decay of the gradient's usual length
WEIGHT_MIN, WEIGHT_MAX = 0.02, 5000.0  # [deg/s] of an adapted weight
SLOPE = 3.0  # of the adaption, by the relative distance of a mean from its limit
SETTLED = 20  # updates until the running means say something of the parameters
DIVERGED = 4.0  # times the least running error; by the luck of its batches it is up to twice that
GROWTH = 2.0  # times the running error is the most that a batch counts: flights out of control exceed all
SETBACK_RATE = 0.5  # factor of the learning rate after each setback
SETBACKS_MAX = 4  # more: the configuration is at fault


@dataclass(frozen=True, eq=False)
class Good:
    """The parameters with the least running error."""

    updates: int
    error: float  # [deg/s]: see Figures
    parameters: Array32
    weights: Weights


@dataclass(frozen=True)
class Setback:
    """A run diverged and went back. `parameters` are those after `back_to` updates."""

    updates: int
    error: float  # [deg/s]
    back_to: int
    least: float  # [deg/s], error there

    def line(self, batch_steps: int) -> str:
        """Tell the user. batch_steps: control steps of an update."""
        return (
            f"diverged at {self.updates * batch_steps:,} steps: error {self.error:.1f} deg/s, "
            f"{self.least:.1f} at {self.back_to * batch_steps:,} steps; it goes on from there at "
            f"{SETBACK_RATE:g} of the learning rate"
        )


@dataclass(frozen=True, eq=False)
class State:
    """The state of the learner between updates."""

    updates: int
    parameters: Array32  # of the network
    mean: Array32  # Adam's, of the gradient
    square: Array32  # likewise of its square
    weights: Weights
    figures: LossFigures | None  # running means; None before the first update
    good: Good  # state that a setback restores
    length: float = 0.0  # usual length of the gradient; 0 before the first
    skipped: int = 0  # updates whose gradient was not followed
    begun: int = 0  # updates at which Adam began, at 0 or after a setback
    error: float = 0.0  # [deg/s], running mean; 0 before the first
    setbacks: tuple[Setback, ...] = ()

    @staticmethod
    def fresh(parameters: Array32, weights: Weights) -> State:
        """Return the state before the first update."""
        nothing = np.zeros_like(parameters)
        return State(0, parameters, nothing, nothing, weights, None, Good(0, math.inf, parameters, weights))

    @property
    def rate_factor(self) -> float:
        """Factor of the learning rate."""
        return SETBACK_RATE ** len(self.setbacks)


def descended(state: State, found: Array32, rate: float, pathwise: PathwiseConfig) -> State:
    """Take a step of Adam (Kingma and Ba 2015) along the gradient `found`.

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
    taken = updates - state.begun
    fresh_mean, fresh_square = np.float32(1.0 - MOMENTUM**taken), np.float32(1.0 - SPREAD**taken)
    slope = found * cut
    mean = a * state.mean + (np.float32(1.0) - a) * slope
    square = b * state.square + (np.float32(1.0) - b) * slope * slope
    way = (mean / fresh_mean) / (np.sqrt(square / fresh_square) + np.float32(1e-8))
    return replace(state, parameters=state.parameters - step * way, mean=mean, square=square)


def adapted(state: State, figures: LossFigures, pathwise: PathwiseConfig, adapting: bool) -> State:
    """Add `figures` to the running means and, if `adapting`, adapt weights to their limits."""
    running = figures if state.figures is None else _blended(state.figures, figures)
    weights = state.weights
    if adapting:
        weights = replace(
            weights,
            output=_held(weights.output, running.output, pathwise.output_limit, pathwise.adaption),
            change=_held(weights.change, running.change, pathwise.change_limit, pathwise.adaption),
        )
    return replace(state, weights=weights, figures=running)


def guarded(state: State, found: float) -> State:
    """Keep the parameters if they are the best so far; go back if the run has diverged.

    found: error of the batch [deg/s]. Raises TrainingError for a run that diverges again and again.
    """
    good, most = state.good, GROWTH * state.error
    counted = found if state.error == 0.0 or found < most else most  # most for NaN
    error = counted if state.error == 0.0 else MEMORY * state.error + (1.0 - MEMORY) * counted
    state = replace(state, error=error)
    if state.updates - state.begun < SETTLED:
        return state
    if error < good.error:
        return replace(state, good=Good(state.updates, error, state.parameters, state.weights))
    if error <= DIVERGED * good.error:  # false for NaN
        return state
    if len(state.setbacks) == SETBACKS_MAX:
        raise TrainingError(
            f"the run diverged {1 + SETBACKS_MAX} times, although its learning rate was halved each time; "
            f"give a lower algorithm.learning_rate, or another seed"
        )
    nothing = np.zeros_like(good.parameters)
    return replace(
        state,
        parameters=good.parameters,
        mean=nothing,
        square=nothing,
        weights=good.weights,
        figures=None,
        length=0.0,
        error=0.0,
        begun=state.updates,
        setbacks=(*state.setbacks, Setback(state.updates, error, good.updates, good.error)),
    )


def _blended(old: LossFigures, new: LossFigures) -> LossFigures:
    before, after = asdict(old), asdict(new)
    return LossFigures(**{name: MEMORY * before[name] + (1.0 - MEMORY) * after[name] for name in before})


def _held(weight: float, mean: float, limit: float | None, adaption: float) -> float:
    """Adapt `weight` of a figure whose running `mean` is to stay at `limit`."""
    if limit is None:
        return weight
    beyond = min(1.0, max(-1.0, SLOPE * (mean / limit - 1.0)))
    return min(WEIGHT_MAX, max(WEIGHT_MIN, weight * math.exp(adaption * beyond)))
