"""Turns a training checkpoint into policy.onnx: raw observation in, motor fractions out.

The value network, the exploration noise and the optimizer are left behind; observation scaling and output
mapping are folded into the first and last layer in float64 and rounded once. The ONNX is written with
onnx.helper rather than torch's exporters: torch 2.13 needs the extra package onnxscript for the one and has
deprecated the other, and both write their version into the file, whereas here the same checkpoint gives the
same bytes, hence the same policy hash, whatever torch is installed.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from neuroflight.toolchain import contract
from neuroflight.toolchain.errors import PolicyError
from neuroflight.toolchain.policy.freeze_memory import KINDS, Memory, tensor
from neuroflight.toolchain.policy.plain_checkpoint import ANOTHER_TRAINER, load_plain
from neuroflight.toolchain.policy.specialize import BASIS, FEATURES, general_document

OPSET, IR_VERSION = 17, 8  # old enough for every runtime in use, new enough for every operator here
ACTIVATIONS = {"tanh": "Tanh", "relu": "Relu"}
# By keys of their own.
TOLD = ("aircraft", "observation", "control_rate_hz", "filters", "idle", "mix", "gyro_filter", "model")
TRAINING_VALUE_MAX = 400  # characters of JSON: a longer entry of the configuration is bulk and left out

Matrix = NDArray[np.float64]


@dataclass(frozen=True)
class FrozenConfig:
    """The part of a checkpoint's configuration that decides what the policy computes."""

    aircraft: str
    aircraft_sha256: str
    observation: str  # comma-separated blocks
    observation_scale: tuple[float, ...]  # multiplied onto the raw observation
    control_rate_hz: int
    filters: tuple[object, ...]
    hidden: tuple[int, ...]
    recurrent: str  # the first hidden layer: "gru", "lstm" or, without memory, "none"
    activation: str
    output_scale: float  # motor fraction = clip(output_scale * action + output_offset, 0, 1)
    output_offset: float
    squash: bool  # the network's last sum goes through tanh before scale and offset
    idle: float  # motor fraction without thrust that the policy is trained with
    mix: str  # of outputs and throttle
    model: Mapping[str, object] | None  # constants of its aircraft, where the observation needs them
    motors: int


def freeze(checkpoint: Path, out: Path, *, fold: bool = True) -> None:
    """Write the policy of `checkpoint` to `out`. Raises PolicyError, one line; then nothing is written.

    fold: as of `to_onnx`.
    """
    from neuroflight.toolchain.files import write_bytes

    config, state, progress = load_checkpoint(checkpoint)
    try:
        data = to_onnx(config, state, progress, fold=fold)
    except PolicyError as error:
        raise PolicyError(f"{checkpoint}: {error}") from error
    except RecursionError as error:
        raise PolicyError(
            f"{checkpoint} is a damaged checkpoint: its configuration is nested too deeply"
        ) from error
    write_bytes(out, data)


def load_checkpoint(path: Path) -> tuple[dict[str, Any], dict[str, NDArray[Any]], dict[str, Any]]:
    """Load configuration, policy weights and progress of a checkpoint: plain data only, never code."""
    try:
        content = load_plain(path)
    except OSError as error:
        raise PolicyError(f"cannot read the checkpoint {path}: {error.strerror}") from error
    form = (content.get("format"), content.get("version")) if isinstance(content, dict) else None
    if form != (contract.CHECKPOINT_FORMAT, contract.CHECKPOINT_VERSION):
        expected = f"{contract.CHECKPOINT_FORMAT} version {contract.CHECKPOINT_VERSION}"
        raise PolicyError(
            f"{path} is no checkpoint: expected {expected}, which `neuroflight policy train` writes; "
            f"{ANOTHER_TRAINER}"
        )
    try:
        config, state = json.loads(content["config"]), dict(content["state_dict"])
        arrays = {str(name): np.asarray(tensor.detach().cpu()) for name, tensor in state.items()}
        return dict(config), arrays, dict(content.get("progress", {}))
    except (KeyError, TypeError, ValueError, AttributeError, RuntimeError) as error:
        # RuntimeError: lists within lists without end, or tensors that torch has no values of
        raise PolicyError(f"{path} is a damaged checkpoint: {type(error).__name__} {error}") from error


