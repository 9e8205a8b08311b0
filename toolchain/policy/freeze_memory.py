"""The memory of a recurrent policy in policy.onnx: its first layer, as torch's exporter writes it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from neuroflight.toolchain.errors import PolicyError

Matrix = NDArray[np.float64]
# Where ONNX has the gates of torch's rows: update, reset, new; input, output, forget, cell.
KINDS = {"gru": (1, 0, 2), "lstm": (0, 3, 1, 2)}
_NAMES = ("weight_ih", "weight_hh", "bias_ih", "bias_hh")


def tensor(state: Mapping[str, ArrayLike], key: str, shape: tuple[int, ...]) -> Matrix:
    """Return a checkpoint's tensor. Raises PolicyError naming it where it is missing or does not fit."""
    if key not in state:
        raise PolicyError(f"the checkpoint lacks the tensor {key!r}")
    array = np.asarray(state[key])
    if array.shape != shape or array.dtype != np.float32:
        got = f"{array.dtype} {list(array.shape)}"
        raise PolicyError(f"tensor {key!r} is {got}, expected float32 {list(shape)}")
    return array.astype(np.float64)


@dataclass(frozen=True, eq=False)
class Memory:
    """Weights of H units with n inputs, rows by gates as torch has them.

    G gates: a GRU's reset, update, new; an LSTM's input, forget, cell, output.
    """

    kind: str  # "gru" or "lstm"
    weight: Matrix  # (GH, n)
    state_weight: Matrix  # (GH, H)
    bias: Matrix  # (GH,)
    state_bias: Matrix  # (GH,)

    @property
    def units(self) -> int:
        """H."""
        return int(self.state_weight.shape[1])

    @staticmethod
    def of(kind: str, state: Mapping[str, ArrayLike], inputs: int, units: int) -> Memory:
        """Build the memory from a checkpoint's tensors. Raises PolicyError naming one that does not fit."""
        size = len(KINDS[kind]) * units
        shapes = zip(_NAMES, ((size, inputs), (size, units), (size,), (size,)), strict=True)
        return Memory(kind, *(tensor(state, f"recurrent.{name}_l0", shape) for name, shape in shapes))

    def scaled(self, factors: Matrix) -> Memory:
        """Return the memory for inputs that are not yet multiplied by `factors` (n,)."""
        return Memory(self.kind, self.weight * factors, self.state_weight, self.bias, self.state_bias)

    def onnx_arrays(self) -> dict[str, Matrix]:
        """Return W (1, GH, n), R (1, GH, H) and B (1, 2GH) of the ONNX operator."""

        def ordered(values: Matrix) -> Matrix:
            places = KINDS[self.kind]
            gates = np.split(values, len(places))
            return np.concatenate([gates[place] for place in places])

        biases = np.concatenate([ordered(self.bias), ordered(self.state_bias)])
        return {
            "memory_weight": ordered(self.weight)[None],
            "memory_state_weight": ordered(self.state_weight)[None],
            "memory_bias": biases[None],
        }

    def onnx_nodes(self, value: str, result: str) -> list[Any]:
        """Make nodes from the row `value` (1, n) to `result` (1, H); `memory_axis` is the tensor [0]."""
        from onnx import helper

        weights = list(self.onnx_arrays())
        outputs = ["", "memory_after"]
        options: dict[str, Any] = {"hidden_size": self.units} | (
            {"linear_before_reset": 1} if self.kind == "gru" else {}
        )
        operator = self.kind.upper()
        return [
            helper.make_node("Unsqueeze", [value, "memory_axis"], ["memory_sequence"], name="sequence"),
            helper.make_node(operator, ["memory_sequence", *weights], outputs, name="memory", **options),
            helper.make_node("Squeeze", ["memory_after", "memory_axis"], [result], name="remembered"),
        ]
