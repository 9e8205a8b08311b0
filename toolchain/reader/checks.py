"""Checks of a whole model before any node is read."""

from __future__ import annotations

from collections.abc import Iterator, Set

import onnx
from onnx import TensorProto

from neuroflight.toolchain.contract import POLICY_INPUT, POLICY_OUTPUT
from neuroflight.toolchain.errors import PolicyError
from neuroflight.toolchain.reader.constants import TYPES
from neuroflight.toolchain.reader.operators import COMPUTING
from neuroflight.toolchain.reader.origin import check_origin
from neuroflight.toolchain.reader.values import NODES_MAX, STANDARD_DOMAINS, label, shown

OPSET_MIN = 13  # the oldest that torch still writes; since then axes and bounds are inputs
FILE_NODES_MAX = 4 * NODES_MAX  # constants and shapes included
CHECKER_WORDS_MAX = 300  # characters of what the ONNX checker says
HINTS = {
    "input": "state is carried by GRU and LSTM nodes",
    "output": "`neuroflight policy import --output` picks one",
}
WEIGHTED = {  # operator: places of its weights
    "Conv": (1, 2),
    "Gemm": (1, 2),
    "MatMul": (0, 1),
    "GRU": (1, 2, 3),
    "RNN": (1, 2, 3),
    "LSTM": (1, 2, 3),
    "LayerNormalization": (1, 2),
    "BatchNormalization": (1, 2, 3, 4),
}


def check_model(model: onnx.ModelProto, *, float64: bool = False) -> None:
    """Raise PolicyError, one line, for a model whose nodes must not be read.

    float64: allow constants of that type, such as a normalizer's.
    """
    check_parts(model)
    version = opset(model)
    if version < OPSET_MIN:
        raise PolicyError(f"the policy is of opset {version}, expected {OPSET_MIN} or newer; export again")
    _check_operators(model.graph)
    _check_tensors(model.graph, {TensorProto.FLOAT, *([TensorProto.DOUBLE] * float64)})
    _check_order(model.graph)
    _check_inputs(model.graph, version)
    try:
        onnx.checker.check_model(model)  # attributes and counts; shapes and types the reader proves itself
    except (onnx.checker.ValidationError, ValueError) as error:
        first = next((line for line in str(error).splitlines() if line.strip()), type(error).__name__)
        words = first if len(first) <= CHECKER_WORDS_MAX else first[:CHECKER_WORDS_MAX] + "..."
        raise PolicyError(f"not a valid ONNX model, or a truncated one: {words}") from error


def observation_width(model: onnx.ModelProto) -> int:
    """Return n of the one input `observation` float32 [1, n]."""
    given = {tensor.name for tensor in model.graph.initializer}
    inputs = [value for value in model.graph.input if value.name not in given]
    return _only_vector(inputs, POLICY_INPUT, "input")


def action_width(model: onnx.ModelProto) -> int:
    """Return m of the one output `action` float32 [1, m]."""
    return _only_vector(list(model.graph.output), POLICY_OUTPUT, "output")


def check_parts(model: onnx.ModelProto, *, functions: bool = False) -> None:
    """Raise PolicyError unless the model is plain nodes with readable names.

    functions: allow functions that the model defines itself.
    """
    if not model.HasField("graph"):
        raise PolicyError("not an ONNX model, or a truncated one: it has no graph")
    if (model.functions and not functions) or model.graph.sparse_initializer:
        raise PolicyError(
            "local functions or sparse weights in the policy, expected plain nodes and dense weights"
        )
    if not all(isinstance(name, str) for name in _names(model)):
        raise PolicyError("a name in the policy is not UTF-8; is the file damaged? export it again")
    if (count := len(model.graph.node)) > FILE_NODES_MAX:
        raise PolicyError(f"the policy has {count} nodes, expected at most {FILE_NODES_MAX}; is it a policy?")
    check_origin(model)


def opset(model: onnx.ModelProto) -> int:
    """Return the version of the standard operators. Raises PolicyError if there is none or onnx lacks it."""
    newest = onnx.defs.onnx_opset_version()
    versions = [entry.version for entry in model.opset_import if entry.domain in STANDARD_DOMAINS]
    if not versions:
        raise PolicyError("the policy names no opset, or the file is truncated; export it again")
    for version in versions:
        if version > newest:
            raise PolicyError(
                f"the policy is of opset {version}, and onnx {onnx.__version__} knows {newest}; "
                "export it with an older opset_version"
            )
    return int(max(versions))


def unsupported(name: str) -> PolicyError:
    """Return the error for the node labelled `name`, whose operator is not supported."""
    return PolicyError(f"{name} is not supported, supported are {', '.join(COMPUTING)} and reshaping")


def _check_operators(graph: onnx.GraphProto) -> None:
    for node in graph.node:
        nested = any(attribute.HasField("g") or attribute.graphs for attribute in node.attribute)
        if nested or node.domain not in STANDARD_DOMAINS or not onnx.defs.has(node.op_type):
            raise unsupported(label(node))


