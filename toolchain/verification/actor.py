"""The actor of a checkpoint in torch, as training had it, before anything was folded."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from neuroflight.toolchain.errors import PolicyError
from neuroflight.toolchain.policy.freeze import load_checkpoint

Float32 = NDArray[np.float32]
State = Mapping[str, NDArray[Any]]


def read_actor(checkpoint: Path) -> Callable[[Float32], Float32]:
    """Return a function from observations (sequences, steps, n) to actions: scaling, memory, layers, output
    map, clip.

    Raises PolicyError, one line. The function raises RuntimeError on observations that do not fit.
    """
    config, state, _ = load_checkpoint(checkpoint)
    try:
        function = {"tanh": torch.tanh, "relu": torch.relu}[config["activation"]]
        scale = torch.tensor(config["observation_scale"], dtype=torch.float32)
        factor, offset = float(config["output"]["scale"]), float(config["output"]["offset"])
        squash = bool(config["output"].get("squash", False))
        memory = _memory(state, config["recurrent"]) if config.get("recurrent", "none") != "none" else None
        count = len(config["hidden"]) - (memory is not None)
        names = [f"mlp_extractor.policy_net.{2 * index}" for index in range(count)]
        layers = [
            (torch.from_numpy(state[f"{name}.weight"]), torch.from_numpy(state[f"{name}.bias"]))
            for name in (*names, "action_net")
        ]
    except (KeyError, TypeError, ValueError, IndexError, RuntimeError) as error:
        raise PolicyError(f"{checkpoint} is a damaged checkpoint: {type(error).__name__} {error}") from error

    def actions(observation: Float32) -> Float32:
        with torch.inference_mode():
            x = torch.from_numpy(observation) * scale
            if memory is not None:
                x, _ = memory(x)
            for weight, bias in layers[:-1]:
                x = function(torch.nn.functional.linear(x, weight, bias))
            x = torch.nn.functional.linear(x, *layers[-1])
            x = (torch.tanh(x) if squash else x) * factor + offset
            return np.asarray(x.clip(0, 1).numpy(), np.float32)

    return actions


def _memory(state: State, kind: str) -> torch.nn.GRU | torch.nn.LSTM:
    """Build the layer from the tensors called "recurrent."."""
    place = "recurrent."
    tensors = {
        name.removeprefix(place): torch.from_numpy(array)
        for name, array in state.items()
        if name.startswith(place)
    }
    inputs, units = (int(tensors[name].shape[1]) for name in ("weight_ih_l0", "weight_hh_l0"))
    memory: torch.nn.GRU | torch.nn.LSTM
    memory = {"gru": torch.nn.GRU, "lstm": torch.nn.LSTM}[kind](inputs, units, batch_first=True)
    memory.load_state_dict(tensors)
    return memory
