"""Makes another trainer's ONNX model one that the reader takes: no dead nodes, opset 13 or newer."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence

import numpy as np
import onnx
from onnx import helper, numpy_helper

from neuroflight.toolchain.errors import PolicyError
from neuroflight.toolchain.reader.checks import FILE_NODES_MAX, OPSET_MIN, opset
from neuroflight.toolchain.reader.constants import TYPES
from neuroflight.toolchain.reader.values import STANDARD_DOMAINS, WIDTH_MAX, label, shown

WORDS_MAX = 160  # characters of what onnx says
FUNCTIONS_DEPTH_MAX = 32  # of functions that call functions


def keep_outputs(graph: onnx.GraphProto, outputs: Collection[str]) -> tuple[int, int]:
    """Keep only the graph's `outputs` and what they need; return the number of outputs and nodes dropped."""
    needed, nodes = set(outputs), []
    for node in reversed(graph.node):
        if needed.intersection(filter(None, node.output)):
            needed.update(filter(None, node.input))
            needed.update(_captured(node))
            nodes.append(node)
    kept = [value for value in graph.output if value.name in outputs]
    dropped = len(graph.output) - len(kept), len(graph.node) - len(nodes)
    tensors = [tensor for tensor in graph.initializer if tensor.name in needed]
    given = {tensor.name for tensor in graph.initializer} - {tensor.name for tensor in tensors}
    inputs = [value for value in graph.input if value.name not in given]
    _replace(graph.output, kept)
    _replace(graph.node, nodes[::-1])
    _replace(graph.initializer, tensors)
    _replace(graph.input, inputs)
    return dropped


def inline_functions(model: onnx.ModelProto) -> list[str]:
    """Replace calls of the model's own functions by their nodes; return what was done."""
    from onnx import inliner

    if not model.functions:
        return []
    names = sorted({function.name for function in model.functions})
    if (count := _inlined_nodes(model)) > FILE_NODES_MAX:
        raise PolicyError(
            f"the model's own functions {listed(names)} make {count} nodes of it, expected at most "
            f"{FILE_NODES_MAX}; is it a policy?"
        )
    try:
        onnx.checker.check_model(model)  # the inliner, which is C++, is given sound models only
        inlined = inliner.inline_local_functions(model, True)
    except Exception as error:  # it documents no set of errors
        raise PolicyError(
            f"the model's own functions {listed(names)} cannot be inlined: {_words(error)}; export it "
            "without functions (torch.onnx.export with export_modules_as_functions=False)"
        ) from error
    model.CopyFrom(inlined)
    return [f"inlined the model's own functions {listed(names)}"]


def _inlined_nodes(model: onnx.ModelProto) -> int:
    """Count the nodes once all calls are inlined. Raises PolicyError for functions that call themselves."""
    bodies = {(f.domain, f.name): list(f.node) for f in model.functions}
    counts: dict[tuple[str, str], int] = {}

    def count(nodes: Sequence[onnx.NodeProto], callers: frozenset[tuple[str, str]]) -> int:
        total = 0
        for node in nodes:
            called = node.domain, node.op_type
            if called in callers or len(callers) > FUNCTIONS_DEPTH_MAX:
                raise PolicyError(
                    f"the model's own function {shown(node.op_type)} calls itself, or too many others"
                )
            if called in bodies and called not in counts:
                counts[called] = count(bodies[called], callers | {called})
            total += counts.get(called, 1)
        return total

    return count(model.graph.node, frozenset())


def fix_inputs(graph: onnx.GraphProto, constants: Mapping[str, float]) -> list[str]:
    """Turn the inputs named in `constants` into constants; return what was done. Raises PolicyError."""
    from onnx import numpy_helper

    names = [value.name for value in graph.input]
    for name, number in constants.items():
        if name not in names:
            raise PolicyError(f"--constant: the model has no input {name!r}, its inputs are {listed(names)}")
        value = graph.input[names.index(name)]
        tensor = value.type.tensor_type
        sizes = [max(dim.dim_value, 1) for dim in tensor.shape.dim]
        if tensor.elem_type not in TYPES or not 0 < math.prod(sizes) <= WIDTH_MAX:
            raise PolicyError(f"--constant: the input {name!r} is no tensor of up to {WIDTH_MAX} numbers")
        array = np.full(sizes, number, TYPES[tensor.elem_type])
        graph.initializer.append(numpy_helper.from_array(array, name))
        graph.input.remove(value)
        names.remove(name)
    return [f"took {number:g} for the input {name!r} throughout" for name, number in constants.items()]


