"""Reads the graph of an ONNX model as a chain of layers, refusing whatever it cannot prove.

Accepted: Gemm, MatMul, Add, Sub, Mul and Div with a constant, Tanh, Relu, Clip, Identity, Flatten and
Constant, in float32 with fixed shapes [1, n]. Refusals are PolicyError, one line, naming the node or value.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import numpy_helper

from toolchain.contract import POLICY_INPUT, POLICY_OUTPUT
from toolchain.errors import PolicyError
from toolchain.float32 import Float32
from toolchain.graph import Network
from toolchain.graph import chain as chain_of
from toolchain.operations import Affine, Clip, Linear, Operation, Relu, Tanh

SUPPORTED = (
    "Add",
    "Clip",
    "Constant",
    "Div",
    "Flatten",
    "Gemm",
    "Identity",
    "MatMul",
    "Mul",
    "Relu",
    "Sub",
    "Tanh",
)
DOMAINS = ("", "ai.onnx")  # two spellings of the one standard domain
OPSET_MIN = 11  # the first whose Clip takes its bounds as inputs


def refuse_unsupported(model: onnx.ModelProto) -> None:
    """Raise PolicyError for what no later step accepts: other operators, old opsets, data kept elsewhere."""
    if model.functions or model.graph.sparse_initializer:
        raise PolicyError(
            "local functions or sparse weights in the policy, expected plain nodes and dense weights"
        )
    if not all(isinstance(name, str) for name in _names(model)):
        raise PolicyError("a name in the policy is not UTF-8; is the file damaged? export it again")
    for entry in model.opset_import:
        if entry.domain in DOMAINS and entry.version < OPSET_MIN:
            raise PolicyError(
                f"the policy is of opset {entry.version}, expected {OPSET_MIN} or newer; export again"
            )
    for node in model.graph.node:
        if node.op_type not in SUPPORTED or node.domain not in DOMAINS:
            raise PolicyError(f"{_label(node)} is not supported, supported are {', '.join(SUPPORTED)}")
    tensors = [(f"initializer {tensor.name!r}", tensor) for tensor in model.graph.initializer]
    tensors += [(_label(n), a.t) for n in model.graph.node for a in n.attribute if a.HasField("t")]
    for label, tensor in tensors:
        if tensor.data_location == onnx.TensorProto.EXTERNAL or tensor.external_data:
            raise PolicyError(f"{label} keeps its values in another file; export the policy as one file")
        if tensor.data_type != onnx.TensorProto.FLOAT:
            kind = _type_name(tensor.data_type)
            raise PolicyError(f"{label} is of type {kind}, expected float32; export in float32")


def read_network(model: onnx.ModelProto) -> Network:
    """The network of a model that the ONNX checker has accepted."""
    graph = model.graph
    given = {tensor.name for tensor in graph.initializer}
    inputs = [value for value in graph.input if value.name not in given]
    width = _only_vector(inputs, POLICY_INPUT, "input")
    outputs = _only_vector(list(graph.output), POLICY_OUTPUT, "output")
    chain = _Chain(POLICY_INPUT, width)
    for tensor in graph.initializer:
        chain.constants[tensor.name] = _array(tensor, f"initializer {tensor.name!r}")
    for node in graph.node:
        _read_node(chain, node)
    if chain.value != POLICY_OUTPUT:
        raise PolicyError(
            f"the policy's nodes end at {chain.value!r}, expected them to end at {POLICY_OUTPUT!r}"
        )
    if chain.width != outputs:
        raise PolicyError(f"the policy computes {chain.width} actions and declares {outputs}")
    return chain_of(width, chain.layers)


@dataclass
class _Chain:
    """What is known while walking the graph: the value that the next node must take, and constants."""

    value: str
    width: int
    layers: list[Operation] = field(default_factory=list)
    constants: dict[str, Float32] = field(default_factory=dict)

    def append(self, layer: Operation, node: onnx.NodeProto) -> None:
        """`node` computes `layer` from the chain's value."""
        if isinstance(layer, Linear):
            self.width = layer.outputs
        self.layers.append(layer)
        self.value = node.output[0]