def to_onnx(
    config: Mapping[str, Any],
    state: Mapping[str, ArrayLike],
    progress: Mapping[str, Any] | None = None,
    *,
    fold: bool = True,
) -> bytes:
    """Build the bytes of policy.onnx. The same arguments give the same bytes.

    config: the checkpoint's configuration (contract: CHECKPOINT_*); entries that decide nothing here are
    kept in the metadata. state: Stable-Baselines3's names to arrays or CPU tensors. progress: counts such
    as the steps trained, kept in the metadata. fold: False leaves the observation's scale and the output's
    map as operations of their own, as they were trained, to compare with. Raises PolicyError naming the
    entry that does not fit.
    """
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    from neuroflight.toolchain.policy.model import parse_policy

    frozen = _frozen_config(config)
    inputs = len(frozen.observation_scale)
    memory, layers = _layers(frozen, state, fold)
    nodes, tensors, value = [], [], contract.POLICY_INPUT
    if not fold:
        scale = _float32(np.array(frozen.observation_scale), "observation's scale")
        tensors.append(numpy_helper.from_array(scale, "observation_scale"))
        nodes.append(helper.make_node("Mul", [value, "observation_scale"], ["observed"], name="observe"))
        value = "observed"
    if memory is not None:
        tensors += [
            numpy_helper.from_array(_float32(array, "weights of the memory"), name)
            for name, array in memory.onnx_arrays().items()
        ]
        tensors.append(numpy_helper.from_array(np.array([0], np.int64), "memory_axis"))
        nodes += memory.onnx_nodes(value, "remembered")
        value = "remembered"
    for index, (weight, bias) in enumerate(layers):
        tensors += [
            numpy_helper.from_array(_float32(weight, f"weights of layer {index}"), f"weight{index}"),
            numpy_helper.from_array(_float32(bias, f"biases of layer {index}"), f"bias{index}"),
        ]
        terms = [value, f"weight{index}", f"bias{index}"]
        nodes.append(helper.make_node("Gemm", terms, [f"sum{index}"], name=f"linear{index}", transB=1))
        value = f"sum{index}"
        if index < len(layers) - 1:
            operator = ACTIVATIONS[frozen.activation]
            nodes.append(helper.make_node(operator, [value], [f"hidden{index}"], name=f"activation{index}"))
            value = f"hidden{index}"
    if frozen.squash or not fold:
        tensors += [
            numpy_helper.from_array(_float32(np.array([number]), f"output {name}"), name)
            for name, number in (("scale", frozen.output_scale), ("offset", frozen.output_offset))
        ]
        if frozen.squash:
            nodes.append(helper.make_node("Tanh", [value], ["bounded"], name="squash"))
            value = "bounded"
        nodes += [
            helper.make_node("Mul", [value, "scale"], ["scaled"], name="scale"),
            helper.make_node("Add", ["scaled", "offset"], ["asked"], name="offset"),
        ]
        value = "asked"
    tensors += [numpy_helper.from_array(np.array(v, np.float32), n) for n, v in (("low", 0), ("high", 1))]
    nodes.append(helper.make_node("Clip", [value, "low", "high"], [contract.POLICY_OUTPUT], name="clip"))
    shapes = ((contract.POLICY_INPUT, inputs), (contract.POLICY_OUTPUT, frozen.motors))
    ends = [helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, n]) for name, n in shapes]
    graph = helper.make_graph(nodes, "policy", ends[:1], ends[1:], tensors)
    opset = helper.make_opsetid("", OPSET)
    model = helper.make_model(
        graph, opset_imports=[opset], ir_version=IR_VERSION, producer_name="neuroflight"
    )
    metadata = _metadata(frozen, config, progress or {})
    if any(name.startswith(f"{BASIS}0.") for name in state):
        metadata[contract.META_GENERAL] = _general(frozen, state)
    for key, text in metadata.items():
        model.metadata_props.append(onnx.StringStringEntryProto(key=key, value=text))
    data: bytes = model.SerializeToString(deterministic=True)
    parse_policy(data)  # whatever is written can be read: its refusals are this function's too
    return data


def _general(frozen: FrozenConfig, state: Mapping[str, ArrayLike]) -> str:
    """Return the metadata of a general policy: the arrays of policy.onnx that each feature weighs."""

    def arrays(part: Mapping[str, ArrayLike]) -> dict[str, Matrix]:
        memory, layers = _layers(frozen, part, fold=True)
        named = {} if memory is None else memory.onnx_arrays()
        for index, (weight, bias) in enumerate(layers):
            named |= {f"weight{index}": weight, f"bias{index}": bias}
        return named

    bases = []
    for number in range(FEATURES):
        start = f"{BASIS}{number}."
        bases.append(
            arrays({n.removeprefix(start): each for n, each in state.items() if n.startswith(start)})
        )
    # The output's map moves a sum's last bias once, not with each of its parts.
    nothing = arrays({name: np.zeros_like(np.asarray(state[f"{BASIS}0.{name}"])) for name in _own(state)})
    for basis in bases[1:]:
        for name in basis:
            basis[name] = basis[name] - nothing[name]
    return general_document([{n: _float32(each, n) for n, each in basis.items()} for basis in bases])


def _own(state: Mapping[str, ArrayLike]) -> list[str]:
    return [name for name in state if not name.startswith(BASIS)]


