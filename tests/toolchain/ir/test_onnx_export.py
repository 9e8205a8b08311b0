"""A network written as ONNX: valid for the checker, and onnxruntime computes what the evaluator does."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import onnx
import onnxruntime
import pytest
from onnx import helper

from neuroflight.toolchain.ir import operations as op
from neuroflight.toolchain.ir.interpreter import advance, clear_state, evaluate, replay
from neuroflight.toolchain.ir.network import Network, Node, chain
from neuroflight.toolchain.ir.onnx_export import to_model
from neuroflight.toolchain.passes import optimize
from neuroflight.toolchain.policy.model import parse_policy

if TYPE_CHECKING:
    from tests.toolchain.conftest import Kit

CLIP = op.Clip(0.0, 1.0)


def array(*shape: int, seed: int = 0) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    return (0.4 * np.random.default_rng(seed).normal(size=shape)).astype(np.float32)


GRU = op.Gru(array(9, 6), array(9, 3, seed=1), array(9, seed=2), array(9, seed=3))
LSTM = op.Lstm(array(12, 3), array(12, 3, seed=1), array(12, seed=2))
OPERATIONS: dict[str, op.Operation] = {
    "linear": op.Linear(array(4, 6), array(4)),
    "affine": op.Affine(array(6).astype(float), array(6, seed=1).astype(float)),
    "tanh": op.Tanh(),
    "sigmoid": op.Sigmoid(),
    "silu": op.Silu(),
    "softsign": op.Softsign(),
    "erf": op.Erf(),
    "softplus": op.Softplus(),
    "softmax": op.Softmax(),
    "rms norm": op.RmsNorm(1e-5, array(6), array(6, seed=1)),
    "relu": op.Relu(),
    "leaky relu": op.LeakyRelu(0.125),
    "elu": op.Elu(0.75),
    "clip": op.Clip(-0.25, 0.5),
    "clip from below": op.Clip(-0.25, None),
    "clip from above": op.Clip(None, 0.5),
    "layer norm": op.LayerNorm(1e-5, array(6), array(6, seed=1)),
    "slice": op.Slice(1, 3),
    "slice of every other": op.Slice(1, 2, 3),
    "slice backwards": op.Slice(5, 3, -2),
    "slice backwards to the first": op.Slice(4, 5, -1),
    "gru": GRU,
    "lstm": op.Lstm(array(8, 6), array(8, 2, seed=1), array(8, seed=2)),
}


def session(model: onnx.ModelProto) -> onnxruntime.InferenceSession:
    onnx.checker.check_model(model, full_check=True)
    return onnxruntime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])


def observations(count: int, inputs: int = 6) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    return np.random.default_rng(5).normal(size=(count, inputs)).astype(np.float32)


@pytest.mark.parametrize("name", OPERATIONS)
def test_onnxruntime_agrees_when_the_operation_is(name: str) -> None:
    network = chain(6, (OPERATIONS[name], CLIP))
    run = session(to_model(network))
    rows = observations(50)
    expected = np.concatenate([run.run(["action"], {"observation": row[None]})[0] for row in rows])
    assert np.ptp(expected) > 0.1
    np.testing.assert_allclose(evaluate(network, rows), expected, rtol=0, atol=1e-6)


def test_onnxruntime_agrees_when_the_network_branches() -> None:
    nodes = (
        Node(op.Linear(array(6, 6), array(6)), (0,)),
        Node(op.Tanh(), (1,)),
        Node(op.Multiply(), (2, 0)),
        Node(op.Concat(), (3, 1)),
        Node(op.Slice(4, 6), (4,)),
        Node(op.Add(), (5, 2)),
        Node(op.Select(), (6, 3, 1)),
        Node(CLIP, (7,)),
    )
    network = Network(6, nodes)
    rows = observations(50)
    expected = session(to_model(network, rows="rows")).run(["action"], {"observation": rows})[0]
    np.testing.assert_allclose(evaluate(network, rows), expected, rtol=0, atol=1e-6)


def test_state_is_taken_and_given_when_asked_for() -> None:
    network = chain(6, (GRU, LSTM, op.Linear(array(4, 3), array(4) + np.float32(0.5)), CLIP))
    run = session(to_model(network, rows="rows", state=True))
    assert [value.name for value in run.get_inputs()] == ["observation", "state0", "state1", "state2"]
    names = [value.name for value in run.get_outputs()]
    assert names == ["action", "new_state0", "new_state1", "new_state2"]
    theirs = ours = clear_state(network, 7)
    for step in range(30):
        rows = observations(7 * 30).reshape(30, 7, 6)[step]
        state = {f"state{index}": value for index, value in enumerate(theirs)}
        expected, *theirs = run.run(names, {"observation": rows, **state})
        action, ours = advance(network, rows, ours)
        np.testing.assert_allclose(action, expected, rtol=0, atol=2e-6)
    for ours_now, theirs_now in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(ours_now, theirs_now, rtol=0, atol=2e-6)


def test_every_value_is_given_when_asked_for() -> None:
    network = chain(
        6, (op.Affine(np.full(6, 2.0), np.ones(6)), op.Linear(array(4, 6), array(4)), op.Tanh(), CLIP)
    )
    run = session(to_model(network, values=True))
    assert [value.name for value in run.get_outputs()] == ["action", "value1", "value2", "value3"]
    row = observations(1)
    scaled, hidden = run.run(["value1", "value3"], {"observation": row})
    np.testing.assert_allclose(scaled, 2 * row + 1, rtol=1e-6)
    np.testing.assert_allclose(np.clip(hidden, 0, 1), evaluate(network, row), rtol=0, atol=1e-6)


def test_model_is_the_same_when_it_is_written_twice() -> None:
    network = chain(6, (GRU, LSTM, CLIP))
    assert to_model(network).SerializeToString() == to_model(network).SerializeToString()


@pytest.mark.parametrize("name", OPERATIONS)
def test_network_is_read_back_when_the_operation_is(name: str, kit: Kit) -> None:
    joined = Network(
        6, (Node(OPERATIONS[name], (0,)), Node(op.Concat(), (1, 0)), Node(op.Multiply(), (2, 2)))
    )
    last = op.Linear(array(4, joined.outputs), array(4) + np.float32(0.5))
    network = Network(6, (*joined.nodes, Node(last, (3,)), Node(CLIP, (4,))))
    model = to_model(network)
    helper.set_model_props(model, kit.chain().metadata)
    read = parse_policy(bytes(model.SerializeToString())).network
    if name == "rms norm":  # whose scale and offset are nodes of their own in the file
        read, network = optimize(read)[0], optimize(network)[0]
    rows = observations(12)
    np.testing.assert_array_equal(replay(read, rows), replay(network, rows))
