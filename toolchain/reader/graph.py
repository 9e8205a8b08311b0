"""Reads a model's nodes in the order of computation."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from neuroflight.toolchain.contract import POLICY_INPUT, POLICY_OUTPUT
from neuroflight.toolchain.errors import PolicyError
from neuroflight.toolchain.ir.network import Network, Node
from neuroflight.toolchain.reader.checks import (
    action_width,
    check_model,
    observation_width,
    opset,
    unsupported,
)
from neuroflight.toolchain.reader.constants import array, fold
from neuroflight.toolchain.reader.operators import KNOWN, OPERATORS
from neuroflight.toolchain.reader.output_range import bounded
from neuroflight.toolchain.reader.patterns import STARTS, computed, read_pattern
from neuroflight.toolchain.reader.values import (
    WIDTH_MAX,
    Builder,
    Call,
    Condition,
    Part,
    RowValue,
    Unread,
    Value,
    label,
    printable,
    shown,
)

RANDOM = (
    "Bernoulli",
    "Multinomial",
    "RandomNormal",
    "RandomNormalLike",
    "RandomUniform",
    "RandomUniformLike",
)
FOLDED_BYTES_MAX = 256 << 20  # of all constants that nodes compute: memory, not a board's limit


class RandomError(PolicyError):
    """A node that draws random numbers, reported before any other fault of the model."""


def read_network(model: onnx.ModelProto) -> Network:
    """Read the network of `model`; it ends with a Clip within [0, 1]. Raises PolicyError."""
    check_model(model)
    width = observation_width(model)
    if width > WIDTH_MAX:
        raise PolicyError(f"the policy takes {width} values, expected at most {WIDTH_MAX}")
    outputs = action_width(model)
    build = Builder(width)
    action = read_nodes(model, build, {POLICY_INPUT: RowValue(0, (1, width))})[POLICY_OUTPUT]
    if isinstance(action, Unread) and action.error is not None:
        raise action.error
    if not isinstance(action, RowValue):
        raise PolicyError(f"output {POLICY_OUTPUT!r} is no function of the observation; is the export right?")
    if action.shape != (1, outputs):
        raise PolicyError(
            f"the policy computes actions of shape {list(action.shape)}, declared [1, {outputs}]"
        )
    return bounded(_network(build, action))


def read_nodes(model: onnx.ModelProto, build: Builder, inputs: Mapping[str, Value]) -> dict[str, Value]:
    """Read the nodes of a checked model into `build`; returns every value by its name.

    The outputs of a node that cannot be read are of type Unread, which holds the error. It is raised only
    when a node needs such a value, other than for its shape.
    """
    graph = model.graph
    values: dict[str, Value] = {
        tensor.name: array(tensor, f"initializer {shown(tensor.name)}") for tensor in graph.initializer
    }
    values |= inputs
    folded = 0  # bytes of what nodes compute from constants
    for node in graph.node:
        call = _call(build, node, values)
        try:
            results = _read(call)
            if len(results) < len(node.output):
                raise call.error(f"has {len(node.output)} outputs, expected {len(results)}")
        except PolicyError as error:
            results = _unread(model, node, call, error)
        folded += sum(result.nbytes for result in results if isinstance(result, np.ndarray))
        if folded > FOLDED_BYTES_MAX:
            raise call.error(f"makes it more than {FOLDED_BYTES_MAX} bytes of constants; is it a policy?")
        values.update((name, result) for name, result in zip(node.output, results, strict=False) if name)
    return values


def _call(build: Builder, node: onnx.NodeProto, values: dict[str, Value]) -> Call:
    inputs = tuple(values[name] if name else None for name in node.input)
    attributes = {a.name: helper.get_attribute_value(a) for a in node.attribute}
    name = printable(node.name or next(iter(node.output), ""))
    return Call(
        build, node.op_type, name, label(node), tuple(node.input), inputs, attributes, len(node.output)
    )


def _read(call: Call) -> tuple[Value, ...]:
    """Read the outputs of one node."""
    if call.operator == "Shape" and isinstance(call.input(0), Unread):
        result: Value | tuple[Value, ...] = fold(call)
        return result if isinstance(result, tuple) else (result,)
    if call.operator in RANDOM:
        raise RandomError(
            f"{call.label} draws random numbers, expected the same action for the same observation; export "
            "the mean of the distribution (deterministic=True)"
        )
    errors = [
        value.error or call.error(f"takes {shown(name)}, {value.label}, which is not supported")
        for name, value in zip(call.names, call.inputs, strict=True)
        if isinstance(value, Unread)
    ]
    for error in sorted(errors, key=lambda error: not isinstance(error, RandomError)):
        raise error
    kinds = {type(value) for value in call.inputs}
    if call.operator == "Constant":
        return (_constant(call),)
    if (call.operator == "Shape" and Part not in kinds) or not kinds & {RowValue, Part, Condition}:
        result = fold(call)
    elif (Part in kinds or call.operator in STARTS) and (part := read_pattern(call)) is not None:
        result = part
    elif call.operator in OPERATORS:
        result = OPERATORS[call.operator](computed(call))
    elif call.operator in KNOWN:
        raise call.error("takes values computed from the observation; it is supported on constants only")
    else:
        raise unsupported(call.label)
    return result if isinstance(result, tuple) else (result,)


def _unread(
    model: onnx.ModelProto, node: onnx.NodeProto, call: Call, error: PolicyError
) -> tuple[Unread, ...]:
    """Return a node's unreadable outputs, with their shapes where ONNX's own inference gives them."""
    types, constants = {}, {}
    for name, value in zip(call.names, call.inputs, strict=True):
        if isinstance(value, np.ndarray):
            constants[name] = numpy_helper.from_array(value)
            kind, shape = constants[name].data_type, value.shape
        elif isinstance(value, RowValue | Unread) and value.shape is not None:
            kind, shape = TensorProto.FLOAT, value.shape
        else:
            continue
        types[name] = helper.make_tensor_type_proto(kind, shape)
    found: dict[str, onnx.TypeProto] = {}
    with contextlib.suppress(Exception):  # it documents no set of errors; without it no shape is known
        schema = onnx.defs.get_schema(node.op_type, opset(model), "")
        found = onnx.shape_inference.infer_node_outputs(
            schema, node, types, constants, opset_imports=list(model.opset_import)
        )
    return tuple(
        Unread(f"an output of {call.label}", error, _static(found.get(name))) for name in node.output
    )


def _static(found: onnx.TypeProto | None) -> tuple[int, ...] | None:
    """Return the shape of a type; None unless all sizes are known."""
    if found is None or not found.tensor_type.HasField("shape"):
        return None
    sizes = found.tensor_type.shape.dim
    return tuple(size.dim_value for size in sizes) if all(s.HasField("dim_value") for s in sizes) else None


def _constant(call: Call) -> Value:
    for name, value in call.attributes.items():
        match name:
            case "value":
                return array(value, call.label)
            case "value_float" | "value_floats":
                return np.array(value, np.float32)
            case "value_int" | "value_ints":
                return np.array(value, np.int64)
    raise call.error("holds neither a tensor nor numbers")


def _network(build: Builder, action: RowValue) -> Network:
    """Return the nodes up to the action's, without those that a later one absorbed."""
    nodes = build.nodes[: action.number]
    kept, numbers = list[Node](), {0: 0}
    taken = {number for node in nodes for number in node.inputs} | {action.number}
    for number, node in enumerate(nodes, 1):
        if number in build.absorbed and number not in taken:
            continue
        kept.append(Node(node.operation, tuple(numbers[value] for value in node.inputs), node.name))
        numbers[number] = len(kept)
    return Network(build.inputs, tuple(kept))