def _frozen_config(config: Mapping[str, Any]) -> FrozenConfig:
    try:
        frozen = FrozenConfig(
            aircraft=str(config["aircraft"]["name"]),
            aircraft_sha256=str(config["aircraft"]["sha256"]),
            observation=str(config["observation"]),
            observation_scale=tuple(float(scale) for scale in config["observation_scale"]),
            control_rate_hz=int(config["control_rate_hz"]),
            filters=tuple(config["filters"]),
            hidden=tuple(int(width) for width in config["hidden"]),
            recurrent=_recurrent(config),
            activation=str(config["activation"]),
            output_scale=float(config["output"]["scale"]),
            output_offset=float(config["output"]["offset"]),
            squash=bool(config["output"].get("squash", False)),
            idle=float(config.get("idle", contract.IDLE_DEFAULT)),
            mix=str(config.get("mix", contract.Mix.ATTITUDE_FIRST.text)),
            model=config.get("model"),
            motors=int(config["motors"]),
        )
        blocks = contract.observation_blocks(frozen.observation)
    except KeyError as error:
        raise PolicyError(f"the checkpoint's configuration lacks {error.args[0]!r}") from error
    except (TypeError, ValueError, OverflowError) as error:  # OverflowError: an infinite whole number
        raise PolicyError(f"the checkpoint's configuration is damaged: {error}") from error
    if frozen.activation not in ACTIVATIONS:
        raise PolicyError(f"activation is {frozen.activation!r}, expected {' or '.join(ACTIVATIONS)}")
    count = contract.observation_count(blocks, frozen.motors)
    if len(frozen.observation_scale) != count:
        raise PolicyError(f"observation_scale has {len(frozen.observation_scale)} values, expected {count}")
    return frozen


def _recurrent(config: Mapping[str, Any]) -> str:
    if (kind := str(config.get("recurrent", "none"))) not in ("none", *KINDS):
        raise ValueError(f"recurrent is {kind[:40]!r}, expected none or {' or '.join(KINDS)}")
    return kind


def _memory(frozen: FrozenConfig, state: Mapping[str, ArrayLike]) -> Memory | None:
    if frozen.recurrent == "none":
        return None
    return Memory.of(frozen.recurrent, state, len(frozen.observation_scale), frozen.hidden[0])


def _weights(frozen: FrozenConfig, state: Mapping[str, ArrayLike]) -> list[tuple[Matrix, Matrix]]:
    """Return weight (outputs, inputs) and bias (outputs,) of each layer of the policy network, in order.

    These follow the memory, if there is one.
    """
    widths = [len(frozen.observation_scale), *frozen.hidden, frozen.motors][frozen.recurrent != "none" :]
    names = [f"mlp_extractor.policy_net.{2 * i}" for i in range(len(widths) - 2)] + ["action_net"]
    return [
        (tensor(state, f"{name}.weight", (outputs, inputs)), tensor(state, f"{name}.bias", (outputs,)))
        for name, inputs, outputs in zip(names, widths, widths[1:], strict=False)
    ]


def _layers(
    frozen: FrozenConfig, state: Mapping[str, ArrayLike], fold: bool
) -> tuple[Memory | None, list[tuple[Matrix, Matrix]]]:
    """Return the memory and the layers; fold: with the observation's scale and the output's map in them."""
    scale, layers = np.array(frozen.observation_scale), _weights(frozen, state)
    memory = _memory(frozen, state)
    if not fold:
        return memory, layers
    if memory is not None:
        memory = memory.scaled(scale)
    else:
        weight, bias = layers[0]
        layers = [(weight * scale, bias), *layers[1:]]
    if not frozen.squash:
        weight, bias = layers[-1]
        layers[-1] = weight * frozen.output_scale, bias * frozen.output_scale + frozen.output_offset
    return memory, layers


def _float32(values: Matrix, label: str) -> NDArray[np.float32]:
    with np.errstate(over="ignore"):
        rounded = values.astype(np.float32)
    if not np.isfinite(rounded).all():
        raise PolicyError(
            f"the {label} hold NaN or infinite values, expected finite ones; did training diverge?"
        )
    return rounded


def _metadata(frozen: FrozenConfig, config: Mapping[str, Any], progress: Mapping[str, Any]) -> dict[str, str]:
    more = {} if frozen.mix == contract.Mix.ATTITUDE_FIRST.text else {contract.META_MIX: frozen.mix}
    if frozen.model is not None:
        more[contract.META_MODEL] = _json(frozen.model)
    return {
        contract.META_VERSION: contract.POLICY_FORMAT_VERSION,
        contract.META_OBSERVATION: frozen.observation,
        contract.META_CONTROL_RATE: str(frozen.control_rate_hz),
        contract.META_FILTERS: _json(frozen.filters),
        contract.META_IDLE: repr(frozen.idle),
        **more,
        contract.META_AIRCRAFT: frozen.aircraft,
        contract.META_AIRCRAFT_SHA256: frozen.aircraft_sha256,
        contract.META_TRAINING: _json(_training(config, progress)),
    }


def _training(config: Mapping[str, Any], progress: Mapping[str, Any]) -> dict[str, Any]:
    """Return the training's configuration without bulky entries, and its counts.

    Measured times are left out, so that the same training gives the same file.
    """
    counts = {key: value for key, value in progress.items() if type(value) is int}
    return {key: value for key, value in {**config, **counts}.items() if key not in TOLD and _is_small(value)}


def _is_small(value: object) -> bool:
    return (
        not (isinstance(value, float) and not math.isfinite(value))
        and len(_json(value)) <= TRAINING_VALUE_MAX
    )


def _json(value: object) -> str:
    return json.dumps(value, sort_keys=True, separators=(",", ":"))