def _only_vector(values: list[onnx.ValueInfoProto], name: str, role: str) -> int:
    """n of the one float32 [1, n] value called `name`."""
    names = ", ".join(repr(value.name) for value in values) or "none"
    if [value.name for value in values] != [name]:
        raise PolicyError(f"the policy's {role}s are {names}, expected one {role} {name!r}")
    tensor = values[0].type.tensor_type
    if tensor.elem_type != onnx.TensorProto.FLOAT:
        raise PolicyError(f"{role} {name!r} is {_type_name(tensor.elem_type)}, expected float32")
    sizes = [d.dim_value if d.HasField("dim_value") else d.dim_param or "?" for d in tensor.shape.dim]
    if any(isinstance(size, str) for size in sizes):
        text = ", ".join(map(str, sizes))
        raise PolicyError(
            f"{role} {name!r} has the dynamic shape [{text}], expected [1, n]; export with fixed shapes"
        )
    if len(sizes) != 2 or sizes[0] != 1 or int(sizes[1]) < 1:
        raise PolicyError(f"{role} {name!r} has the shape {sizes}, expected [1, n]")
    return int(sizes[1])


def _read_node(chain: _Chain, node: onnx.NodeProto) -> None:
    label = _label(node)
    if node.op_type == "Constant":
        chain.constants[node.output[0]] = _constant(node, label)
        return
    if node.op_type == "Identity" and node.input[0] in chain.constants:
        chain.constants[node.output[0]] = chain.constants[node.input[0]]
        return
    variable = [name for name in node.input if name and name not in chain.constants]
    if variable != [chain.value]:
        raise PolicyError(
            f"{label} takes {variable or 'constants only'}, expected one chain of nodes: [{chain.value!r}]"
        )
    match node.op_type:
        case "Gemm":
            chain.append(_gemm(chain, node, label), node)
        case "MatMul":
            chain.append(_matmul(chain, node, label), node)
        case "Add" | "Sub" | "Mul" | "Div":
            chain.append(_affine(chain, node, label), node)
        case "Tanh":
            chain.append(Tanh(), node)
        case "Relu":
            chain.append(Relu(), node)
        case "Clip":
            bounds = [_scalar(chain, name, label) for name in [*node.input[1:], "", ""][:2]]
            if None not in bounds and bounds[0] > bounds[1]:  # type: ignore[operator]
                raise PolicyError(f"{label} has the bounds {bounds}, expected the lower one first")
            chain.append(Clip(*bounds), node)
        case "Identity":
            chain.value = node.output[0]
        case "Flatten":
            axis = _attributes(node).get("axis", 1)
            if axis not in (0, 1, -1):
                raise PolicyError(f"{label} has axis {axis}, expected 1: the values are [1, n]")
            chain.value = node.output[0]


def _gemm(chain: _Chain, node: onnx.NodeProto, label: str) -> Linear:
    options = _attributes(node)
    if node.input[0] != chain.value or options.get("transA", 0):
        raise PolicyError(f"{label} does not multiply [1, {chain.width}] by a constant, expected x W + b")
    weight = _floats(chain, node.input[1], label).astype(np.float64) * options.get("alpha", 1.0)
    if options.get("transB", 0):
        weight = weight.T
    bias = np.zeros(weight.shape[-1])
    if len(node.input) > 2 and node.input[2]:
        bias = _row(_floats(chain, node.input[2], label), weight.shape[-1], label) * options.get("beta", 1.0)
    return _linear(chain, weight, bias, label)


def _matmul(chain: _Chain, node: onnx.NodeProto, label: str) -> Linear:
    if node.input[0] != chain.value:
        raise PolicyError(f"{label} multiplies a constant by {chain.value!r}, expected {chain.value!r} first")
    weight = _floats(chain, node.input[1], label).astype(np.float64)
    return _linear(chain, weight, np.zeros(weight.shape[-1]), label)


