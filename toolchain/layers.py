"""The nouns of a feed-forward policy: a chain of layers, each a pure function of the values before it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from toolchain.float32 import Float32


@dataclass(frozen=True, eq=False)
class Linear:
    """y = W x + b."""

    weight: Float32  # (outputs, inputs)
    bias: Float32  # (outputs,)

    def __post_init__(self) -> None:
        """Raise ValueError unless weight is (outputs, inputs) and bias (outputs,), both float32."""
        if self.weight.ndim != 2 or self.bias.shape != self.weight.shape[:1]:
            raise ValueError(f"a linear layer of weight {self.weight.shape} and bias {self.bias.shape}")
        if self.weight.dtype != np.float32 or self.bias.dtype != np.float32:
            raise ValueError(f"a linear layer of {self.weight.dtype} and {self.bias.dtype}, not float32")

    @property
    def inputs(self) -> int:
        """Number of values it takes."""
        return int(self.weight.shape[1])

    @property
    def outputs(self) -> int:
        """Number of values it gives."""
        return int(self.weight.shape[0])


@dataclass(frozen=True, eq=False)
class Affine:
    """y = scale x + offset, value by value. Kept in float64 so that folding rounds once."""

    scale: NDArray[np.float64]  # (n,)
    offset: NDArray[np.float64]  # (n,)


@dataclass(frozen=True)
class Tanh:
    """y = tanh x, by the rational approximation of `toolchain.tanh`."""


@dataclass(frozen=True)
class Relu:
    """y = max(x, 0)."""


@dataclass(frozen=True)
class Clip:
    """y = min(max(x, low), high); the bounds are float32 values, None for no bound."""

    low: float | None
    high: float | None


Activation = Tanh | Relu | Clip
Layer = Linear | Affine | Activation
Layers = tuple[Layer, ...]


def shape_text(inputs: int, layers: Sequence[Layer]) -> str:
    """The network in a few characters: `6-64-64-4 tanh`."""
    widths = [inputs, *(layer.outputs for layer in layers if isinstance(layer, Linear))]
    hidden = {type(layer).__name__.lower() for layer in layers[:-1] if not isinstance(layer, Linear | Affine)}
    return " ".join(["-".join(map(str, widths)), *sorted(hidden)])
