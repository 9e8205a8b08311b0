"""The interface between a training run and a learning algorithm."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import torch

Tensors = Mapping[str, torch.Tensor]  # "weight" and "bias" of a layer


@dataclass(frozen=True)
class Report:
    """Progress of a learner, reported after every update."""

    steps: int  # control steps so far, all aircraft together
    reward: float  # mean per control step since the last report; of a loss, its negative
    figures: dict[str, float] = field(default_factory=dict)  # by TensorBoard's names, such as "train/loss"
    note: str = ""  # a line for the user


def named_layers(layers: Sequence[Tensors]) -> dict[str, torch.Tensor]:
    """Name weights and biases of a network's layers as `toolchain.policy.freeze` knows them."""
    names = [f"mlp_extractor.policy_net.{2 * i}" for i in range(len(layers) - 1)] + ["action_net"]
    return {
        f"{name}.{part}": tensor
        for name, layer in zip(names, layers, strict=True)
        for part, tensor in layer.items()
    }


class Learner(Protocol):
    """An algorithm with its aircraft."""

    @property
    def steps(self) -> int:
        """Control steps so far, all aircraft together, including those before the run was resumed."""
        ...

    def learn(self, segment: int, report: Callable[[Report], None]) -> None:
        """Train for a segment, counted from 0: new episodes, and draws that only seed and segment decide."""
        ...

    def policy(self) -> dict[str, torch.Tensor]:
        """Return the deterministic policy's weights by the names that `toolchain.policy.freeze` knows."""
        ...

    def state(self) -> dict[str, Any]:
        """Return all that the next segment needs: plain containers, numbers, text and tensors."""
        ...

    def restore(self, state: dict[str, Any]) -> None:
        """Take over a `state`."""
        ...

    def close(self) -> None:
        """Close the physics client."""
        ...
