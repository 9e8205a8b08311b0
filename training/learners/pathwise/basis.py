"""The units in which a policy is learned: differences of inputs that are nearly the same, and what steers.

A low-passed or predicted rate is nearly the rate. What it tells beside it, an acceleration or a moment from
outside, is a small difference, which a first layer makes of large weights that nearly cancel: a descent finds
them late or never. So the learner's parameters weigh the differences, enlarged. The network that flies has
the same inputs as ever; its first layer is converted.

More than four motors can be driven in patterns that turn nothing. A mix that lets no motor stop makes lift of
them, and faster rotors leave smaller errors: a hexacopter learned to fly with 1.6 times its weight of lift
under a closed throttle. So the last layer keeps only what turns the aircraft, and what all motors share.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.arrays import Array32
from neuroflight.sim.physics.rotor import rotor_geometry
from neuroflight.toolchain.contract import ObservationTerm
from neuroflight.training.learners.network.shape import Shape

RATE, ESTIMATE = "rate", "rate_estimate"
LARGER = np.float32(10.0)  # brings differences to the size of the other inputs


class Basis:
    """A conversion of parameters between how they are learned and how the network has them."""

    def __init__(
        self, shape: Shape, terms: Sequence[ObservationTerm], motors: int, steering: Array32 | None = None
    ) -> None:
        """steering: see the function; None: the motors have no other patterns."""
        self._shape, self._steering = shape, steering
        self._pairs = _pairs(terms, motors)

    def network(self, learned: Array32) -> Array32:
        """Convert learned parameters to the network's."""
        parameters = learned.copy()
        first = self._shape.split(parameters)[0]
        for own, other in self._pairs:
            first[:, other] -= LARGER * first[:, own]
            first[:, own] *= LARGER
        return self._steered(parameters)

    def learned(self, network: Array32) -> Array32:
        """Convert the network's parameters to learned ones."""
        parameters = network.copy()
        first = self._shape.split(parameters)[0]
        for own, other in reversed(self._pairs):
            first[:, own] /= LARGER
            first[:, other] += LARGER * first[:, own]
        return parameters

    def gradient(self, found: Array32) -> Array32:
        """Convert the gradient by the network's parameters to the one by what is learned."""
        gradient = self._steered(found.copy())
        first = self._shape.split(gradient)[0]
        for own, other in reversed(self._pairs):
            first[:, own] = LARGER * (first[:, own] - first[:, other])
        return gradient

    def _steered(self, parameters: Array32) -> Array32:
        """Project the last layer of `parameters`, or the gradient by it, onto what steers, in place."""
        if self._steering is not None:
            for part in self._shape.split(parameters)[-2:]:
                part[:] = self._steering @ part
        return parameters


def steering(aircraft: Aircraft) -> Array32 | None:
    """Return the projection (M, M) of M motors' values onto what turns the aircraft or lifts it evenly.

    None where every pattern does one or the other, as with four rotors.
    """
    geometry, motors = rotor_geometry(aircraft), aircraft.motor_count
    turns = np.hstack([geometry.thrust_wrench[:, 3:5], geometry.torque_wrench[:, 5:6]])
    patterns, sizes, _ = np.linalg.svd(
        np.hstack([turns / np.linalg.norm(turns, axis=0), np.ones((motors, 1))])
    )
    kept = patterns[:, : len(sizes)][:, sizes > 1e-6 * sizes[0]]
    return None if kept.shape[1] == motors else (kept @ kept.T).astype(np.float32)


def _pairs(terms: Sequence[ObservationTerm], motors: int) -> list[tuple[slice, slice]]:
    """Pair inputs that count as differences with the inputs they differ from, which come first in the order.

    `rate_estimate~f` is a difference from `rate~f` if that is observed; all else of this kind from `rate`.
    """
    ends = np.cumsum([0, *(term.count(motors) for term in terms)]).tolist()
    inputs = {term.text: slice(*both) for term, both in zip(terms, pairwise(ends), strict=True)}
    if RATE not in inputs:
        return []
    rates = [term for term in terms if term.name == RATE and term.text != RATE]
    estimates = [term for term in terms if term.name == ESTIMATE]
    pairs = [(inputs[term.text], inputs[RATE]) for term in rates]
    for term in estimates:
        alike = term.text.replace(ESTIMATE, RATE)
        pairs.append((inputs[term.text], inputs.get(alike, inputs[RATE])))
    return pairs
