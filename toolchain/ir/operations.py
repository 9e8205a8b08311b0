"""The operations of a policy's network: what one node computes from the values it takes.

A value is a row of float32; every operation takes one or more values and gives one. Weights are float32, in
the layout that the mathematics has, not the one a kernel reads (toolchain.codegen.plan).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from neuroflight.toolchain.ir.float32 import Float32


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
    """y = tanh x, by the cubics of `toolchain.ir.activation_tables`."""


@dataclass(frozen=True)
class Sigmoid:
    """y = 1 / (1 + e^-x), as 1/2 + 1/2 tanh(x/2)."""


@dataclass(frozen=True)
class Silu:
    """y = x sigmoid(x)."""


@dataclass(frozen=True)
class Softsign:
    """y = x / (1 + |x|)."""


@dataclass(frozen=True)
class Erf:
    """y = erf x, the error function, by a table: what GELU is made of."""


@dataclass(frozen=True)
class Softplus:
    """y = log(1 + e^x), as max(x, 0) + log(1 + e^-|x|), by a table."""


@dataclass(frozen=True)
class Relu:
    """y = max(x, 0)."""


@dataclass(frozen=True)
class LeakyRelu:
    """y = max(x, 0) + slope min(x, 0)."""

    slope: float


@dataclass(frozen=True)
class Elu:
    """y = max(x, 0) + alpha (e^min(x, 0) - 1)."""

    alpha: float


@dataclass(frozen=True)
class Clip:
    """y = min(max(x, low), high); the bounds are float32 values, None for no bound."""

    low: float | None
    high: float | None


@dataclass(frozen=True, eq=False)
class LayerNorm:
    """y = (x - mean) / sqrt(variance + epsilon) scale + offset, over all values of x."""

    epsilon: float
    scale: Float32  # (n,)
    offset: Float32  # (n,)


@dataclass(frozen=True, eq=False)
class RmsNorm:
    """y = x / sqrt(mean(x^2) + epsilon) scale + offset, over all values of x."""

    epsilon: float
    scale: Float32  # (n,)
    offset: Float32  # (n,)


@dataclass(frozen=True)
class Softmax:
    """y = e^x / sum(e^x), over all values of x."""


@dataclass(frozen=True)
class Add:
    """y = a + b of two values of one width."""


@dataclass(frozen=True)
class Multiply:
    """y = a b, value by value, of two values of one width."""


@dataclass(frozen=True)
class Select:
    """y = a where c > 0, else b, value by value, of three values c, a, b of one width."""


@dataclass(frozen=True)
class Concat:
    """The values it takes, one after the other."""


@dataclass(frozen=True)
class Slice:
    """`count` values x[start], x[start + step], ...; step may be negative."""

    start: int
    count: int
    step: int = 1


@dataclass(frozen=True, eq=False)
class Gru:
    """A gated recurrent unit whose state h is cleared by policy_init. Gates in ONNX's order: z, r, n.

    z, r = sigmoid(W x + b + R h + c),  n = tanh(W x + b + r (R h + c)),  h' = (1 - z) n + z h,  y = h'
    (linear_before_reset, as torch has it).
    """

    input_weight: Float32  # (3 H, inputs)
    state_weight: Float32  # (3 H, H)
    input_bias: Float32  # (3 H,)
    state_bias: Float32  # (3 H,)

    @property
    def units(self) -> int:
        """H, the width of the state and of the output."""
        return int(self.state_weight.shape[1])


@dataclass(frozen=True, eq=False)
class Lstm:
    """A long short-term memory whose state h, c is cleared by policy_init. Gates in ONNX's order: i, o, f, g.

    i, o, f = sigmoid(W x + R h + b),  g = tanh(W x + R h + b),  c' = f c + i g,  h' = o tanh c',  y = h'.
    """

    input_weight: Float32  # (4 H, inputs)
    state_weight: Float32  # (4 H, H)
    bias: Float32  # (4 H,), of input and state together

    @property
    def units(self) -> int:
        """H, the width of h, of c and of the output."""
        return int(self.state_weight.shape[1])


Activation = Tanh | Sigmoid | Silu | Softsign | Erf | Softplus | Relu | LeakyRelu | Elu | Clip
Elementwise = Affine | Activation | Add | Multiply | Select  # each element from the same of the inputs
Norm = LayerNorm | RmsNorm
Stateless = Elementwise | Linear | Norm | Softmax | Concat | Slice
Recurrent = Gru | Lstm
Operation = Stateless | Recurrent  # a new one: mypy then lists every `match` that lacks it
