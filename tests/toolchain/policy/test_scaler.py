"""The Scaler that skl2onnx writes for scikit-learn's StandardScaler, against onnxruntime."""

from __future__ import annotations

from typing import Any

import numpy as np
import onnx
import onnxruntime
import pytest
from onnx import TensorProto, helper, numpy_helper

from neuroflight.toolchain.errors import PolicyError
from neuroflight.toolchain.ir.interpreter import evaluate
from neuroflight.toolchain.policy.import_onnx import PolicyClaims, imported_model
from neuroflight.toolchain.policy.model import parse_policy
from tests.sampling import examples

CLAIMS = PolicyClaims("rate_error,rate_error_delta", 1000, "[]", "nf1", "ab" * 32, 4)
TOLERANCE = 1e-6


def scaled(rng: np.random.Generator, count: int, kind: int = TensorProto.FLOAT) -> onnx.ModelProto:
    """Return a model of a layer behind a Scaler of values of `kind`, with `count` offsets and scales."""
    attributes: dict[str, Any] = {"offset": rng.normal(size=count), "scale": rng.uniform(0.1, 3.0, count)}
    weight = numpy_helper.from_array(rng.normal(0, 0.4, (6, 4)).astype(np.float32), "weight")
    nodes = [
        helper.make_node("Cast", ["x"], ["cast"], to=kind),
        helper.make_node("Scaler", ["cast"], ["scaled"], domain="ai.onnx.ml", **attributes),
        helper.make_node("MatMul", ["scaled", "weight"], ["sums"]),
        helper.make_node("Sigmoid", ["sums"], ["y"]),
    ]
    ends = [helper.make_tensor_value_info(n, TensorProto.FLOAT, ["N", w]) for n, w in (("x", 6), ("y", 4))]
    graph = helper.make_graph(nodes, "scaled", ends[:1], ends[1:], [weight])
    opsets = [helper.make_opsetid("", 17), helper.make_opsetid("ai.onnx.ml", 1)]
    return helper.make_model(graph, opset_imports=opsets, ir_version=8)


@pytest.mark.parametrize("kind", [TensorProto.FLOAT, TensorProto.DOUBLE])
def test_a_scaler_is_read_when_it_has_one_value_or_a_value_an_input(kind: int) -> None:
    rng = np.random.default_rng(3)
    for number in range(examples(200)):
        data = scaled(rng, rng.choice([1, 6]), kind).SerializeToString()
        observation = rng.normal(0, 3, (20, 6)).astype(np.float32)
        (expected,) = onnxruntime.InferenceSession(data).run(None, {"x": observation})
        policy, changes = imported_model(data, CLAIMS, clip=False)
        actions = evaluate(parse_policy(policy).network, observation)
        np.testing.assert_allclose(actions, expected, rtol=0, atol=TOLERANCE, err_msg=str(number))
        assert any("Scaler" in change for change in changes)


@pytest.mark.parametrize("lost", ["offset", "scale", "input"])
def test_a_scaler_is_refused_in_one_line_when_a_part_of_it_is_lost(lost: str) -> None:
    model = scaled(np.random.default_rng(4), 6)
    node = model.graph.node[1]
    if lost == "input":
        del node.input[:]
    else:
        kept = [attribute for attribute in node.attribute if attribute.name != lost]
        del node.attribute[:]
        node.attribute.extend(kept)
    with pytest.raises(PolicyError, match=r"Scaler.*lacks its input, offset or scale"):
        imported_model(model.SerializeToString(), CLAIMS, clip=False)
