"""Policies that must not fly: good ones with one thing broken, as files on the way to a board may be."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import numpy_helper

from neuroflight.toolchain.contract import (
    META_IDLE,
    META_MIX,
    META_OBSERVATION,
    observation_blocks,
    observation_count,
)

MOTORS = 4
LAYERS = ("weight0", "weight1", "weight2")
Weights = dict[str, NDArray[Any]]
Mutilation = Callable[[onnx.ModelProto, Weights], None]


def mutilate(source: Path, out: Path, how: Mutilation) -> Path:
    """Write `source` to `out` with weights or metadata changed."""
    model = onnx.load(source)
    weights = {tensor.name: numpy_helper.to_array(tensor).copy() for tensor in model.graph.initializer}
    how(model, weights)
    for tensor in model.graph.initializer:
        tensor.CopyFrom(numpy_helper.from_array(weights[tensor.name].astype(np.float32), tensor.name))
    onnx.save(model, out)
    return out


def _columns(model: onnx.ModelProto, name: str) -> slice:
    """Where a block's values stand in the observation."""
    begin = 0
    text = next(entry.value for entry in model.metadata_props if entry.key == META_OBSERVATION)
    for term in observation_blocks(text):
        width = observation_count((term,), MOTORS)
        if term.text == name:
            return slice(begin, begin + width)
        begin += width
    raise KeyError(name)


def _say(model: onnx.ModelProto, key: str, value: str) -> None:
    for entry in model.metadata_props:
        if entry.key == key:
            entry.value = value


def row_negated(_: onnx.ModelProto, weights: Weights) -> None:
    """Motor 3 answers the wrong way round."""
    weights["weight2"][2] *= -1


def motor_dead(_: onnx.ModelProto, weights: Weights) -> None:
    """Motor 2 never answers."""
    weights["weight2"][1] = 0.0


def motors_exchanged(_: onnx.ModelProto, weights: Weights) -> None:
    """Motors 1 and 2 have each other's outputs."""
    for name in ("weight2", "bias2"):
        weights[name][[0, 1]] = weights[name][[1, 0]]


def louder(_: onnx.ModelProto, weights: Weights) -> None:
    """All weights are a third larger."""
    for name in LAYERS:
        weights[name] *= 1.3


def offset(_: onnx.ModelProto, weights: Weights) -> None:
    """Two motors are asked for a tenth more and less than meant."""
    weights["bias2"][:2] += np.array([0.1, -0.1])


def yaw_unseen(model: onnx.ModelProto, weights: Weights) -> None:
    """The yaw stick does nothing."""
    weights["weight0"][:, _columns(model, "rate_error").start + 2] = 0.0


def moment_unseen(model: onnx.ModelProto, weights: Weights) -> None:
    """Nothing tells of a moment from outside: what the model predicts slowly is taken for the slow rate."""
    first = weights["weight0"]
    first[:, _columns(model, "rate~15Hz")] += first[:, _columns(model, "rate_estimate~15Hz")]
    first[:, _columns(model, "rate_estimate~15Hz")] = 0.0


def coarse(_: onnx.ModelProto, weights: Weights) -> None:
    """Weights have 3 bits: a sign and two."""
    for name in LAYERS:
        step = np.abs(weights[name]).max() / 4
        weights[name] = np.round(weights[name] / step) * step


def noisy(_: onnx.ModelProto, weights: Weights) -> None:
    """Each weight is off by a third."""
    rng = np.random.default_rng(3)
    for name in LAYERS:
        weights[name] *= 1.0 + 0.3 * rng.standard_normal(weights[name].shape)


def clipped(_: onnx.ModelProto, weights: Weights) -> None:
    """The outputs span a twentieth of the range: too weak to turn."""
    weights["low"], weights["high"] = np.array(0.475), np.array(0.525)


def other_mix(model: onnx.ModelProto, _: Weights) -> None:
    """The outputs are added to the throttle, not centred on it."""
    _say(model, META_MIX, "attitude-first")


def other_idle(model: onnx.ModelProto, _: Weights) -> None:
    """The motors never turn slower than a quarter."""
    _say(model, META_IDLE, "0.25")


ALL = (
    *(row_negated, motor_dead, motors_exchanged, louder, offset, yaw_unseen, moment_unseen),
    *(coarse, noisy, clipped, other_mix, other_idle),
)
