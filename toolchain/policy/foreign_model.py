"""Makes another trainer's ONNX model one that the reader takes: no dead nodes, opset 13 or newer."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import onnx

from toolchain.errors import PolicyError
from toolchain.reader.checks import OPSET_MIN, opset
from toolchain.reader.values import STANDARD_DOMAINS, shown

WORDS_MAX = 160  # characters of what the converter says


def keep_outputs(graph: onnx.GraphProto, outputs: Collection[str]) -> tuple[int, int]:
    """Leave the graph's `outputs` and what they need; returns how many other outputs and nodes that drops."""
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


def give_shapes(graph: onnx.GraphProto) -> None:
    """Give inputs and outputs whose shape an exporter left out the one that says nothing.

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
        words = " ".join(str(error).split())
        words = words if len(words) <= WORDS_MAX else words[: WORDS_MAX - 3] + "..."
        raise PolicyError(
            f"the model is of opset {version}, which onnx.version_converter cannot convert to {OPSET_MIN}: "
            f"{words or type(error).__name__}; {hint}"
        ) from error
    changed = sorted({node.op_type for node in model.graph.node if _differs(node.op_type, version)})
    model.CopyFrom(converted)
    del model.graph.value_info[:]
    listed = f", which changes {', '.join(changed)}" if changed else ", which changes no operator of it"
    return [f"converted opset {version} to {OPSET_MIN} with onnx.version_converter{listed}"]


def _captured(node: onnx.NodeProto) -> set[str]:
    """Names that the node's own graphs take from outside."""
    names, graphs = set[str](), [a.g for a in node.attribute if a.HasField("g")]
    graphs += [graph for attribute in node.attribute for graph in attribute.graphs]
    while graphs:
        for inner in graphs.pop().node:
            names.update(inner.input)
            graphs += [a.g for a in inner.attribute if a.HasField("g")]
    return names


def _differs(operator: str, version: int) -> bool:
    """Whether an operator is another one in opset OPSET_MIN than in `version`."""
    try:
        old, new = (onnx.defs.get_schema(operator, v, "").since_version for v in (version, OPSET_MIN))
    except onnx.defs.SchemaError:
        return True
    return bool(old != new)


def _replace(field: Sequence[object], items: Sequence[object]) -> None:
    """Put `items`, some of those in the repeated `field`, in its place."""
    copies = [type(item).FromString(item.SerializeToString()) for item in items]  # type: ignore[attr-defined]
    del field[:]  # type: ignore[attr-defined]
    field.extend(copies)  # type: ignore[attr-defined]


def listed(names: Sequence[str]) -> str:
    """Names as a message lists them: the first eight."""
    return (", ".join(map(shown, names[:8])) or "none") + (", ..." if len(names) > 8 else "")
