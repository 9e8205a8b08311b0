"""The weights of a policy for any aircraft, as they are learned: a sum over features of what is told.

toolchain/policy/specialize.py makes the same sum of the file.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from neuroflight.sim.arrays import Array32
from neuroflight.toolchain.contract import ObservationTerm
from neuroflight.toolchain.policy.specialize import FEATURES, Told, features, input_factors
from neuroflight.training.learners.network.shape import Shape
from neuroflight.training.learners.pathwise.basis import Basis


class General:
    """A conversion of learned parameters to each aircraft's network, and of its gradient back."""

    def __init__(self, basis: Basis, shape: Shape, terms: Sequence[ObservationTerm]) -> None:
        self._basis, self._shape, self._terms = basis, shape, tuple(terms)

    def fresh(self, parameters: Array32) -> Array32:
        """Return learned parameters that make of all aircraft the same network."""
        learned = np.zeros((FEATURES, len(parameters)), np.float32)
        learned[0] = parameters
        return learned.ravel()

    def network(self, learned: Array32, told: Told) -> Array32:
        """Compute the parameters of the network of an aircraft."""
        weights = features(told).astype(np.float32)
        return self._scaled(self._basis.network(weights @ learned.reshape(FEATURES, -1)), told)

    def gradient(self, found: Array32, told: Told) -> Array32:
        """Convert the gradient by the network of an aircraft to the one by what is learned."""
        own = self._basis.gradient(self._scaled(found.copy(), told))
        return np.outer(features(told).astype(np.float32), own).ravel()

    def bases(self, learned: Array32) -> list[Array32]:
        """Return the parameters of the network that each feature weighs, in the units of REFERENCE."""
        return [self._basis.network(each) for each in learned.reshape(FEATURES, -1)]

    def _scaled(self, parameters: Array32, told: Told) -> Array32:
        """Multiply the first layer's columns by the inputs' factors, in place."""
        self._shape.split(parameters)[0][:] *= input_factors(told, self._terms).astype(np.float32)
        return parameters
