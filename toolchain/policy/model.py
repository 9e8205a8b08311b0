"""The policy as the toolchain knows it: what it observes, at which rate, and the network inside.

`read_policy` checks all of it: a PolicyModel is complete, finite, float32, of fixed shape and bounded.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from neuroflight.toolchain import contract
from neuroflight.toolchain.contract import Mix, ObservationTerm
from neuroflight.toolchain.errors import PolicyError
from neuroflight.toolchain.files import file_size
from neuroflight.toolchain.ir.network import Network
from neuroflight.toolchain.policy.file_kind import foreign_kind
from neuroflight.toolchain.policy.gyro_filters import GyroFilters
from neuroflight.toolchain.policy.model_constants import ModelConstants

if TYPE_CHECKING:
    import onnx

AIRCRAFT_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,31}")  # it is printed into C: no quotes, no escapes
SHA256 = re.compile(r"[0-9a-f]{64}")
IDLE = re.compile(r"[0-9]{1,3}(\.[0-9]{1,20})?(e-[0-9]{1,2})?")
FREEZE = (
    "add them with `neuroflight policy import MODEL.onnx --observation BLOCKS --rate HZ --aircraft NAME "
    "--out POLICY.onnx`"
)


@dataclass(frozen=True, eq=False)
class PolicyModel:
    """A policy: a pure function of named observation blocks, to be called at its control rate."""

    blocks: tuple[ObservationTerm, ...]
    control_rate_hz: int
    filters: tuple[object, ...]  # the gyro filter chain that the policy was trained behind
    aircraft: str
    aircraft_sha256: str
    training: Mapping[str, object]  # what is known about its training, for people
    source_sha256: str  # of the ONNX file
    network: Network  # ends with a Clip within [0, 1]
    idle: float = contract.IDLE_DEFAULT  # motor fraction without thrust that it was trained with
    mix: Mix = Mix.ATTITUDE_FIRST  # of its outputs with the pilot's thrust
    model: ModelConstants | None = None  # of its aircraft; where the observation needs it
    general: bool = False  # whether it can be specialized for other aircraft: specialize.py
    specialized: bool = False  # made of such a one: its image arms only once motors and gyro were checked

    @property
    def observation_count(self) -> int:
        """Number of values of an observation."""
        return self.network.inputs

    @property
    def action_count(self) -> int:
        """Number of motors."""
        return self.network.outputs

    @property
    def gyro_filters(self) -> GyroFilters:
        """The chain of `filters`. Raises PolicyError, one line, on one that is not known here."""
        try:
            return GyroFilters.of(self.filters)
        except ValueError as error:
            raise PolicyError(
                f"the policy was trained behind {error}; train it behind one of these"
            ) from None

    @property
    def observation(self) -> str:
        """The observation's terms, comma-separated, as in the metadata."""
        return ",".join(term.text for term in self.blocks)


def read_policy(path: Path) -> PolicyModel:
    """Read the policy in the ONNX file `path`. Raises PolicyError, one line, unless it is proven valid."""
    data = read_file(path)
    try:
        return parse_policy(data)
    except PolicyError as error:
        raise PolicyError(f"{path}: {error}") from error


def read_file(path: Path) -> bytes:
    """Read the bytes of an ONNX file. Raises PolicyError if it is missing or larger than any policy."""
    try:
        size = file_size(path)
        with path.open("rb") as file:
            data = file.read(contract.POLICY_FILE_BYTES_MAX)
    except OSError as error:
        raise PolicyError(f"cannot read the policy {path}: {error.strerror}") from error
    if (kind := foreign_kind(data)) is not None:
        raise PolicyError(f"{path} is no ONNX model: it is {kind}")
    if size > contract.POLICY_FILE_BYTES_MAX:
        raise PolicyError(
            f"{path} is {size} bytes, expected at most {contract.POLICY_FILE_BYTES_MAX}; is it a policy?"
        )
    return data


def parse_policy(data: bytes) -> PolicyModel:
    """Parse the policy in an ONNX file's bytes. Raises PolicyError, one line, without the file's name."""
    from neuroflight.toolchain.reader.graph import read_network

    model = parse_model(data)
    metadata = {entry.key: entry.value for entry in model.metadata_props if isinstance(entry.key, str)}
    if model.HasField("graph") and not any(key.startswith("neuroflight.") for key in metadata):
        raise PolicyError(f"an ONNX model without metadata; {FREEZE}")
    network = read_network(model)
    return _describe(metadata, hashlib.sha256(data).hexdigest(), network)


def parse_model(data: bytes) -> onnx.ModelProto:
    """Parse the ONNX model in `data`, unchecked. Raises PolicyError if it is none."""
    import onnx  # a third of a second that commands without a policy need not wait for
    from google.protobuf.message import DecodeError

    try:
        return onnx.load_model_from_string(data)
    except DecodeError as error:
        archive = data.startswith(b"PK")
        hint = (
            "a checkpoint, which `neuroflight policy import` makes a policy of"
            if archive
            else "or a truncated one"
        )
        raise PolicyError(f"not an ONNX file, {hint}; export it again") from error