def give_shapes(graph: onnx.GraphProto) -> None:
    """Give an unknown shape to inputs and outputs for which the exporter wrote none.

    onnx.checker wants one; an input is taken for a row of open width.
    """
    del graph.value_info[:]  # shapes that were inferred for any batch
    for values, axes in ((graph.input, 2), (graph.output, 0)):
        for value in values:
            tensor = value.type.tensor_type
            if value.type.HasField("tensor_type") and not tensor.HasField("shape"):
                tensor.shape.SetInParent()
                for _ in range(axes):
                    tensor.shape.dim.add()


def lower_scalers(graph: onnx.GraphProto) -> list[str]:
    """Write scikit-learn's Scaler as a difference and a product; returns what was done."""
    nodes, names = list[onnx.NodeProto](), list[str]()
    for node in graph.node:
        if (node.domain, node.op_type) != ("ai.onnx.ml", "Scaler"):
            nodes.append(node)
            continue
        given = {attribute.name: attribute.floats for attribute in node.attribute}
        if len(node.input) != 1 or len(node.output) != 1 or not {"offset", "scale"} <= given.keys():
            raise PolicyError(f"{label(node)} lacks its input, offset or scale; is the file damaged?")
        (source,), (result,) = node.input, node.output
        steps = (("Sub", "offset", source, f"{result}_less"), ("Mul", "scale", f"{result}_less", result))
        for operator, attribute, value, out in steps:
            tensor = numpy_helper.from_array(np.array(given[attribute], np.float32), f"{out}_{attribute}")
            graph.initializer.append(tensor)
            nodes.append(
                helper.make_node(operator, [value, tensor.name], [out], name=f"{node.name}_{operator}")
            )
        names.append(node.name)
    if names:
        _replace(graph.node, nodes)
        return [f"wrote the Scaler {listed(names)} as a difference and a product"]
    return []


def convert_opset(model: onnx.ModelProto) -> list[str]:
    """Convert a model older than the reader knows; returns what was changed, in a line."""
    from onnx import version_converter

    version = opset(model)
    used = {node.domain for node in model.graph.node}
    _replace(
        model.opset_import,
        [e for e in model.opset_import if e.domain in STANDARD_DOMAINS or e.domain in used],
    )
    if version >= OPSET_MIN:
        return []
    hint = f"export it again with opset_version={OPSET_MIN} or newer, 17 for one"
    try:
        onnx.checker.check_model(model)  # the converter, which is C++, is given sound models only
        converted = version_converter.convert_version(model, OPSET_MIN)
    except Exception as error:  # it documents no set of errors
        raise PolicyError(
            f"the model is of opset {version}, which onnx.version_converter cannot convert to {OPSET_MIN}: "
            f"{_words(error)}; {hint}"
        ) from error
    changed = sorted({node.op_type for node in model.graph.node if _differs(node.op_type, version)})
    model.CopyFrom(converted)
    del model.graph.value_info[:]
    listed = f", which changes {', '.join(changed)}" if changed else ", which changes no operator of it"
    return [f"converted opset {version} to {OPSET_MIN} with onnx.version_converter{listed}"]


def _words(error: Exception) -> str:
    """Return the error's text in one line, shortened if too long."""
    words = " ".join(str(error).split()) or type(error).__name__
    return words if len(words) <= WORDS_MAX else words[: WORDS_MAX - 3] + "..."


def _captured(node: onnx.NodeProto) -> set[str]:
    """Return the outer values that the graphs inside a node (bodies of If, Loop, Scan) read."""
    names, graphs = set[str](), [a.g for a in node.attribute if a.HasField("g")]
    graphs += [graph for attribute in node.attribute for graph in attribute.graphs]
    while graphs:
        for inner in graphs.pop().node:
            names.update(inner.input)
            graphs += [a.g for a in inner.attribute if a.HasField("g")]
    return names


def _differs(operator: str, version: int) -> bool:
    """Return True if the operator's definition in opset OPSET_MIN differs from that in `version`."""
    try:
        old, new = (onnx.defs.get_schema(operator, v, "").since_version for v in (version, OPSET_MIN))
    except onnx.defs.SchemaError:
        return True
    return bool(old != new)


def _replace(field: Sequence[object], items: Sequence[object]) -> None:
    """Reduce the repeated `field` to `items`, some of its own."""
    copies = [type(item).FromString(item.SerializeToString()) for item in items]  # type: ignore[attr-defined]
    del field[:]  # type: ignore[attr-defined]
    field.extend(copies)  # type: ignore[attr-defined]


def listed(names: Sequence[str]) -> str:
    """Format names for a message: the first eight."""
    return (", ".join(map(shown, names[:8])) or "none") + (", ..." if len(names) > 8 else "")
