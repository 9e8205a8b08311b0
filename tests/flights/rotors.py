"""Small policies that observe rotor speeds."""

from __future__ import annotations

import json

import numpy as np
import onnx

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.control.estimator import model_constants
from neuroflight.toolchain.contract import META_MODEL, observation_blocks, observation_count
from neuroflight.toolchain.policy.freeze import to_onnx

OBSERVATION = "rate_error,rotor_speed,rotor_speed@2"


def observer() -> bytes:
    """A policy of random weights that turns its aircraft a little, by rate errors and rotor speeds."""
    rng = np.random.default_rng(8)
    inputs = observation_count(observation_blocks(OBSERVATION), 4)
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
        "observation": OBSERVATION,
        "observation_scale": [0.5] * 3 + [0.001] * 8,
        "control_rate_hz": 1000,
        "filters": [],
        "hidden": [16, 16],
        "activation": "tanh",
        "output": {"scale": 0.5, "offset": 0.4, "squash": True},
        "idle": 0.1,
        "motors": 4,
    }
    return to_onnx(config, state)


def with_model(policy: bytes) -> bytes:
    """The same policy with a model of its aircraft."""
    model = onnx.load_from_string(policy)
    constants = model_constants(load_aircraft("nf1"), 1000).document()
    entry = onnx.StringStringEntryProto(key=META_MODEL, value=json.dumps(constants))
    model.metadata_props.append(entry)
    whole: bytes = model.SerializeToString()
    return whole
