"""RNN, GRU and LSTM nodes: state goes from step to step as onnxruntime's does when it is handed over."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
import onnx
import onnxruntime
import pytest
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

from neuroflight.toolchain.errors import PolicyError
from neuroflight.toolchain.ir.interpreter import replay
from neuroflight.toolchain.ir.operations import Gru, Lstm
from neuroflight.toolchain.policy.model import parse_policy

if TYPE_CHECKING:
    from tests.toolchain.conftest import Kit

Float32 = NDArray[np.float32]
UNITS, STEPS = 5, 50
GATES = {"RNN": 1, "GRU": 3, "LSTM": 4}
STATES = {"RNN": ("h",), "GRU": ("h",), "LSTM": ("h", "c")}


def recurrent(kit: Kit, operator: str, **options: Any) -> onnx.ModelProto:
    """Unsqueeze, a recurrent cell, Squeeze of Y, a Gemm and a Clip."""
    rng, size = np.random.default_rng(3), GATES[operator] * UNITS
    constants: dict[str, NDArray[np.generic]] = {
        "W": (rng.normal(size=(1, size, 6)) / 2).astype(np.float32),
        "R": (rng.normal(size=(1, size, UNITS)) / 2).astype(np.float32),
        "B": (rng.normal(size=(1, 2 * size)) / 3).astype(np.float32),
        "zeros": np.zeros((1, 1, UNITS), np.float32),
        "axis": np.array([0], np.int64),
        "axes": np.array([0, 1], np.int64),
        "out": (rng.normal(size=(4, UNITS)) / 2).astype(np.float32),
        "offset": np.full(4, 0.5, np.float32),
        "low": np.array(0, np.float32),
        "high": np.array(1, np.float32),
    }
    inputs = ["x", "W", "R", "B", "", *["zeros"] * len(STATES[operator])]
    options = {"hidden_size": UNITS} | ({"linear_before_reset": 1} if operator == "GRU" else {}) | options
    nodes = [
        helper.make_node("Unsqueeze", ["observation", "axis"], ["x"]),
        helper.make_node(operator, inputs, ["Y"], name="cell", **options),
        helper.make_node("Squeeze", ["Y", "axes"], ["y"]),
        helper.make_node("Gemm", ["y", "out", "offset"], ["a"], transB=1),
        helper.make_node("Clip", ["a", "low", "high"], ["action"]),
    ]
    ends = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, n])
        for name, n in (("observation", 6), ("action", 4))
    ]
    tensors = [numpy_helper.from_array(values, name) for name, values in constants.items()]
    graph = helper.make_graph(nodes, "policy", ends[:1], ends[1:], tensors)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    helper.set_model_props(model, kit.chain().metadata)
    return model


def cell_of(model: onnx.ModelProto) -> onnx.NodeProto:
    """The node of the recurrent cell."""
    found: onnx.NodeProto = next(node for node in model.graph.node if node.op_type in GATES)
    return found


def stepped(model: onnx.ModelProto, observation: Float32) -> Float32:
    """onnxruntime's actions when it is handed the state of the step before."""
    opened = onnx.ModelProto()
    opened.CopyFrom(model)
    cell = cell_of(opened)
    cell.output[:] = [cell.output[0], *(f"{state}_out" for state in STATES[cell.op_type])]
    cell.input[5:] = [f"{state}_in" for state in STATES[cell.op_type]]
    for values, suffix in ((opened.graph.input, "in"), (opened.graph.output, "out")):
        values.extend(
            helper.make_tensor_value_info(f"{state}_{suffix}", TensorProto.FLOAT, [1, 1, UNITS])
            for state in STATES[cell.op_type]
        )
    session = onnxruntime.InferenceSession(opened.SerializeToString(), providers=["CPUExecutionProvider"])
    states = [np.zeros((1, 1, UNITS), np.float32) for _ in STATES[cell.op_type]]
    actions = []
    for row in observation:
        named = {f"{state}_in": value for state, value in zip(STATES[cell.op_type], states, strict=True)}
        action, *states = session.run(None, {"observation": row[None], **named})
        actions.append(action)
    return np.concatenate(actions)


def sequence() -> Float32:
    return np.random.default_rng(4).normal(size=(STEPS, 6)).astype(np.float32)


@pytest.mark.parametrize("operator", GATES)
def test_state_is_carried_as_onnxruntime_carries_it_when_steps_follow(kit: Kit, operator: str) -> None:
    model, observation = recurrent(kit, operator), sequence()
    expected = stepped(model, observation)
    network = parse_policy(model.SerializeToString()).network
    assert network.recurrent
    np.testing.assert_allclose(replay(network, observation), expected, rtol=0, atol=1e-6)
    forgetful = np.concatenate([replay(network, row[None]) for row in observation])
    assert np.abs(forgetful - expected).max() > 0.05  # the state matters in this sequence