def _describe(metadata: Mapping[str, str], sha256: str, network: Network) -> PolicyModel:
    """Join the metadata of the file to its network. Raises PolicyError naming the key that does not fit."""
    version = _value(metadata, contract.META_VERSION)
    if version != contract.POLICY_FORMAT_VERSION:
        raise _wrong(contract.META_VERSION, version, f'"{contract.POLICY_FORMAT_VERSION}"')
    names = _value(metadata, contract.META_OBSERVATION)
    try:
        blocks = contract.observation_blocks(names)
    except ValueError as error:
        raise _wrong(contract.META_OBSERVATION, names, f"known blocks: {error}") from error
    rate = _value(metadata, contract.META_CONTROL_RATE)
    if not re.fullmatch("[1-9][0-9]{0,3}", rate) or int(rate) > contract.GYRO_EDGE_RATE_HZ:
        raise _wrong(
            contract.META_CONTROL_RATE,
            rate,
            f"a whole number of hertz up to {contract.GYRO_EDGE_RATE_HZ}, the most that a gyro samples at",
        )
    try:
        contract.check_cutoffs(blocks, int(rate))
    except ValueError as error:
        raise PolicyError(f"{contract.META_OBSERVATION}: {error}") from error
    aircraft = _value(metadata, contract.META_AIRCRAFT)
    if not AIRCRAFT_NAME.fullmatch(aircraft):
        raise _wrong(contract.META_AIRCRAFT, aircraft, "at most 32 letters, digits, dots and dashes")
    aircraft_sha256 = _value(metadata, contract.META_AIRCRAFT_SHA256)
    if not SHA256.fullmatch(aircraft_sha256):
        raise _wrong(contract.META_AIRCRAFT_SHA256, aircraft_sha256, "64 hexadecimal digits")
    width, actions = network.inputs, network.outputs
    if (expected := contract.observation_count(blocks, actions)) != width:
        raise PolicyError(
            f"the policy takes {width} values, but its blocks {names} make {expected} with {actions} motors"
        )
    return PolicyModel(
        blocks=blocks,
        control_rate_hz=int(rate),
        filters=tuple(_json(metadata, contract.META_FILTERS, list)),
        aircraft=aircraft,
        aircraft_sha256=aircraft_sha256,
        training=_json(metadata, contract.META_TRAINING, dict),
        source_sha256=sha256,
        network=network,
        idle=_idle(metadata),
        mix=_mix(metadata),
        model=_model(metadata, blocks, actions),
        general=contract.META_GENERAL in metadata,
        specialized=contract.META_SPECIALIZED in metadata,
    )


def _mix(metadata: Mapping[str, str]) -> Mix:
    text = metadata.get(contract.META_MIX, Mix.ATTITUDE_FIRST.text)
    try:
        return Mix.of(text)
    except ValueError as error:
        raise _wrong(contract.META_MIX, text, " or ".join(mix.text for mix in Mix)) from error


def _model(
    metadata: Mapping[str, str], blocks: tuple[ObservationTerm, ...], motors: int
) -> ModelConstants | None:
    """Read the model's constants; None if the observation needs none, and welcomes none that is there."""
    welcome = contract.welcomes_model(blocks) and contract.META_MODEL in metadata
    if not welcome and not contract.needs_model(blocks):
        return None
    document = _json(metadata, contract.META_MODEL, dict)
    try:
        model = ModelConstants.of(document)
    except ValueError as error:
        raise PolicyError(
            f"{contract.META_MODEL}: {error}; write the policy with `neuroflight policy import`"
        ) from error
    if model.motor_count != motors:
        raise PolicyError(
            f"{contract.META_MODEL} is of {model.motor_count} motors, the policy drives {motors}"
        )
    return model


def _idle(metadata: Mapping[str, str]) -> float:
    text = metadata.get(contract.META_IDLE, str(contract.IDLE_DEFAULT))
    if not IDLE.fullmatch(text) or not 0.0 <= float(text) <= contract.IDLE_MAX:
        raise _wrong(contract.META_IDLE, text, f"a motor fraction of 0 to {contract.IDLE_MAX}")
    return float(text)


def _value(metadata: Mapping[str, str], key: str) -> str:
    if key not in metadata:
        raise PolicyError(f"the metadata lack {key}; {FREEZE}")
    return metadata[key]


Container = TypeVar("Container", list[object], dict[str, object])


def _json(metadata: Mapping[str, str], key: str, kind: type[Container]) -> Container:
    text = _value(metadata, key)
    try:
        value = json.loads(text)
    except (ValueError, RecursionError):
        value = None
    if not isinstance(value, kind):
        raise _wrong(key, text, "a JSON list" if kind is list else "a JSON object")
    return value


def _wrong(key: str, value: str, expected: str) -> PolicyError:
    shown = value if len(value) <= 60 else value[:57] + "..."
    return PolicyError(
        f"{key} is {shown!r}, expected {expected}; write the policy with `neuroflight policy import`"
    )
