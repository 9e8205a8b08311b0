"""Makes a policy of an ONNX model that another trainer exported: names, fixed shapes, metadata, range.

Nothing that computes is changed but what the user asked for: the model keeps its nodes and weights.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from toolchain import contract
from toolchain.errors import PolicyError
from toolchain.files import file_size, write_bytes
from toolchain.policy.model import PolicyModel, parse_model, parse_policy, read_file
from toolchain.policy.model_constants import ModelConstants
from toolchain.reader.checks import check_parts
from toolchain.reader.external import embed_weights
from toolchain.reader.output_range import UnboundedError

if TYPE_CHECKING:
    import onnx

CLIP_NAMES = ("neuroflight/unclipped", "neuroflight/low", "neuroflight/high")
CHECKPOINT_STARTS = (b"PK", b"\x80")  # torch's zip archive and the pickle it wrote before


@dataclass(frozen=True)
class PolicyClaims:
    """What the user says about a model that does not say it itself."""

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
    """Whether the file is torch's rather than an ONNX model. Raises PolicyError when it is neither."""
    try:
        file_size(path)  # raises for a pipe or a device, which would not end
        with path.open("rb") as file:
            if file.read(2).startswith(CHECKPOINT_STARTS):
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
    source: Path, out: Path, claims: PolicyClaims, *, clip: bool, output: str | None = None
) -> tuple[PolicyModel, Sequence[str]]:
    """Write the policy of the ONNX file `source` to `out`; returns it and what was changed, in words.

    clip: append a Clip to [0, 1] where nothing else keeps the motor fractions there.
    output: which output of the model is the action, where it has several.
    Raises PolicyError, one line; then nothing is written.
    """
    data = read_file(source)
    try:
        data, embedded = _in_one_file(data, source.parent)
        imported, changes = imported_model(data, claims, clip=clip, output=output)
        policy = parse_policy(imported)
        if policy.action_count != claims.motors:
            raise PolicyError(
                f"the policy drives {policy.action_count} motors, aircraft {claims.aircraft} has "
                f"{claims.motors}; name the aircraft it was trained for"
            )
    except PolicyError as error:
        raise PolicyError(f"{source}: {error}") from error
    write_bytes(out, imported)
    return policy, [*embedded, *changes]


def imported_model(
    data: bytes, claims: PolicyClaims, *, clip: bool, output: str | None = None
) -> tuple[bytes, Sequence[str]]:
    """The bytes of the policy, and what was changed. Raises PolicyError where it cannot be read back."""
    model, changes = parse_model(data), list[str]()
    check_parts(model)
    graph = model.graph
    del graph.value_info[:]  # shapes that were inferred for any batch
    if output is not None:
        changes += _choose(graph, output)
    given = {tensor.name for tensor in graph.initializer}
    for values, name, role in (
        ([value for value in graph.input if value.name not in given], contract.POLICY_INPUT, "input"),
        (list(graph.output), contract.POLICY_OUTPUT, "output"),
    ):
        if len(values) != 1:
            names = ", ".join(repr(value.name) for value in values[:8]) or "none"
            hint = (
                "choose one with --output" if role == "output" else "state is carried by GRU and LSTM nodes"
            )
            raise PolicyError(f"the model's {role}s are {names}, expected one; {hint}")
        changes += _rename(graph, values[0], name, role)
        changes += _fix_shape(values[0], claims.motors if role == "output" else None)
    _describe(model, claims, hashlib.sha256(data).hexdigest())
    imported = _bytes(model)
    try:
        parse_policy(imported)
    except UnboundedError:
        if not clip:
            raise
        _append_clip(graph)
        changes.append("appended a Clip to [0, 1]")
        imported = _bytes(model)
        parse_policy(imported)
    return imported, changes


def _in_one_file(data: bytes, folder: Path) -> tuple[bytes, list[str]]:
    """The model with the weights that lie in files beside it, and what that changed."""
    model = parse_model(data)
    check_parts(model)
    if not (files := embed_weights(model, folder)):
        return data, []
    return _bytes(model), [f"took the weights out of {', '.join(map(repr, files))}"]


def _choose(graph: onnx.GraphProto, output: str) -> list[str]:
    """Leave the graph's output `output` and what it needs: no critic, no probabilities."""
    names = [value.name for value in graph.output]
    if output not in names:
        listed = ", ".join(map(repr, names[:8])) or "none"
        raise PolicyError(f"the model has no output {output!r}, its outputs are {listed}")
    needed, nodes = {output}, []
    for node in reversed(graph.node):
        if needed.intersection(node.output):
            needed.update(filter(None, node.input))
            nodes.append(node)
    chosen = graph.output[names.index(output)]
    tensors = [tensor for tensor in graph.initializer if tensor.name in needed]
    dropped = len(graph.node) - len(nodes)
    for kept, field in (([chosen], graph.output), (nodes[::-1], graph.node), (tensors, graph.initializer)):
        copies = [type(item).FromString(item.SerializeToString()) for item in kept]
        del field[:]
        field.extend(copies)
    return [f"kept the output {output!r}, dropped {len(names) - 1} other(s) and {dropped} node(s)"]


def _rename(graph: onnx.GraphProto, value: onnx.ValueInfoProto, new: str, role: str) -> list[str]:
    """Call the model's one input or output `new`, wherever it is named."""
    old = value.name
    if old == new:
        return []
    if any(new in (*node.input, *node.output) for node in graph.node):
        raise PolicyError(f"the {role} {old!r} cannot be named {new!r}: a value inside the model is")
    value.name = new
    for node in graph.node:
        for names in (node.input, node.output):
            for place, name in enumerate(names):
                if name == old:
                    names[place] = new
    return [f"renamed the {role} {old!r} to {new!r}"]


def _fix_shape(value: onnx.ValueInfoProto, width: int | None) -> list[str]:
    """Make a dynamic batch 1, and a dynamic width `width` where that is known."""
    sizes = value.type.tensor_type.shape.dim
    changes = []
    for place, size in enumerate(sizes[:2] if len(sizes) == 2 else ()):
        fixed = 1 if place == 0 else width
        if fixed is not None and not size.HasField("dim_value"):
            changes.append(f"fixed axis {place} of {value.name!r} to {fixed}")
            size.dim_value = fixed
    return changes


def _describe(model: onnx.ModelProto, claims: PolicyClaims, source_sha256: str) -> None:
    """Put the metadata of a policy in the place of any that is there."""
    import onnx

    kept = [entry for entry in model.metadata_props if not entry.key.startswith("neuroflight.")]
    producer = f"{model.producer_name} {model.producer_version}".strip()
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


def _append_clip(graph: onnx.GraphProto) -> None:
    import numpy as np
    from onnx import helper, numpy_helper

    unclipped, low, high = CLIP_NAMES
    for node in graph.node:
        for names in (node.input, node.output):
            for place, name in enumerate(names):
                if name == contract.POLICY_OUTPUT:
                    names[place] = unclipped
    graph.initializer.append(numpy_helper.from_array(np.array(0, np.float32), low))
    graph.initializer.append(numpy_helper.from_array(np.array(1, np.float32), high))
    node = helper.make_node("Clip", [unclipped, low, high], [contract.POLICY_OUTPUT], name="neuroflight/clip")
    graph.node.append(node)


def _bytes(model: onnx.ModelProto) -> bytes:
    return bytes(model.SerializeToString(deterministic=True))
