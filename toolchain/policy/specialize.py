"""Policies for any aircraft: an ordinary network for each, made of what is told of the aircraft.

A general policy's weights are a sum over a few features of the told numbers, weights_0 + sum f_k weights_k,
and its inputs are counted in units of what the aircraft can do. Both are settled when the policy is
specialized for an aircraft: what flies is an ordinary policy, of one architecture for all aircraft. The
training makes the same sum, so that what it learns is what flies.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from neuroflight.toolchain import contract
from neuroflight.toolchain.contract import ObservationTerm
from neuroflight.toolchain.errors import PolicyError
from neuroflight.toolchain.policy.model_constants import ModelConstants

Array = NDArray[np.float64]
MOTORS = 4  # of the aircraft that a general policy flies
EXPONENT = 0.85  # of the inputs' units by authority; below 1, as the gyro's noise is the same for all
FIRST = (
    "memory_weight",
    "weight0",
)  # of a network that freeze writes: the first of them has a column an input
BASIS = "basis."  # before number and name of the tensors of a general policy's checkpoint
RANGE = 2.0  # features are held within -RANGE..RANGE: beyond, nothing was learned


@dataclass(frozen=True)
class Told:
    """The numbers that a general policy is told of an aircraft."""

    # Roll, pitch, yaw [rad/s^2] for a motor fraction that every motor adds or takes away, as the axis needs,
    # mean over the middle of the motors' range.
    authority: tuple[float, float, float]
    rise_s: float  # time constant of a rotor that gains speed
    fall_s: float  # and that loses speed
    limit_s: float  # in which it would gain all its speed, by a motor's largest torque; 0: no limit
    delay_s: float  # command to rotor
    kick_s: float  # yaw by the rotors' acceleration over yaw by their drag, in hover
    curve: float  # thrust gained a command at 0.2, over the one in the middle of the range
    speed: float  # [rad/s], of a rotor at full command

    def __post_init__(self) -> None:
        """Raise ValueError, one line, on numbers that no aircraft has."""
        positive = (*self.authority, self.rise_s, self.fall_s, self.kick_s, self.curve, self.speed)
        if len(self.authority) != 3 or not all(math.isfinite(value) and value > 0.0 for value in positive):
            raise ValueError(f"told numbers {self}, expected numbers above 0")
        if not all(math.isfinite(value) and value >= 0.0 for value in (self.limit_s, self.delay_s)):
            raise ValueError(f"told numbers {self}, expected times of 0 or more")


# A middle of the aircraft that fly; the features count from here.
REFERENCE = Told((2500.0, 2200.0, 200.0), 0.030, 0.036, 0.0, 0.003, 0.2, 0.7, 2600.0)


def features(told: Told) -> Array:
    """Return what the weights are a sum over, (K,); the first is 1, the others are about -1..1."""
    ref = REFERENCE
    roll, pitch, yaw = told.authority
    turning = math.sqrt(roll * pitch)
    usual = math.sqrt(ref.authority[0] * ref.authority[1])
    response = math.log(told.rise_s / ref.rise_s)
    delay = (told.delay_s - ref.delay_s) / 0.002
    strong = math.log(turning / usual) / 1.2
    found = np.array(
        [
            response,
            math.log(told.fall_s / told.rise_s / (ref.fall_s / ref.rise_s)) / 0.7,
            math.log1p(told.limit_s / told.rise_s) / 1.8,
            delay,
            strong,
            math.log(roll / pitch / (ref.authority[0] / ref.authority[1])) / 0.5,
            math.log(yaw / turning / (ref.authority[2] / usual)) / 0.7,
            math.log(told.kick_s / ref.kick_s) / 0.7,
            math.log(told.curve / ref.curve) / 0.4,
            response * response,
            strong * strong,
            response * delay,
            response * strong,
        ]
    )
    return np.concatenate([[1.0], np.clip(found, -RANGE, RANGE)])


FEATURES = len(features(REFERENCE))


def input_factors(told: Told, terms: Sequence[ObservationTerm]) -> Array:
    """Return the factor (n,) of each input's weights, by what the aircraft can do and its rotors' speed."""
    rates = [
        (usual / own) ** EXPONENT for usual, own in zip(REFERENCE.authority, told.authority, strict=True)
    ]
    made: list[float] = []
    for term in terms:
        if term.name.startswith("rate"):
            made += rates
        elif term.name.startswith("rotor"):
            made += [REFERENCE.speed / told.speed] * MOTORS
        else:
            made += [1.0] * term.count(MOTORS)
    return np.array(made)


def general_document(bases: Sequence[Mapping[str, NDArray[Any]]]) -> str:
    """Return the metadata of a general policy; bases: initializers by name for each feature, as folded."""
    if len(bases) != FEATURES:
        raise ValueError(f"{len(bases)} bases, expected {FEATURES}")
    return json.dumps(
        {
            "features": FEATURES,
            "bases": {
                name: base64.b64encode(
                    np.stack([base[name] for base in bases]).astype("<f4").tobytes()
                ).decode()
                for name in bases[0]
            },
        },
        sort_keys=True,
    )


def is_general(path: Path) -> bool:
    """Return True if a file is a policy for any aircraft, which flies one once it is specialized for it.

    Raises PolicyError if it cannot be read, or is larger than any policy.
    """
    from neuroflight.toolchain.policy.model import parse_model, read_file

    try:
        metadata = parse_model(read_file(path)).metadata_props
    except PolicyError as error:
        raise PolicyError(f"{path}: {error}") from error
    return any(entry.key == contract.META_GENERAL for entry in metadata)


def specialize(
    data: bytes, told: Told, aircraft: str, aircraft_sha256: str, model: ModelConstants | None
) -> bytes:
    """Return the bytes of the policy.onnx of an aircraft: `data`, a general one, specialized.

    model: of the aircraft, where the observation needs one. The same arguments give the same bytes. Raises
    PolicyError, one line, without the file's name.
    """
    import onnx
    from onnx import numpy_helper

    from neuroflight.toolchain.policy.model import parse_model, parse_policy

    made = parse_model(data)
    metadata = {entry.key: entry.value for entry in made.metadata_props}
    policy = parse_policy(data)
    if not policy.general:
        raise PolicyError("the policy is one aircraft's own, expected a general one")
    weights, factors = features(told), input_factors(told, policy.blocks)
    bases = _bases(metadata[contract.META_GENERAL])
    first = next((name for name in FIRST if name in bases), None)
    for tensor in made.graph.initializer:
        if tensor.name not in bases:
            continue
        shape = (FEATURES, *tensor.dims)
        stored = bases.pop(tensor.name)
        if stored.size != math.prod(shape):
            raise _damaged(f"{tensor.name} has {stored.size} numbers, expected {math.prod(shape)}")
        value = np.tensordot(weights, stored.reshape(shape).astype(np.float64), axes=1)
        if tensor.name == first:
            value = value * factors
        tensor.CopyFrom(numpy_helper.from_array(value.astype(np.float32), tensor.name))
    if bases:
        raise _damaged(f"the network has no {next(iter(bases))[:40]!r}")
    del metadata[contract.META_GENERAL]
    metadata |= {
        contract.META_AIRCRAFT: aircraft,
        contract.META_AIRCRAFT_SHA256: aircraft_sha256,
        contract.META_SPECIALIZED: json.dumps(
            {"general_sha256": hashlib.sha256(data).hexdigest(), "told": asdict(told)}, sort_keys=True
        ),
    }
    if model is not None:
        metadata[contract.META_MODEL] = json.dumps(model.document(), sort_keys=True, separators=(",", ":"))
    del made.metadata_props[:]
    for key, text in metadata.items():
        made.metadata_props.append(onnx.StringStringEntryProto(key=key, value=text))
    specialized: bytes = made.SerializeToString(deterministic=True)
    parse_policy(specialized)
    return specialized


def _bases(text: str) -> dict[str, NDArray[np.float32]]:
    try:
        document = json.loads(text)
        if document["features"] != FEATURES:
            raise _damaged(f"of {document['features']} features, expected {FEATURES}; train it anew")
        return {
            str(name): np.frombuffer(base64.b64decode(stored, validate=True), "<f4")
            for name, stored in document["bases"].items()
        }
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError, binascii.Error) as error:
        raise _damaged(type(error).__name__) from error


def _damaged(what: str) -> PolicyError:
    return PolicyError(f"{contract.META_GENERAL} is damaged: {what}")