def _linear(chain: _Chain, weight: NDArray[np.float64], bias: NDArray[np.float64], label: str) -> Linear:
    if weight.ndim != 2 or weight.shape[0] != chain.width:
        raise PolicyError(
            f"{label} has weights of shape {list(weight.shape)}, expected [{chain.width}, outputs]"
        )
    with np.errstate(over="ignore"):
        layer = Linear(np.ascontiguousarray(weight.T, np.float32), bias.astype(np.float32))
    if not (np.isfinite(layer.weight).all() and np.isfinite(layer.bias).all()):
        raise PolicyError(f"{label} scales its weights beyond the range of float32")
    return layer


def _affine(chain: _Chain, node: onnx.NodeProto, label: str) -> Affine:
    first = node.input[0] == chain.value
    constant = _row(_floats(chain, node.input[1 if first else 0], label), chain.width, label)
    one, zero = np.ones(chain.width), np.zeros(chain.width)
    match node.op_type:
        case "Add":
            return Affine(one, constant)
        case "Sub":
            return Affine(one, -constant) if first else Affine(-one, constant)
        case "Mul":
            return Affine(constant, zero)
    if not first:
        raise PolicyError(f"{label} divides a constant by {chain.value!r}, expected a constant divisor")
    if not constant.all():
        raise PolicyError(f"{label} divides by zero, expected a divisor without zeros")
    return Affine(1 / constant, zero)


def _row(values: Float32, width: int, label: str) -> NDArray[np.float64]:
    """`values` as the row [width] that broadcasting against [1, width] makes of them."""
    try:
        if np.broadcast_shapes(values.shape, (1, width)) == (1, width):
            return np.broadcast_to(values.astype(np.float64), (1, width)).reshape(width)
    except ValueError:
        pass
    raise PolicyError(
        f"{label} has a constant of shape {list(values.shape)}, expected one that fits [1, {width}]"
    )


def _floats(chain: _Chain, name: str, label: str) -> Float32:
    if name not in chain.constants:
        raise PolicyError(f"{label} takes {name!r} where a constant is expected")
    values = chain.constants[name]
    if not np.isfinite(values).all():
        count = int((~np.isfinite(values)).sum())
        raise PolicyError(
            f"{label}: constant {name!r} holds {count} NaN or infinite values, expected finite ones"
        )
    return values


def _scalar(chain: _Chain, name: str, label: str) -> float | None:
    if not name:
        return None
    values = _floats(chain, name, label)
    if values.size != 1:
        raise PolicyError(f"{label}: bound {name!r} has {values.size} values, expected one")
    return float(values.reshape(()))


def _attributes(node: onnx.NodeProto) -> dict[str, float]:
    return {a.name: onnx.helper.get_attribute_value(a) for a in node.attribute}


def _constant(node: onnx.NodeProto, label: str) -> Float32:
    for attribute in node.attribute:
        match attribute.name:
            case "value":
                return _array(attribute.t, label)
            case "value_float":
                return np.array(attribute.f, np.float32)
            case "value_floats":
                return np.array(attribute.floats, np.float32)
    raise PolicyError(f"{label} holds neither a tensor nor floats, expected float32 values")


def _array(tensor: onnx.TensorProto, label: str) -> Float32:
    try:
        return np.asarray(numpy_helper.to_array(tensor), np.float32)
    except (ValueError, TypeError, KeyError) as error:
        raise PolicyError(f"{label} does not hold the values of its shape: {error}") from error


def _names(model: onnx.ModelProto) -> Iterator[object]:
    """Every name in the model; protobuf gives bytes instead of str for what is not UTF-8."""
    for node in model.graph.node:
        yield from (node.name, node.op_type, node.domain, *node.input, *node.output)
        yield from (attribute.name for attribute in node.attribute)
    for entry in (*model.graph.initializer, *model.graph.input, *model.graph.output):
        yield entry.name
    for entry in model.metadata_props:
        yield from (entry.key, entry.value)


def _label(node: onnx.NodeProto) -> str:
    operator = node.op_type if node.domain in DOMAINS else f"{node.domain}::{node.op_type}"
    operator = operator if operator.isprintable() else repr(operator)
    return f"node {node.name or ', '.join(node.output)!r} ({operator})"


def _type_name(code: int) -> str:
    return (
        onnx.TensorProto.DataType.Name(code).lower()
        if code in onnx.TensorProto.DataType.values()
        else str(code)
    )
