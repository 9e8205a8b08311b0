"""Makes a policy of an ONNX model that another trainer exported: opset, ends, state, metadata, range.

The model is read into a network, which is written anew: no later stage sees the exporter's form. Each change
is reported in a line; the network computes the same as the model.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from neuroflight.toolchain import contract
from neuroflight.toolchain.errors import PolicyError
from neuroflight.toolchain.files import file_size, write_bytes
from neuroflight.toolchain.policy.file_kind import foreign_kind
from neuroflight.toolchain.policy.model import PolicyModel, parse_model, parse_policy, read_file
from neuroflight.toolchain.policy.model_constants import ModelConstants
from neuroflight.toolchain.reader.checks import check_parts
from neuroflight.toolchain.reader.external import embed_weights

if TYPE_CHECKING:
    import onnx

    from neuroflight.toolchain.policy.foreign_network import Adopted

    Proof = Callable[[bytes, Adopted], str]  # of the model's bytes; raises PolicyError where they differ
    from neuroflight.toolchain.policy.output_map import OutputRange

CHECKPOINT_STARTS = (b"PK", b"\x80")  # torch's zip archive and the pickle it wrote before


@dataclass(frozen=True)
class PolicyClaims:
    """The user's statements about a model that does not contain them itself."""

    observation: str  # comma-separated blocks
    control_rate_hz: int
    filters: str  # JSON list
    aircraft: str
    aircraft_sha256: str
    motors: int
    idle: float = contract.IDLE_DEFAULT  # motor fraction without thrust that it was trained with
    mix: contract.Mix = contract.Mix.ATTITUDE_FIRST  # of outputs and throttle
    model: ModelConstants | None = None  # of the aircraft, where the observation needs it


def is_checkpoint(path: Path) -> bool:
    """Return True if the file is torch's, False if an ONNX model. Raises PolicyError if it is neither."""
    try:
        size = file_size(path)  # raises for a pipe or a device, which would not end
        with path.open("rb") as file:
            start = file.read(2)
            if start.startswith(CHECKPOINT_STARTS) and size <= contract.CHECKPOINT_FILE_BYTES_MAX:
                kind = foreign_kind(start + file.read())
                if kind is not None:
                    raise PolicyError(f"{path} is no checkpoint and no ONNX model: it is {kind}")
            if start.startswith(CHECKPOINT_STARTS):
                return True
    except OSError as error:
        raise PolicyError(f"cannot read {path}: {error.strerror}") from error
    data = read_file(path)
    try:
        known = parse_model(data).HasField("graph")
    except PolicyError:
        known = False
    if not known:
        raise PolicyError(f"{path} is no checkpoint and no ONNX model, or damaged")
    return False


def import_onnx(
    source: Path,
    out: Path,
    claims: PolicyClaims,
    *,
    clip: bool,
    output: str | None = None,
    output_range: OutputRange | None = None,
    input_order: Sequence[str] | None = None,
    constants: Mapping[str, float] | None = None,
    prove: Proof | None = None,
) -> tuple[PolicyModel, Sequence[str]]:
    """Write the policy of the ONNX file `source` to `out`; return it and descriptions of all changes.

    clip: append a Clip to [0, 1] unless the model limits the motor fractions to that itself.
    output: which output of the model is the action, where it has several.
    output_range: the range of its outputs, which is mapped to motor fractions 0 to 1 and clipped.
    input_order: the inputs that make up the observation, in order, where there are several.
    constants: values of inputs that the firmware does not have.
    prove: compares the model with the result; its text comes last in the descriptions.
    Raises PolicyError, one line; then nothing is written.
    """
    data = read_file(source)
    try:
        data, embedded = _in_one_file(data, source.parent)
        imported, changes = imported_model(
            data,
            claims,
            clip=clip,
            output=output,
            output_range=output_range,
            input_order=input_order,
            constants=constants,
            prove=prove,
        )
        policy = parse_policy(imported)
        if policy.action_count != claims.motors:
            mend = (
                "if half of these are standard deviations, export the mean alone"
                if policy.action_count == 2 * claims.motors
                else "name the aircraft it was trained for"
            )
            raise PolicyError(
                f"the policy drives {policy.action_count} motors, aircraft {claims.aircraft} has "
                f"{claims.motors}; {mend}"
            )
    except PolicyError as error:
        raise PolicyError(f"{source}: {error}") from error
    write_bytes(out, imported)
    return policy, [*embedded, *changes]


