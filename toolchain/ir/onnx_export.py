"""Writes a network as an ONNX model, so that other programs can run it.

Sources: the ONNX operator specification, opset 17.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import assert_never

import numpy as np
import onnx
from numpy.typing import ArrayLike, DTypeLike
from onnx import helper, numpy_helper

from neuroflight.toolchain.contract import POLICY_INPUT, POLICY_OUTPUT
from neuroflight.toolchain.ir import operations as op
from neuroflight.toolchain.ir.network import Network, Node

OPSET = 17  # the first with LayerNormalization
IR_VERSION = 8  # of the same ONNX release
STATE, NEW_STATE = "state", "new_state"  # names begin so

_FUNCTIONS = {
    op.Tanh: "Tanh",
    op.Sigmoid: "Sigmoid",
    op.Softsign: "Softsign",
    op.Erf: "Erf",
    op.Softplus: "Softplus",
    op.Softmax: "Softmax",
    op.Relu: "Relu",
    op.Add: "Add",
    op.Multiply: "Mul",
}
_BACKWARD_END = np.iinfo(np.int64).min  # where a Slice with a negative step ends that takes element 0


@dataclass(eq=False)
class _Graph:
    """An ONNX graph under construction."""

    nodes: list[onnx.NodeProto] = field(default_factory=list)
    tensors: list[onnx.TensorProto] = field(default_factory=list)
    states: list[tuple[str, str, int]] = field(default_factory=list)  # taken, given, units
    name: str = ""  # name of the next nodes; "": named after their outputs
    names: set[str] = field(default_factory=set)

    def constant(self, values: ArrayLike, dtype: DTypeLike = np.float32) -> str:
        """Add a tensor that holds `values` and return its name."""
        name = f"constant{len(self.tensors)}"
        array = np.asarray(values).astype(dtype)
        self.tensors.append(numpy_helper.from_array(array, name))
        return name

    def add(
        self, operator: str, inputs: list[str], outputs: list[str], **attributes: float | list[int]
    ) -> None:
        """Append a node; if its name is missing or taken, name it after its output."""
        given = next(output for output in outputs if output)
        name = self.name or given
        while name in self.names:  # onnxruntime refuses two of one name
            name = f"{name}/{given}"
        self.names.add(name)
        node = helper.make_node(operator, inputs, outputs, name)
        node.attribute.extend(helper.make_attribute(key, value) for key, value in attributes.items())
        self.nodes.append(node)


def to_model(
    network: Network, *, rows: int | str = 1, state: bool = False, values: bool = False
) -> onnx.ModelProto:
    """Convert `network` to an ONNX model, `observation` [rows, n] to `action` [rows, m], without metadata.

    rows: 1, or a name for any number of observations side by side.
    state: add inputs state0, state1, ... and outputs new_state0, ..., [rows, units], in the order of
    `toolchain.ir.interpreter.State`; otherwise recurrent cells start from zero at each call.
    values: add every value between as an output value1, value2, ...
    """
    graph = _Graph()
    last = len(network.nodes)
    names = [POLICY_INPUT, *(f"value{number}" for number in range(1, last)), POLICY_OUTPUT]
    for number, node in enumerate(network.nodes, 1):
        graph.name = node.name
        _write(graph, node, [names[value] for value in node.inputs], names[number], state)

    def value(name: str, width: int) -> onnx.ValueInfoProto:
        return helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, [rows, width])

    inputs = [value(POLICY_INPUT, network.inputs)]
    outputs = [value(POLICY_OUTPUT, network.outputs)]
    for taken, given, units in graph.states:
        inputs.append(value(taken, units))
        outputs.append(value(given, units))
    if values:
        outputs += [value(names[number], network.widths[number]) for number in range(1, last)]
    drawn = helper.make_graph(graph.nodes, "policy", inputs, outputs, graph.tensors)
    opsets = [helper.make_opsetid("", OPSET)]
    return helper.make_model(drawn, opset_imports=opsets, ir_version=IR_VERSION, producer_name="neuroflight")


def _write(graph: _Graph, node: Node, inputs: list[str], output: str, state: bool) -> None:
    """Append the ONNX nodes of one node."""
    x, y = inputs[0], [output]
    match node.operation:
        case op.Linear(weight, bias):
            graph.add("Gemm", [x, graph.constant(weight), graph.constant(bias)], y, transB=1)
        case op.Affine(scale, offset):
            if not offset.any():
                graph.add("Mul", [x, graph.constant(scale)], y)
                return
            if not (scale == 1).all():
                graph.add("Mul", [x, graph.constant(scale)], [f"{output}_scaled"])
                x = f"{output}_scaled"
            graph.add("Add", [x, graph.constant(offset)], y)
        case op.Tanh() | op.Sigmoid() | op.Softsign() | op.Erf() | op.Softplus() | op.Softmax() as operation:
            graph.add(_FUNCTIONS[type(operation)], inputs, y)
        case op.Relu() | op.Add() | op.Multiply() as operation:
            graph.add(_FUNCTIONS[type(operation)], inputs, y)
        case op.Silu():
            graph.add("Sigmoid", [x], [f"{output}_sigmoid"])
            graph.add("Mul", [x, f"{output}_sigmoid"], y)
        case op.LeakyRelu(slope):
            graph.add("LeakyRelu", [x], y, alpha=float(slope))
        case op.Elu(alpha):
            graph.add("Elu", [x], y, alpha=float(alpha))
        case op.Clip(low, high):
            bounds = ["" if bound is None else graph.constant(bound) for bound in (low, high)]
            graph.add("Clip", [x, *bounds], y)
        case op.LayerNorm(epsilon, scale, offset):
            affine = [graph.constant(scale), graph.constant(offset)]
            graph.add("LayerNormalization", [x, *affine], y, axis=1, epsilon=float(epsilon))
        case op.RmsNorm(epsilon, scale, offset):
            graph.add("Mul", [x, x], [f"{output}_square"])
            graph.add("ReduceMean", [f"{output}_square"], [f"{output}_mean"], axes=[1])
            graph.add("Add", [f"{output}_mean", graph.constant(epsilon)], [f"{output}_sum"])
            graph.add("Sqrt", [f"{output}_sum"], [f"{output}_root"])
            graph.add("Div", [x, f"{output}_root"], [f"{output}_norm"])
            graph.add("Mul", [f"{output}_norm", graph.constant(scale)], [f"{output}_scaled"])
            graph.add("Add", [f"{output}_scaled", graph.constant(offset)], y)
        case op.Select():
            graph.add("Greater", [x, graph.constant(0)], [f"{output}_above"])
            graph.add("Where", [f"{output}_above", *inputs[1:]], y)
        case op.Concat():
            graph.add("Concat", inputs, y, axis=1)
        case op.Slice(start, count, step):
            end = start + count * step
            ends = (start, _BACKWARD_END if end < 0 else end, 1, step)
            graph.add("Slice", [x, *(graph.constant([number], np.int64) for number in ends)], y)
        case op.Gru() | op.Lstm() as cell:
            _write_cell(graph, cell, x, output, state)
        case never:
            assert_never(never)


def _write_cell(graph: _Graph, cell: op.Gru | op.Lstm, x: str, output: str, state: bool) -> None:
    """Append a recurrent cell over a sequence of one: a row [rows, n] is [1, rows, n] inside."""
    axis = graph.constant([0], np.int64)
    none = np.zeros(4 * cell.units)
    biases = (cell.input_bias, cell.state_bias) if isinstance(cell, op.Gru) else (cell.bias, none)
    inputs = [f"{output}_x", graph.constant(cell.input_weight[None]), graph.constant(cell.state_weight[None])]
    inputs += [graph.constant(np.concatenate(biases)[None]), ""]
    graph.add("Unsqueeze", [x, axis], [inputs[0]])
    results = [(f"{output}_h", output)]
    if state:
        results += [(f"{output}_c", f"{output}_c_row")] * isinstance(cell, op.Lstm)
        for inner, _ in results:
            index = len(graph.states)
            graph.states.append((f"{STATE}{index}", f"{NEW_STATE}{index}", cell.units))
            graph.add("Unsqueeze", [f"{STATE}{index}", axis], [f"{inner}_before"])
            inputs.append(f"{inner}_before")
    options = {"linear_before_reset": 1} if isinstance(cell, op.Gru) else {}
    outputs = ["", *(inner for inner, _ in results)]
    graph.add(type(cell).__name__.upper(), inputs, outputs, hidden_size=cell.units, **options)
    for inner, result in results:
        graph.add("Squeeze", [inner, axis], [result])
    if state:
        for (_, result), (_, given, _) in zip(results, graph.states[-len(results) :], strict=True):
            graph.add("Identity", [result], [given])
