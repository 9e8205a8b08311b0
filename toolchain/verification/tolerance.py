"""The float64 reference of the actions, the tolerance, and how far a machine is from the reference."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from neuroflight.toolchain.ir.float32 import Float32
from neuroflight.toolchain.ir.float64_functions import Float64
from neuroflight.toolchain.ir.float64_reference import disturbed, reference
from neuroflight.toolchain.ir.network import Network
from neuroflight.toolchain.verification.inputs import Inputs

TOLERANCE = 1e-6  # of an action, whatever the observation
ROUNDING = 12.0  # how many times what disturbing the network does to an action may rounding do to it
DISTURBANCES = 8  # that this is measured with
COMPARED_MAX = 1e7  # larger values are not compared: their products may leave float32's range
UNIT_SCALE = 4.0  # the largest |value| that counts as unit scale: a standard normal one hardly exceeds it
DSHOT_STEP = 2.0**-11  # of a motor fraction; the ulp of a smaller action is taken as that of this one


@dataclass(frozen=True, eq=False)
class Standard:
    """The expected actions for one group of inputs."""

    inputs: Inputs
    reference: Float64  # (S, T, outputs)
    allowed: Float64  # (S, T): largest error of an action
    scale: Float64  # (S, T): 1 at unit scale, in proportion to the largest |value| so far beyond
    comparable: NDArray[np.bool_]  # (S, T): no value so far is larger than COMPARED_MAX, or no number


@dataclass(frozen=True)
class GroupFigures:
    """The differences of one machine from others on one group; None if no observation is compared."""

    inputs: str
    count: int  # observations
    compared: int  # those that are finite and not huge
    error: float | None  # largest, to the float64 reference
    ulp: float | None  # the same in units in the last place of the reference
    share: float | None  # largest of error / allowed
    difference: float | None  # largest, to onnxruntime
    scaled: float | None  # the same with each observation's divided by its scale, where that exceeds 1


def standard(network: Network, inputs: Inputs, rng: np.random.Generator) -> Standard:
    """Compute the expected actions of the policy's unoptimized `network` for `inputs`, and their tolerance.

    TOLERANCE is allowed, or more if rounding demands it: the rounding errors of a sum are in proportion
    to its terms, and the layers after it magnify or swallow them. How much of that reaches an action is
    measured, not assumed: the network is disturbed in the last place of its constants and functions, and
    ROUNDING times the move of the action that this gives (root mean square of DISTURBANCES) is allowed.
    """
    exact = reference(network, inputs.observation)
    with np.errstate(all="ignore"):
        size = np.maximum.accumulate(np.abs(inputs.observation).max(axis=2), axis=1).astype(np.float64)
        moves = [disturbed(network, inputs.observation, rng) - exact for _ in range(DISTURBANCES)]
        spread = np.sqrt(np.square(moves).mean(axis=0)).max(axis=2)
    return Standard(
        inputs=inputs,
        reference=exact,
        allowed=np.fmax(TOLERANCE, ROUNDING * spread),
        scale=np.fmax(1, size / UNIT_SCALE),
        comparable=size <= COMPARED_MAX,
    )


def figures(actions: Float32, expected: Standard, peer: Float32 | None) -> GroupFigures:
    """Compare `actions` (S, T, outputs) with the expected ones, and with onnxruntime's, `peer`."""
    use = expected.comparable
    name, count, compared = expected.inputs.name, expected.inputs.count, int(use.sum())
    if not compared:
        return GroupFigures(name, count, 0, None, None, None, None, None)
    exact = expected.reference[use]
    error = distance(actions[use], exact)
    ulp = error / np.spacing(np.maximum(np.abs(exact), DSHOT_STEP).astype(np.float32)).astype(np.float64)
    share = error.max(axis=1) / expected.allowed[use]
    difference = scaled = None
    if peer is not None:
        apart = distance(actions[use], peer[use]).max(axis=1)
        difference, scaled = float(apart.max()), float((apart / expected.scale[use]).max())
    worst, units, most = (float(values.max()) for values in (error, ulp, share))
    return GroupFigures(name, count, compared, worst, units, most, difference, scaled)


def distance(actions: NDArray[np.floating], others: NDArray[np.floating]) -> Float64:
    """Compute |a - b|; a NaN counts as infinite."""
    with np.errstate(invalid="ignore"):
        apart = np.abs(actions.astype(np.float64) - others)
    return np.where(np.isnan(apart), np.inf, apart)
