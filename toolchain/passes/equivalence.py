"""Compares two networks in onnxruntime: do they compute the same action?

Both run in float32, unoptimized, on random observations of unit scale, of a gyro's range and far beyond,
on tiny and subnormal ones and on zero; recurrent ones over several steps from cleared state. Where no value
between overflows, their actions may differ by BOUND at unit scale and in proportion beyond; or, where
float32's rounding alone moves the actions of one of them further than that, by a few times as much as it
does (each is measured against itself in float64, so that a wrong pass does not excuse itself).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from neuroflight.toolchain.contract import POLICY_INPUT, POLICY_OUTPUT
from neuroflight.toolchain.ir.float32 import Float32
from neuroflight.toolchain.ir.float64_reference import reference
from neuroflight.toolchain.ir.network import Network
from neuroflight.toolchain.ir.onnx_export import NEW_STATE, STATE, to_model

BOUND = 1e-6  # of an action, for observations of at most 1
ROUNDING = 16  # times what rounding does to one of the two may separate them
ROWS = 24  # observations of each magnitude
STEPS = 6  # of a recurrent network
# Zero, the smallest subnormal and a larger one, the smallest normal number; unit scale; a gyro's range
# (35 rad/s), a rotor's speed (rad/s); and up to the largest float32.
MAGNITUDES = (0.0, 1e-45, 1e-39, 1.2e-38, 1e-6, 0.1, 0.5, 1.0, 35.0, 3000.0, 1e10, 1e30, 3.4e38)


class EquivalenceError(Exception):
    """A pass that changed what a network computes: our own mistake, not the user's."""


@dataclass(frozen=True)
class Equivalence:
    """The largest differences between two networks."""

    observations: int
    unit: float  # largest difference of an action where no observed value exceeds 1
    beyond: float  # largest difference beyond, per unit of the largest observed value
    overflowing: int  # observations that were not compared: a value between leaves float32's range
    bound: float = BOUND  # of both

    def worst(self, other: Equivalence) -> Equivalence:
        """Return the larger of each figure."""
        return Equivalence(
            self.observations + other.observations,
            max(self.unit, other.unit),
            max(self.beyond, other.beyond),
            self.overflowing + other.overflowing,
        )


def check_equivalence(before: Network, after: Network, name: str) -> Equivalence:
    """Check that `after` computes what `before` does.

    Raises EquivalenceError, which calls the change `name`, if it does not; the observations are the same in
    every run.
    """
    observations = _observations(before.inputs, STEPS if before.recurrent else 1)
    old, new = (_run(network, observations) for network in (before, after))
    compared = old.finite & new.finite
    scale = np.maximum(1, np.abs(observations).max(axis=(2, 3)))
    difference = _worst(new.actions - old.actions, compared)
    noise = np.maximum(*(_worst(run.actions - run.exact, compared) for run in (old, new)))
    # One figure a magnitude: a single observation may be rounded well by luck.
    allowed = np.maximum(BOUND * scale, ROUNDING * noise.max(axis=1, keepdims=True))
    if (difference > allowed).any():
        magnitude, row = np.unravel_index(np.argmax(difference / allowed), difference.shape)
        raise EquivalenceError(
            f"{name} changes an action by {difference[magnitude, row]:.3g} at magnitude "
            f"{MAGNITUDES[magnitude]:g}, expected at most {allowed[magnitude, row]:.3g}"
        )
    unit = scale <= 1
    return Equivalence(
        difference.size,
        float(difference[unit].max(initial=0.0)),
        float((difference / scale)[~unit].max(initial=0.0)),
        int((~compared).sum()),
    )


def _observations(inputs: int, steps: int) -> Float32:
    """Draw observations (magnitudes, ROWS, steps, inputs): normal, of one size, and single values."""
    rng = np.random.default_rng(0)
    shape = (len(MAGNITUDES), ROWS, steps, inputs)
    third = ROWS // 3
    unit = np.clip(rng.normal(size=shape) / 3, -1, 1)
    unit[:, third : 2 * third] = rng.choice([-1.0, 1.0], size=(len(MAGNITUDES), third, steps, inputs))
    alone = rng.integers(inputs, size=(len(MAGNITUDES), ROWS - 2 * third, steps, 1))
    unit[:, 2 * third :] = np.where(np.arange(inputs) == alone, 1.0, 0.1 * unit[:, 2 * third :])
    observations: Float32 = (unit * np.array(MAGNITUDES)[:, None, None, None]).astype(np.float32)
    return observations


@dataclass(frozen=True, eq=False)
class _Run:
    """The actions of a network for the observations."""

    actions: NDArray[np.float64]  # (magnitudes, ROWS, steps, outputs)
    exact: NDArray[np.float64]  # the same in float64
    finite: NDArray[np.bool_]  # (magnitudes, ROWS): whether every value between was


def _run(network: Network, observations: Float32) -> _Run:
    """Run all observations through onnxruntime, unoptimized, and through the reference."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_DISABLE_ALL
    options.intra_op_num_threads = 1
    model = to_model(network, rows="rows", state=True, values=True)
    session = onnxruntime.InferenceSession(
        model.SerializeToString(), options, providers=["CPUExecutionProvider"]
    )
    *shape, steps, inputs = observations.shape
    rows = observations.reshape(-1, steps, inputs)
    widths = {entry.name: entry.type.tensor_type.shape.dim[1].dim_value for entry in model.graph.input[1:]}
    state = {name: np.zeros((len(rows), width), np.float32) for name, width in widths.items()}
    names = [entry.name for entry in model.graph.output]
    actions, finite = [], np.ones(len(rows), np.bool_)
    for step in range(steps):
        given = dict(zip(names, session.run(names, {POLICY_INPUT: rows[:, step], **state}), strict=True))
        for value in given.values():
            finite &= np.isfinite(value).all(axis=1)
        actions.append(given[POLICY_OUTPUT].astype(np.float64))
        state = {name: given[NEW_STATE + name.removeprefix(STATE)] for name in state}
    exact = reference(network, rows).reshape(*shape, steps, -1)
    return _Run(np.stack(actions, axis=1).reshape(exact.shape), exact, finite.reshape(shape))


def _worst(difference: NDArray[np.float64], compared: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the largest difference of each observation's actions, (magnitudes, ROWS); 0 if not compared."""
    with np.errstate(invalid="ignore"):
        return np.where(compared, np.abs(difference).max(axis=(2, 3)), 0)
