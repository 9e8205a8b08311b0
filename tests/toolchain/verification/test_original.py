"""A foreign model compared with what was read of it: by onnxruntime, by onnx's reference, not at all."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import onnx
import pytest
from onnx import helper, numpy_helper

from neuroflight.toolchain.errors import PolicyError
from neuroflight.toolchain.ir.network import Network, Node
from neuroflight.toolchain.ir.operations import Linear
from neuroflight.toolchain.policy.foreign_ends import Ends
from neuroflight.toolchain.policy.foreign_network import Adopted, read_foreign
from neuroflight.toolchain.verification.original import compare


def model(*, flat: bool = False, dead: bool = False) -> bytes:
    """Return tanh(x W); flat: with one axis, which onnxruntime refuses; dead: with an unknown operator."""
    rng = np.random.default_rng(0)
    tensor = numpy_helper.from_array(rng.normal(size=(6, 4)).astype(np.float32), "w")
    nodes = [helper.make_node("Gemm", ["obs", "w"], ["sum"]), helper.make_node("Tanh", ["sum"], ["act"])]
    outputs = [helper.make_tensor_value_info("act", 1, None)]
    if dead:
        nodes.append(helper.make_node("Unheard", ["sum"], ["critic"], domain="somebody.else"))
        outputs.append(helper.make_tensor_value_info("critic", 1, [1, 1]))
    shape = [6] if flat else [3, 6]
    graph = helper.make_graph(nodes, "g", [helper.make_tensor_value_info("obs", 1, shape)], outputs, [tensor])
    opsets = [helper.make_opsetid("", 17), helper.make_opsetid("somebody.else", 1)]
    return bytes(helper.make_model(graph, opset_imports=opsets, ir_version=8).SerializeToString())


def adopted(data: bytes) -> Adopted:
    return read_foreign(onnx.load_from_string(data), Ends("act", None, (("rate", 3), ("rate_error", 3)), 4))


@pytest.mark.parametrize("dead", [False, True])
def test_distance_is_told_when_onnxruntime_runs_the_model(dead: bool) -> None:
    data = model(dead=dead)
    assert compare(data, adopted(data)).startswith(
        "compared with onnxruntime on the model itself, 300 steps: at"
    )


def test_onnx_itself_compares_when_onnxruntime_does_not_run_the_model() -> None:
    data = model(flat=True)
    assert compare(data, adopted(data)).startswith("compared with onnx's reference on the model itself")


def test_onnx_itself_compares_when_onnxruntime_is_not_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    data = model()
    assert compare(data, adopted(data)).startswith("compared with onnx's reference on the model itself")


def test_reason_is_told_when_nothing_runs_the_model() -> None:
    data = model()
    broken = replace(adopted(data), inputs={"absent": (1, 6)})
    assert compare(data, broken).startswith(
        "not compared with the model itself: onnxruntime does not run it: "
    )


@pytest.mark.parametrize(
    ("factor", "words"),
    [
        (1.0, "compared with onnxruntime"),
        (1e30, "not compared with the model itself: its sums leave float32"),
    ],
)
def test_nothing_is_refused_when_sums_leave_float32(factor: float, words: str) -> None:
    huge = onnx.load_from_string(model())
    huge.graph.initializer[0].CopyFrom(numpy_helper.from_array(np.full((6, 4), 1e38, np.float32), "w"))
    huge.graph.initializer.append(numpy_helper.from_array(np.array(factor, np.float32), "factor"))
    huge.graph.node[1].op_type = "Relu"
    huge.graph.node.insert(0, helper.make_node("Mul", ["obs", "factor"], ["wide"]))
    huge.graph.node[1].input[0] = "wide"
    data = huge.SerializeToString()
    assert compare(data, adopted(data)).startswith(words)


def test_model_is_refused_when_what_was_read_of_it_computes_something_else() -> None:
    data = model()
    found = adopted(data)
    first, *rest = found.network.nodes
    assert isinstance(first.operation, Linear)
    weight = first.operation.weight.copy()
    weight[0, 0] += 0.01
    nodes = (Node(Linear(weight, first.operation.bias), first.inputs), *rest)
    with pytest.raises(
        PolicyError, match=r"away from what onnxruntime computes with it, expected at most 0\.0001"
    ):
        compare(data, replace(found, network=Network(found.network.inputs, nodes)))