@pytest.mark.parametrize("operator", GATES)
def test_last_state_is_read_when_it_is_taken_instead_of_y(kit: Kit, operator: str) -> None:
    model, observation = recurrent(kit, operator), sequence()
    expected = stepped(model, observation)
    cell_of(model).output[:] = ["", "Y_h"]
    model.graph.node[2].input[0] = "Y_h"
    model.graph.initializer[5].CopyFrom(numpy_helper.from_array(np.array([0], np.int64), "axes"))
    network = parse_policy(model.SerializeToString()).network
    np.testing.assert_allclose(replay(network, observation), expected, rtol=0, atol=1e-6)


@pytest.mark.parametrize("operator", GATES)
def test_biases_are_zero_when_a_cell_has_none(kit: Kit, operator: str) -> None:
    model, observation = recurrent(kit, operator), sequence()
    cell_of(model).input[3:] = []
    operation = parse_policy(model.SerializeToString()).network.nodes[0].operation
    match operation:
        case Gru():
            gates = 2 * UNITS if operator == "RNN" else 0  # of a GRU that stands for it
            assert not operation.input_bias[gates:].any() and not operation.state_bias.any()
        case Lstm():
            assert not operation.bias.any()
        case _:
            pytest.fail("no cell")
    cell_of(model).input[3:] = ["", "", *["zeros"] * len(STATES[operator])]
    network = parse_policy(model.SerializeToString()).network
    np.testing.assert_allclose(replay(network, observation), stepped(model, observation), rtol=0, atol=1e-6)


def constant(name: str, values: NDArray[np.generic], place: int) -> Callable[[onnx.ModelProto], None]:
    """An edit that gives the cell the constant `values` as input number `place`."""

    def edit(model: onnx.ModelProto) -> None:
        model.graph.initializer.append(numpy_helper.from_array(values, name))
        inputs = cell_of(model).input
        inputs.extend([""] * (place + 1 - len(inputs)))
        inputs[place] = name

    return edit


def take_cell_state(model: onnx.ModelProto) -> None:
    cell_of(model).output[:] = ["", "", "Y_c"]
    model.graph.node[2].input[0] = "Y_c"


def two_steps(model: onnx.ModelProto) -> None:
    model.graph.node[0].op_type = "Reshape"
    model.graph.initializer.append(numpy_helper.from_array(np.array([2, 1, 3], np.int64), "shape"))
    model.graph.node[0].input[1] = "shape"


ONES = np.ones((1, 1, UNITS), np.float32)
REFUSED: dict[str, tuple[str, dict[str, Any], Callable[[onnx.ModelProto], None] | None]] = {
    "has direction 'reverse', expected forward": ("GRU", {"direction": "reverse"}, None),
    "has linear_before_reset 0, expected 1": ("GRU", {"linear_before_reset": 0}, None),
    "has layout '1', expected 0": ("GRU", {"layout": 1}, None),
    "has clip '3.0', expected 0.0": ("LSTM", {"clip": 3.0}, None),
    "has input_forget '1', expected 0": ("LSTM", {"input_forget": 1}, None),
    "has activations 'Sigmoid, Relu', expected Sigmoid, Tanh": (
        "GRU",
        {"activations": ["Sigmoid", "Relu"]},
        None,
    ),
    "has activations 'Relu', expected Tanh": ("RNN", {"activations": ["Relu"]}, None),
    "has weights of shapes": ("LSTM", {"hidden_size": 7}, None),
    "has sequence_lens, expected none": ("GRU", {}, constant("n", np.array([1], np.int32), 4)),
    "has an initial state h other than zero": ("GRU", {}, constant("h", ONES, 5)),
    "has an initial state c other than zero": ("LSTM", {}, constant("c", ONES, 6)),
    "has an initial state c of shape [1, 1, 8], expected [1, 1, 5]": (  # torch's LSTM with proj_size
        "LSTM",
        {},
        constant("c", np.zeros((1, 1, 8), np.float32), 6),
    ),
    "has peepholes, expected none": ("LSTM", {}, constant("P", np.zeros((1, 3 * UNITS), np.float32), 7)),
    "takes 'Y_c', the cell state of node 'cell' (LSTM)": ("LSTM", {}, take_cell_state),
    "takes a sequence of shape [2, 1, 3], expected one step": ("GRU", {}, two_steps),
}


@pytest.mark.parametrize("words", REFUSED)
def test_cell_is_refused_by_name_when_its_state_could_not_be_carried(kit: Kit, words: str) -> None:
    operator, options, edit = REFUSED[words]
    model = recurrent(kit, operator, **options)
    if edit:
        edit(model)
    with pytest.raises(PolicyError) as caught:
        parse_policy(model.SerializeToString())
    assert words in str(caught.value)
    assert "node 'cell'" in str(caught.value)
    assert "\n" not in str(caught.value)
