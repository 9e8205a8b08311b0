"""Distributions that PPO draws a network's outputs from.

A draw is made from standard normal noise, one number for each output. So every distribution can hold a draw
for some control steps in the same way: the noise is held while the network's own output goes on changing.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from scipy.special import betaincinv, ndtr

from neuroflight.sim.arrays import Array32

LOG_SQRT_2_PI = 0.5 * math.log(2.0 * math.pi)
EDGE = 1e-5  # a drawn share keeps this far from 0 and 1, where its density can be 0


class NormalExploration:
    """A normal distribution around the deterministic policy's outputs, with one width for all of them."""

    def drawn(self, centre: Array32, noise: Array32, log_std: float) -> Array32:
        """Draw outputs around `centre` from standard normal `noise`, all (..., M); they have no bound."""
        return centre + noise * np.float32(math.exp(log_std))

    def log_prob_drawn(
        self, drawn: torch.Tensor, centre: torch.Tensor, noise: torch.Tensor, log_std: float
    ) -> torch.Tensor:
        """Compute the log density (...) of outputs as `drawn` gave them, summed over the last axis."""
        return -(0.5 * noise.square() + log_std + LOG_SQRT_2_PI).sum(dim=-1)

    def log_prob(self, drawn: torch.Tensor, centre: torch.Tensor, log_std: torch.Tensor) -> torch.Tensor:
        """Compute the log density (...) of outputs around another centre, with its derivative."""
        away = (drawn - centre) * torch.exp(-log_std)
        return -(0.5 * away.square() + log_std + LOG_SQRT_2_PI).sum(dim=-1)


class BetaExploration(NormalExploration):
    """A beta distribution. Array32 lie in -1..1; the deterministic policy, tanh of the last sum, is the mode.

    Chou et al. 2017, whose networks give alpha and beta of the share x = (output + 1) / 2. Here the network
    gives the mode m of x, and the schedule of exploration a concentration k:

        alpha = 1 + k m, beta = 1 + k (1 - m)

    Both are at least 1, as in the paper, so the density has one maximum and no pole, and it is at m. So the
    policy that flies is the network with tanh, which the compiler knows, without alpha or beta. k is such
    that an output in the middle has the wanted standard deviation; towards a bound it becomes smaller by
    itself, because no draw can lie beyond.
    """

    def drawn(self, centre: Array32, noise: Array32, log_std: float) -> Array32:
        """See NormalExploration."""
        mode, k = 0.5 * (centre + 1.0), np.float32(concentration(log_std))
        share = betaincinv(1.0 + k * mode, 1.0 + k * (1.0 - mode), ndtr(noise))
        outputs: Array32 = (2.0 * np.clip(share, EDGE, 1.0 - EDGE) - 1.0).astype(np.float32)
        return outputs

    def log_prob_drawn(
        self, drawn: torch.Tensor, centre: torch.Tensor, noise: torch.Tensor, log_std: float
    ) -> torch.Tensor:
        """See NormalExploration."""
        return self.log_prob(drawn, centre, torch.tensor(log_std))

    def log_prob(self, drawn: torch.Tensor, centre: torch.Tensor, log_std: torch.Tensor) -> torch.Tensor:
        """See NormalExploration."""
        k = concentration(float(log_std.reshape(-1)[0]))
        share, mode = 0.5 * (drawn + 1.0), 0.5 * (centre + 1.0)
        beta = torch.distributions.Beta(1.0 + k * mode, 1.0 + k * (1.0 - mode), validate_args=False)
        found: torch.Tensor = beta.log_prob(share) - math.log(2.0)  # type: ignore[no-untyped-call]
        return found.sum(dim=-1)


def concentration(log_std: float) -> float:
    """Compute k of BetaExploration for the log of a standard deviation of an output in the middle of -1..1.

    With alpha = beta = 1 + k/2 the variance of 2 x - 1 is 1 / (3 + k). Wider than uniform gives 0.
    """
    return max(0.0, math.exp(-2.0 * log_std) - 3.0)


EXPLORATIONS = {"normal": NormalExploration, "beta": BetaExploration}
