"""Every policy ends with a Clip within [0, 1], motor fractions.

An export that ends with an activation of that range, such as a sigmoid, gets such a Clip here, which
changes no value. Any other model without one is rejected.
"""

from __future__ import annotations

import math

from neuroflight.toolchain.errors import PolicyError
from neuroflight.toolchain.ir.intervals import value_intervals
from neuroflight.toolchain.ir.network import Network, Node
from neuroflight.toolchain.ir.operations import Clip, Operation


class UnboundedError(PolicyError):
    """A policy whose motor fractions may leave [0, 1]."""


def bounded(network: Network) -> Network:
    """Return `network` with a Clip within [0, 1] at its end. Raises UnboundedError otherwise."""
    match network.nodes[-1].operation if network.nodes else None:
        case Clip(low=float(low), high=float(high)) if 0 <= low <= high <= 1:
            return network
        case last:
            low, high = meant_range(network)
            if not 0 <= low <= high <= 1:
                raise UnboundedError(
                    f"the policy ends with {_short(last)}, expected Clip within [0, 1]; {_mend(low, high)}"
                )
    clip = Node(Clip(0.0, 1.0), (len(network.nodes),), "clip")
    return Network(network.inputs, (*network.nodes, clip))


def meant_range(network: Network) -> tuple[float, float]:
    """Return the bounds that activations and maps at the network's end give its outputs; infinite without."""
    low, high = value_intervals(network, by_weights=False)[-1]
    return float(low.min()), float(high.max())


def shown_range(low: float, high: float) -> str:
    """Format a range for a message."""
    return f"{low:.4g} to {high:.4g}"


def _mend(low: float, high: float) -> str:
    if low > -math.inf and high < math.inf:
        return (
            f"its outputs lie in {shown_range(low, high)}: if these mean 0 to full power, "
            f"`neuroflight policy import --output-range {low:.4g},{high:.4g}` maps them"
        )
    return (
        "name the range that its outputs had in training, `neuroflight policy import --output-range LO,HI` "
        "(-1,1 for most trainers), or, if they are motor fractions from 0 to 1 already, --clip"
    )


def _short(operation: Operation | None) -> str:
    match operation:
        case None:
            return "nothing"
        case Clip(low, high):
            return f"Clip from {low} to {high}"
    return type(operation).__name__
