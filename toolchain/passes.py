"""Optimization: shortens a chain of layers without changing what it computes.

Each rewrite is exact in real arithmetic, is carried out in float64 and rounds its result to float32 once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from toolchain.errors import PolicyError
from toolchain.float32 import Float32
from toolchain.graph import Network, chain
from toolchain.operations import Affine, Linear
from toolchain.operations import Operation as Layer


@dataclass(frozen=True)
class Saving:
    """What one kind of rewrite took away."""

    rewrite: str
    layers: int
    operations: int  # multiply-adds of one evaluation
    bytes: int  # of weights


def optimize(network: Network) -> tuple[Network, tuple[Saving, ...]]:
    """The shortened chain and what was saved, one `Saving` a kind of rewrite that applied.

    Raises PolicyError where folding leaves the range of float32.
    """
    kept: list[Layer] = []
    savings: dict[str, Saving] = {}
    for layer in (node.operation for node in network.nodes):
        kept.append(layer)
        while len(kept) > 1 and (rewritten := _join(kept[-2], kept[-1])) is not None:
            rewrite, joined = rewritten
            before, after = kept[-2:], [joined]
            kept[-2:] = after
            _count(savings, rewrite, before, after)
        if _is_identity(kept[-1]):
            _count(savings, "drop identity", [kept.pop()], [])
    return chain(network.inputs, kept), tuple(savings.values())


def _join(first: Layer, second: Layer) -> tuple[str, Layer] | None:
    """The name of the rewrite and the one layer that does the work of two, or None."""
    match first, second:
        case Affine(), Affine():
            scale = second.scale * first.scale
            return "merge affine maps", Affine(scale, second.scale * first.offset + second.offset)
        case Affine(), Linear():
            weight = second.weight.astype(np.float64)
            bias = second.bias + weight @ first.offset
            return "fold affine map into linear layer", _linear(weight * first.scale, bias)
        case Linear(), Affine():
            weight = first.weight * second.scale[:, None]
            bias = first.bias * second.scale + second.offset
            return "fold affine map into linear layer", _linear(weight, bias)
        case Linear(), Linear() if first.inputs * second.outputs <= _operations(first) + _operations(second):
            outer = second.weight.astype(np.float64)
            weight, bias = outer @ first.weight, outer @ first.bias + second.bias
            return "merge linear layers", _linear(weight, bias)
    return None


def _linear(weight: NDArray[np.float64], bias: NDArray[np.float64]) -> Linear:
    return Linear(_rounded(weight), _rounded(bias))


def _rounded(values: NDArray[np.float64]) -> Float32:
    with np.errstate(over="ignore", under="ignore"):
        rounded = values.astype(np.float32)
    if not np.isfinite(rounded).all():
        raise PolicyError(
            f"folding the policy's constants gives {values[~np.isfinite(rounded)].flat[0]:.3g}, "
            "expected values of float32's range; scale the observation less"
        )
    return rounded


def _is_identity(layer: Layer) -> bool:
    return isinstance(layer, Affine) and bool((layer.scale == 1).all() and (layer.offset == 0).all())


def _operations(layer: Layer) -> int:
    match layer:
        case Linear():
            return layer.weight.size
        case Affine():
            return layer.scale.size
    return 0


def _bytes(layer: Layer) -> int:
    match layer:
        case Linear():
            return layer.weight.nbytes + layer.bias.nbytes
        case Affine():
            return 4 * (layer.scale.size + layer.offset.size)
    return 0


def _count(savings: dict[str, Saving], rewrite: str, before: Sequence[Layer], after: Sequence[Layer]) -> None:
    old = savings.get(rewrite, Saving(rewrite, 0, 0, 0))
    savings[rewrite] = Saving(
        rewrite,
        old.layers + len(before) - len(after),
        old.operations + sum(map(_operations, before)) - sum(map(_operations, after)),
        old.bytes + sum(map(_bytes, before)) - sum(map(_bytes, after)),
    )
