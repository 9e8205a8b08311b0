"""CMA-ES: local search without derivatives, population by population, with the usual ask and tell."""

from __future__ import annotations

import math

import numpy as np

from neuroflight.sim.arrays import Array


class CmaEs:
    """A normal distribution of candidates that moves towards those with the least cost.

    Source: N. Hansen, "The CMA Evolution Strategy: A Tutorial", arXiv:1604.00772; its default constants,
    positive weights only.
    """

    def __init__(self, start: Array, spread: Array, population: int, rng: np.random.Generator) -> None:
        """start: (d,), first mean; spread: (d,), first standard deviation."""
        d, parents = len(start), population // 2
        weights = np.log(population / 2 + 0.5) - np.log(np.arange(1, parents + 1))
        self._weights = weights / weights.sum()
        self._effective = effective = 1.0 / float((self._weights**2).sum())
        self._path_share = (4 + effective / d) / (d + 4 + 2 * effective / d)
        self._size_share = (effective + 2) / (d + effective + 5)
        self._rank_one = 2 / ((d + 1.3) ** 2 + effective)
        rank_mu = 2 * (effective - 2 + 1 / effective) / ((d + 2) ** 2 + effective)
        self._rank_mu = min(1 - self._rank_one, rank_mu)
        self._damping = 1 + 2 * max(0.0, math.sqrt((effective - 1) / (d + 1)) - 1) + self._size_share
        self._length = math.sqrt(d) * (
            1 - 1 / (4 * d) + 1 / (21 * d * d)
        )  # mean of |N(0, 1)| in d dimensions
        self._population = population
        self._rng = rng
        self._mean = start.astype(np.float64)
        self._size = 1.0
        self._covariance = np.diag(spread.astype(np.float64) ** 2)
        self._path, self._size_path = np.zeros(d), np.zeros(d)
        self._generation = 0

    def ask(self) -> Array:
        """Draw candidates to try, (population, d)."""
        self._variances, self._axes = np.linalg.eigh(self._covariance)
        self._variances = np.maximum(self._variances, 1e-20)
        drawn = self._rng.standard_normal((self._population, len(self._mean)))
        candidates: Array = self._mean + self._size * (drawn * np.sqrt(self._variances)) @ self._axes.T
        return candidates

    def tell(self, candidates: Array, costs: Array) -> None:
        """Adapt to the `costs` (population,) of the `candidates` (population, d) of the last `ask`."""
        self._generation += 1
        best = np.argsort(costs, kind="stable")[: len(self._weights)]
        steps = (candidates[best] - self._mean) / self._size
        step = self._weights @ steps
        self._mean = self._mean + self._size * step

        share, effective = self._size_share, self._effective
        white = self._axes @ ((self._axes.T @ step) / np.sqrt(self._variances))
        self._size_path = (1 - share) * self._size_path + math.sqrt(share * (2 - share) * effective) * white
        walked = float(np.linalg.norm(self._size_path))
        expected = self._length * math.sqrt(1 - (1 - share) ** (2 * self._generation))
        straight = walked / expected < 1.4 + 2 / (len(step) + 1)

        share = self._path_share
        self._path = (1 - share) * self._path
        if straight:
            self._path += math.sqrt(share * (2 - share) * effective) * step
        self._covariance = (
            (1 - self._rank_one - self._rank_mu) * self._covariance
            + self._rank_one * np.outer(self._path, self._path)
            + self._rank_mu * (steps.T * self._weights) @ steps
        )
        self._size *= math.exp((walked / self._length - 1) * self._size_share / self._damping)
