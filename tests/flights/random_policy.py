"""Small policies of random weights."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.toolchain.contract import observation_blocks, observation_count
from neuroflight.toolchain.policy.freeze import to_onnx
from neuroflight.toolchain.policy.gyro_filters import UNFILTERED, GyroFilters


def frozen(
    observation: str, idle: float, scale: Sequence[float] = (), filters: GyroFilters = UNFILTERED
) -> bytes:
    """A policy.onnx of random weights, too weak to turn the aircraft faster than its gyro's full scale.

    scale: of each number that it observes; default 0.5.
    """
    rng = np.random.default_rng(8)
    inputs = observation_count(observation_blocks(observation), 4)
    state = {}
    for name, outputs, width, size in (
        ("mlp_extractor.policy_net.0", 16, inputs, 1.0),
        ("mlp_extractor.policy_net.2", 16, 16, 1.0),
        ("action_net", 4, 16, 0.1),
    ):
        state[f"{name}.weight"] = rng.normal(0, size * width**-0.5, (outputs, width)).astype(np.float32)
        state[f"{name}.bias"] = rng.normal(0, 0.1 * size, outputs).astype(np.float32)
    aircraft = load_aircraft("nf1")
    config = {
        "aircraft": {"name": aircraft.name, "sha256": aircraft.sha256},
        "observation": observation,
        "observation_scale": list(scale) or [0.5] * inputs,
        "control_rate_hz": 1000,
        "filters": filters.chain,
        "hidden": [16, 16],
        "activation": "tanh",
        "output": {"scale": 0.5, "offset": 0.4, "squash": True},
        "idle": idle,
        "motors": 4,
    }
    return to_onnx(config, state)