def _check_tensors(graph: onnx.GraphProto, floats: Set[int]) -> None:
    """Raise PolicyError for tensors in other files, and for weights of a type that is not in `floats`."""
    tensors = [(f"initializer {shown(tensor.name)}", tensor) for tensor in graph.initializer]
    tensors += [(label(n), a.t) for n in graph.node for a in n.attribute if a.HasField("t")]
    for name, tensor in tensors:
        if tensor.data_location == TensorProto.EXTERNAL or tensor.external_data:
            raise PolicyError(
                f"{name} keeps its values in another file; export the policy as one file "
                "(torch.onnx.export with external_data=False) or let `neuroflight policy import` join them"
            )
        if tensor.data_type not in TYPES.keys() - {TensorProto.FLOAT, TensorProto.DOUBLE} | floats:
            kind = _type_name(tensor.data_type)
            raise PolicyError(f"{name} is of type {kind}, expected float32; export in float32")
    types = {tensor.name: tensor.data_type for tensor in graph.initializer}
    for node in graph.node:
        for place in WEIGHTED.get(node.op_type, ()):
            name = node.input[place] if place < len(node.input) else ""
            if types.get(name, TensorProto.FLOAT) not in floats:
                kind = _type_name(types[name])
                raise PolicyError(
                    f"{label(node)} takes weights {shown(name)} of type {kind}, expected float32; "
                    "quantized policies are not supported"
                )


def _check_order(graph: onnx.GraphProto) -> None:
    """Raise PolicyError unless every value is computed once, before it is taken; an empty name is none."""
    known = {tensor.name for tensor in graph.initializer}
    if len(known) != len(graph.initializer):
        raise PolicyError("two initializers of the policy have one name; export it again")
    makers: dict[str, onnx.NodeProto] = {}
    for node in graph.node:
        for name in node.output:
            if name and (name in makers or name in known or any(name == v.name for v in graph.input)):
                raise PolicyError(f"{label(node)} computes {shown(name)}, which has a value already")
            makers[name] = node
    known |= {value.name for value in graph.input} | {""}
    for node in graph.node:
        for name in node.input:
            if name in known:
                continue
            if name not in makers:
                raise PolicyError(f"{label(node)} takes {shown(name)}, which nothing computes")
            if _reaches(graph, node, makers[name]):
                raise PolicyError(
                    f"{label(node)} takes {shown(name)}, which depends on that node itself: a cyclic graph; "
                    "state is carried by GRU and LSTM nodes"
                )
            raise PolicyError(
                f"{label(node)} takes {shown(name)}, which a later node computes; export again: ONNX wants "
                "nodes in the order of computation"
            )
        known.update(node.output)


def _check_inputs(graph: onnx.GraphProto, version: int) -> None:
    """Raise PolicyError if a node lacks an input that its operator needs."""
    for node in graph.node:
        try:
            schema = onnx.defs.get_schema(node.op_type, version, "")
        except onnx.defs.SchemaError as error:
            raise PolicyError(f"{label(node)} does not exist in opset {version}; export again") from error
        for place, formal in enumerate(schema.inputs):
            if formal.option == onnx.defs.OpSchema.FormalParameterOption.Optional:
                continue
            last = formal.option == onnx.defs.OpSchema.FormalParameterOption.Variadic
            names = node.input[place:] if last else node.input[place : place + 1]
            if not names or not all(names):
                raise PolicyError(f"{label(node)} lacks its input {formal.name}")


def _reaches(graph: onnx.GraphProto, start: onnx.NodeProto, end: onnx.NodeProto) -> bool:
    """Return True if `end` depends on the outputs of `start`."""
    takers: dict[str, list[onnx.NodeProto]] = {}
    for node in graph.node:
        for name in filter(None, node.input):
            takers.setdefault(name, []).append(node)
    waiting, seen = [start], set[int]()
    while waiting:
        node = waiting.pop()
        if id(node) in seen:
            continue
        seen.add(id(node))
        waiting += [taker for name in node.output for taker in takers.get(name, ())]
    return id(end) in seen


def _only_vector(values: list[onnx.ValueInfoProto], name: str, role: str) -> int:
    """Return n of the one float32 [1, n] value called `name`."""
    names = ", ".join(shown(value.name) for value in values[:8]) or "none"
    if [value.name for value in values] != [name]:
        hint = f"; {HINTS[role]}" if len(values) > 1 else "; `neuroflight policy import` renames it"
        raise PolicyError(f"the policy's {role}s are {names}, expected one {role} {name!r}{hint}")
    tensor = values[0].type.tensor_type
    if tensor.elem_type != TensorProto.FLOAT:
        raise PolicyError(f"{role} {name!r} is {_type_name(tensor.elem_type)}, expected float32")
    sizes = [d.dim_value if d.HasField("dim_value") else d.dim_param or "?" for d in tensor.shape.dim]
    if any(isinstance(size, str) for size in sizes):
        text = shown(", ".join(map(str, sizes))).strip("'\"")
        raise PolicyError(
            f"{role} {name!r} has the dynamic shape [{text}], expected [1, n]; export with fixed shapes"
        )
    if len(sizes) != 2 or sizes[0] != 1 or int(sizes[1]) < 1:
        raise PolicyError(f"{role} {name!r} has the shape {sizes}, expected [1, n]")
    return int(sizes[1])


def _names(model: onnx.ModelProto) -> Iterator[object]:
    """Yield every name in the model; protobuf gives bytes instead of str for invalid UTF-8."""
    for node in model.graph.node:
        yield from (node.name, node.op_type, node.domain, *node.input, *node.output)
        yield from (attribute.name for attribute in node.attribute)
    for entry in (*model.graph.initializer, *model.graph.input, *model.graph.output):
        yield entry.name
    for value in (*model.graph.input, *model.graph.output):
        yield from (dim.dim_param for dim in value.type.tensor_type.shape.dim)
    for entry in model.metadata_props:
        yield from (entry.key, entry.value)


def _type_name(code: int) -> str:
    return TensorProto.DataType.Name(code).lower() if code in TensorProto.DataType.values() else str(code)
