"""The last step of an imported policy: from the range that its outputs had in training to motor fractions."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from neuroflight.toolchain.errors import PolicyError
from neuroflight.toolchain.ir.float64_reference import reference
from neuroflight.toolchain.ir.network import Network, Node
from neuroflight.toolchain.ir.operations import Affine, Clip
from neuroflight.toolchain.reader.output_range import meant_range, shown_range

SAMPLES = 400  # observations of unit scale, on which the Clip's effect is counted
HELD = 0.05  # share of outputs at the Clip's limits above which freeze warns
HELD_UNBOUNDED = 0.9  # likewise of outputs that nothing bounds, once their range is told: many lie beyond it
APART_MIN = 1e-3  # between the ends of a range, of the larger one: float32 holds 1e-7 of that
ENDS_MAX, ENDS_MIN = 1e9, 1e-6  # of the larger end: actions are fractions, microseconds, rad/s or rpm


@dataclass(frozen=True)
class OutputRange:
    """Outputs from low to high mean motor fractions 0 to 1."""

    low: float
    high: float

    def __post_init__(self) -> None:
        """Raise PolicyError unless it is a range that float32 can map."""
        asked = f"--output-range {self.low:g},{self.high:g}"
        if not (math.isfinite(self.low) and math.isfinite(self.high) and self.low < self.high):
            raise PolicyError(f"{asked}: expected two finite numbers, the lower one first")
        largest = max(abs(self.low), abs(self.high))
        if not ENDS_MIN <= largest <= ENDS_MAX or self.high - self.low < APART_MIN * largest:
            raise PolicyError(
                f"{asked}: expected ends of at most {ENDS_MAX:g} that differ by a thousandth of the larger "
                f"one, which is {ENDS_MIN:g} at least"
            )

    @staticmethod
    def of(text: str) -> OutputRange:
        """Read `LO,HI`. Raises PolicyError, one line."""
        try:
            low, high = map(float, text.split(","))
        except ValueError as error:
            raise PolicyError(f"--output-range {text[:40]!r}: expected LO,HI, such as -1,1") from error
        return OutputRange(low, high)


def map_output(network: Network, asked: OutputRange) -> tuple[Network, list[str]]:
    """Return the network with its output mapped to motor fractions, and a description of the change."""
    low, high = meant_range(network)
    if 0 <= low <= high <= 1 and asked.low < 0:
        raise PolicyError(
            f"its outputs stay within {shown_range(low, high)} by themselves, which --output-range "
            f"{asked.low:g},{asked.high:g} would map to a part of 0 to 1; leave it out"
        )
    words = [f"mapped outputs from {asked.low:g} to {asked.high:g} to motor fractions from 0 to 1"]
    if low < asked.low or high > asked.high:
        known = low > -math.inf and high < math.inf
        beyond = f"may lie in {shown_range(low, high)}" if known else "may lie beyond"
        words.append(f"appended a Clip to [0, 1]: outputs {beyond}")
        below, above = _beyond(network, asked.low, asked.high)
        if below + above > (HELD if known else HELD_UNBOUNDED):
            words.append(
                "warning: the Clip holds motors at 0 or full: on observations of unit scale "
                f"{below:.0%} of the outputs are below {asked.low:g} and {above:.0%} above {asked.high:g}; "
                "is this the range that they had in training?"
            )
    scale = 1 / (asked.high - asked.low)
    factors, offsets = np.full(network.outputs, scale), np.full(network.outputs, -asked.low * scale)
    return _then(network, Affine(factors, offsets)), words


def clip_output(network: Network) -> tuple[Network, list[str]]:
    """Return the network with a Clip to [0, 1] at its end, and a description of what that changes."""
    words = ["appended a Clip to [0, 1]"]
    low, high = meant_range(network)
    below, above = _beyond(network, 0.0, 1.0)
    known = low > -math.inf and high < math.inf and (low < 0 or high > 1)
    if known or below + above > HELD:
        cause = f"its outputs lie in {shown_range(low, high)}" if known else "its outputs leave 0 to 1"
        asked = f"{low:g},{high:g}" if known else "-1,1"
        words.append(
            f"warning: {cause}, so the Clip holds motors at 0 or full: on observations of unit scale "
            f"{below:.0%} of the outputs are below 0 and {above:.0%} above 1; if they mean 0 to full power, "
            f"use --output-range {asked} instead of --clip"
        )
    return _then(network, Clip(0.0, 1.0)), words


def _beyond(network: Network, low: float, high: float) -> tuple[float, float]:
    """Return the shares of outputs below `low` and above `high`, on observations of unit scale."""
    observation = np.random.default_rng(0).normal(size=(1, SAMPLES, network.inputs)).astype(np.float32)
    outputs = reference(network, observation)
    return float((outputs < low).mean()), float((outputs > high).mean())


def _then(network: Network, operation: Affine | Clip) -> Network:
    node = Node(operation, (len(network.nodes),), type(operation).__name__.lower())
    return Network(network.inputs, (*network.nodes, node))
