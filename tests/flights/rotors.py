"""Small policies that observe rotor speeds."""

from __future__ import annotations

import json

import onnx

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.control.estimator import model_constants
from neuroflight.toolchain.contract import META_MODEL
from tests.flights.random_policy import frozen

OBSERVATION = "rate_error,rotor_speed,rotor_speed@2"


def observer() -> bytes:
    """A policy of random weights that turns its aircraft a little, by rate errors and rotor speeds."""
    return frozen(OBSERVATION, 0.1, [0.5] * 3 + [0.001] * 8)


def with_model(policy: bytes) -> bytes:
    """The same policy with a model of its aircraft."""
    model = onnx.load_from_string(policy)
    constants = model_constants(load_aircraft("nf1"), 1000).document()
    entry = onnx.StringStringEntryProto(key=META_MODEL, value=json.dumps(constants))
    model.metadata_props.append(entry)
    whole: bytes = model.SerializeToString()
    return whole