def imported_model(
    data: bytes,
    claims: PolicyClaims,
    *,
    clip: bool,
    output: str | None = None,
    output_range: OutputRange | None = None,
    input_order: Sequence[str] | None = None,
    constants: Mapping[str, float] | None = None,
    prove: Proof | None = None,
) -> tuple[bytes, Sequence[str]]:
    """Return the bytes of the policy, and the changes. Raises PolicyError if it cannot be read back."""
    from neuroflight.toolchain.ir.onnx_export import to_model
    from neuroflight.toolchain.policy.foreign_ends import Ends
    from neuroflight.toolchain.policy.foreign_model import (
        convert_opset,
        fix_inputs,
        give_shapes,
        inline_functions,
        keep_outputs,
        lower_scalers,
    )
    from neuroflight.toolchain.policy.foreign_network import read_foreign
    from neuroflight.toolchain.policy.output_map import clip_output, map_output
    from neuroflight.toolchain.reader.checks import check_model
    from neuroflight.toolchain.reader.output_range import UnboundedError, bounded

    model, changes = parse_model(data), list[str]()
    check_parts(model, functions=True)
    changes += inline_functions(model)
    check_parts(model)
    give_shapes(model.graph)
    changes += fix_inputs(model.graph, constants or {})
    original = _bytes(model)
    _, dead = keep_outputs(model.graph, {value.name for value in model.graph.output})
    if dead:
        changes.append(f"dropped {dead} node(s) that no output needs")
    changes += lower_scalers(model.graph)
    changes += convert_opset(model)
    check_model(model, float64=True)
    order = None if input_order is None else tuple(input_order)
    adopted = read_foreign(model, Ends(output, order, _terms(claims), claims.motors))
    network, changes = adopted.network, [*changes, *adopted.changes]
    if wide := _float64(model):
        changes.append(f"computes in float32 what the model has in float64: {wide}")
    if output_range is not None:
        network, more = map_output(network, output_range)
        changes += more
        clip = True
    try:
        network = bounded(network)
    except UnboundedError:
        if not clip:
            raise
        network, more = clip_output(network)
        changes += more if output_range is None else []
    policy = to_model(network)
    policy.metadata_props.extend(model.metadata_props)
    producer = f"{model.producer_name} {model.producer_version}".strip()
    _describe(policy, claims, producer, hashlib.sha256(data).hexdigest())
    imported = _bytes(policy)
    parse_policy(imported)
    return imported, changes if prove is None else [*changes, prove(original, adopted)]


def _terms(claims: PolicyClaims) -> tuple[tuple[str, int], ...] | None:
    """Return the observation's terms and widths; None for an invalid one, which is refused later."""
    try:
        blocks = contract.observation_blocks(claims.observation)
    except ValueError:
        return None
    return tuple((block.text, block.count(claims.motors)) for block in blocks)


def _float64(model: onnx.ModelProto) -> str:
    """Describe what a model has in float64; "" if nothing."""
    from onnx import TensorProto

    from neuroflight.toolchain.policy.foreign_model import listed

    names = [v.name for v in model.graph.input if v.type.tensor_type.elem_type == TensorProto.DOUBLE]
    names += [tensor.name for tensor in model.graph.initializer if tensor.data_type == TensorProto.DOUBLE]
    return listed(list(dict.fromkeys(names))) if names else ""


def _in_one_file(data: bytes, folder: Path) -> tuple[bytes, list[str]]:
    """Move weights from files beside the model into it; return it and the changes."""
    model = parse_model(data)
    check_parts(model, functions=True)
    if not (files := embed_weights(model, folder)):
        return data, []
    return _bytes(model), [f"took the weights out of {', '.join(map(repr, files))}"]


def _describe(model: onnx.ModelProto, claims: PolicyClaims, producer: str, source_sha256: str) -> None:
    """Put the metadata of a policy in the place of any that is there."""
    import onnx

    kept = [entry for entry in model.metadata_props if not entry.key.startswith("neuroflight.")]
    training = {"producer": producer, "source_sha256": source_sha256}
    metadata = {
        contract.META_VERSION: contract.POLICY_FORMAT_VERSION,
        contract.META_OBSERVATION: claims.observation,
        contract.META_CONTROL_RATE: str(claims.control_rate_hz),
        contract.META_FILTERS: claims.filters,
        contract.META_IDLE: repr(claims.idle),
        contract.META_AIRCRAFT: claims.aircraft,
        contract.META_AIRCRAFT_SHA256: claims.aircraft_sha256,
        contract.META_TRAINING: json.dumps(training, sort_keys=True, separators=(",", ":")),
    }
    if claims.mix is not contract.Mix.ATTITUDE_FIRST:
        metadata[contract.META_MIX] = claims.mix.text
    if claims.model is not None:
        metadata[contract.META_MODEL] = json.dumps(claims.model.document(), separators=(",", ":"))
    entries = [onnx.StringStringEntryProto(key=key, value=text) for key, text in metadata.items()]
    del model.metadata_props[:]
    model.metadata_props.extend([*kept, *entries])


def _bytes(model: onnx.ModelProto) -> bytes:
    return bytes(model.SerializeToString(deterministic=True))
