"""Every operator that is read, against onnxruntime: small graphs in ONNX's text format."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import onnxruntime
import pytest
from numpy.typing import NDArray

from neuroflight.toolchain.ir import operations as op
from neuroflight.toolchain.ir.interpreter import evaluate
from neuroflight.toolchain.policy.model import parse_policy
from neuroflight.toolchain.reader.operators import KNOWN

if TYPE_CHECKING:
    from tests.toolchain.conftest import Kit

RNG = np.random.default_rng(0)
CONSTANTS: Mapping[str, NDArray[np.generic]] = {
    "w": (RNG.normal(size=(4, 6)) / 3).astype(np.float32),  # 6 to 4
    "v": (RNG.normal(size=(6, 4)) / 3).astype(np.float32),  # the same, untransposed
    "square": (RNG.normal(size=(6, 6)) / 3).astype(np.float32),
    "six": RNG.normal(size=6).astype(np.float32),
    "four": np.array([0.1, 0.4, 0.5, 0.2], np.float32),
    "positive": np.arange(1, 7, dtype=np.float32),
    "zero": np.array(0, np.float32),
    "one": np.array(1, np.float32),
    "two": np.array(2, np.float32),
    "half": np.array(0.5, np.float32),
    "epsilon": np.array(1e-5, np.float32),
    "three": np.array(3, np.float32),
    "twenty": np.array(20, np.float32),
    "root": np.array(np.sqrt(2), np.float32),
    "small": np.array(0.044715, np.float32),
    "factor": np.array(np.sqrt(2 / np.pi), np.float32),
    "some": np.array([True, False, True, True, False, True]),
    "zeros": np.zeros(4, np.float32),
    "ones": np.ones(4, np.float32),
    "axis0": np.array([0], np.int64),
    "axis1": np.array([1], np.int64),
    "last": np.array([-1], np.int64),
    "row": np.array([1, -1], np.int64),
    "cube": np.array([0, 2, 3], np.int64),
    "sizes": np.array([2, 4], np.int64),
    "order": np.array([3, 1, 0, 2], np.int64),
    "kernel": RNG.normal(size=(2, 2, 2)).astype(np.float32),
    "pair": np.array([0.1, -0.2], np.float32),
    "points": np.array([[3], [0], [-1], [2]], np.int64),
}
END = "a = Gemm<transB=1>(x, w, four) action = Clip(a, zero, one)"  # of a body that computes x
RESULT = "action = Clip(y, zero, one)"  # of a body that computes y [1, 4]
NORM = (
    "m = ReduceMean<axes=[-1]>(observation) d = Sub(observation, m) {square} s = ReduceMean<axes=[-1]>(q) "
    "e = Add(s, epsilon) r = Sqrt(e) {quotient} x = Add(n, six) " + END
)

KERAS = (  # x g + (offset - mean g), g: scale over the deviation
    "m = ReduceMean<axes=[-1]>(observation) d = Sub(observation, m) q = Mul(d, d) "
    "s = ReduceMean<axes=[-1]>(q) e = Add(s, epsilon) r = Sqrt(e) i = Reciprocal(r) {gain} "
    "l = Mul(observation, g) {shift} " + END
)
FLAX = (  # mean of x^2 less the mean's square, at least 0
    "m = ReduceMean<axes=[-1]>(observation) d = Sub(observation, m) p = Mul(observation, observation) "
    "q = ReduceMean<axes=[-1]>(p) s = Mul(m, m) j = Sub(q, s) {least} e = Add(u, epsilon) r = Sqrt(e) "
    "{norm} " + END
)
RMS = (
    "q = {square} s = ReduceMean<axes=[-1]>(q) e = Add(epsilon, s) r = Sqrt(e) {quotient} "
    "m = Mul(n, positive) x = Add(m, six) " + END
)

TF_NORM = (
    "m = ReduceMean<axes=[-1]>(observation) d = Sub(observation, m) q = Mul(d, d) "
    "s = ReduceMean<axes=[-1]>(q) e = Add(s, epsilon) r = Sqrt(e) i = Reciprocal(r) "
    "j = Mul(i, positive) {end}" + END
)

ACCEPTED: dict[str, str] = {
    "Gemm": "y = Gemm<transB=1, alpha=0.3, beta=2.0>(observation, w, four) " + RESULT,
    "Gemm without bias": "y = Gemm(observation, v) " + RESULT,
    "MatMul": "m = MatMul(observation, v) y = Add(m, four) " + RESULT,
    "MatMul from the left": "x = Transpose(observation) m = MatMul(w, x) y = Transpose(m) " + RESULT,
    "arithmetic with constants": "p = Sub(observation, six) q = Div(p, positive) r = Mul(six, q) "
    "s = Sub(half, r) x = Neg(s) " + END,
    "arithmetic of two values": "p = Tanh(observation) q = Sub(observation, p) r = Mul(q, p) x = Add(r, q) "
    + END,
    "a value with itself": "p = Add(observation, observation) x = Mul(p, p) " + END,
    "one value for many": "g = Slice(observation, axis0, axis1, axis1) x = Mul(observation, g) " + END,
    "Sum": "p = Tanh(observation) x = Sum(p, six, observation, half) " + END,
    "Mean": "p = Tanh(observation) x = Mean(one, p, observation) " + END,
    "Mean of one": "x = Mean(observation) " + END,
    "Conv": "p = Reshape(observation, cube) q = Conv<pads=[1, 0]>(p, kernel, pair) x = Reshape(q, row) "
    + END,
    "Tanh": "x = Tanh(observation) " + END,
    "Relu": "x = Relu(observation) " + END,
    "LeakyRelu": "x = LeakyRelu<alpha=0.2>(observation) " + END,
    "LeakyRelu by default": "x = LeakyRelu(observation) " + END,
    "Elu": "x = Elu<alpha=1.7>(observation) " + END,
    "Sigmoid": "x = Sigmoid(observation) " + END,
    "SiLU": "g = Sigmoid(observation) x = Mul(observation, g) " + END,
    "Softsign": "x = Softsign(observation) " + END,
    "Erf": "x = Erf(observation) " + END,
    "Gelu": "x = Gelu(observation) " + END,
    "Gelu by tanh": 'x = Gelu<approximate="tanh">(observation) ' + END,
    "GELU in parts": "p = Div(observation, root) q = Erf(p) r = Add(q, one) s = Mul(observation, r) "
    "x = Mul(s, half) " + END,
    "GELU by tanh in parts": "p = Pow(observation, three) q = Mul(p, small) r = Add(observation, q) "
    "s = Mul(r, factor) t = Tanh(s) u = Add(one, t) z = Mul(observation, u) x = Mul(half, z) " + END,
    "Softplus": "x = Softplus(observation) " + END,
    "Softplus with its threshold": "s = Softplus(observation) g = Greater(observation, twenty) "
    "x = Where(g, observation, s) " + END,
    "Mish": "x = Mish(observation) " + END,
    "Selu": "x = Selu(observation) " + END,
    "Selu of its own": "x = Selu<alpha=0.5, gamma=2.0>(observation) " + END,
    "Celu": "x = Celu(observation) " + END,
    "Celu of its own": "x = Celu<alpha=0.3>(observation) " + END,
    "PRelu of one slope": "x = PRelu(observation, half) " + END,
    "PRelu": "x = PRelu(observation, six) " + END,
    "HardSigmoid": "x = HardSigmoid(observation) " + END,
    "HardSwish": "x = HardSwish(observation) " + END,
    "ThresholdedRelu": "x = ThresholdedRelu<alpha=0.4>(observation) " + END,
    "ThresholdedRelu below 0": "x = ThresholdedRelu<alpha=-0.4>(observation) " + END,
    "layer norm of Keras": KERAS.format(
        gain="g = Mul(i, positive)", shift="n = Neg(m) k = Mul(n, g) h = Add(six, k) x = Add(l, h)"
    ),
    "layer norm of Keras without offset": KERAS.format(
        gain="g = Mul(positive, i)", shift="n = Neg(m) k = Mul(g, n) x = Add(k, l)"
    ),
    "layer norm of Keras without scale": KERAS.format(
        gain="g = Div(one, r)", shift="k = Mul(m, g) h = Sub(half, k) x = Add(h, l)"
    ),
    "layer norm of a shift that is subtracted": KERAS.format(
        gain="g = Mul(i, positive)", shift="k = Mul(m, g) x = Sub(l, k)"
    ),
    "layer norm of flax": FLAX.format(
        least="u = Max(j, zero)", norm="n = Div(d, r) k = Mul(n, positive) x = Add(k, six)"
    ),
    "layer norm of flax with its gain": FLAX.format(
        least="u = Max(zero, j)", norm="i = Reciprocal(r) g = Mul(i, positive) n = Mul(d, g) x = Add(n, six)"
    ),
    "layer norm of flax without bound": FLAX.replace("Add(u,", "Add(j,").format(
        least="", norm="x = Div(d, r)"
    ),
    "RMS norm with its gain": "q = Mul(observation, observation) s = ReduceMean<axes=[-1]>(q) "
    "e = Add(s, epsilon) r = Sqrt(e) i = Reciprocal(r) g = Mul(i, positive) x = Mul(g, observation) " + END,
    "the power of a mean": "m = ReduceMean<axes=[-1]>(observation) s = Pow(m, two) x = Add(s, observation) "
    + END,
    "the square of a mean": "m = ReduceMean<axes=[-1]>(observation) s = Mul(m, m) n = Neg(m) "
    "k = Add(s, n) x = Mul(observation, k) " + END,
    "Softmax": "x = Softmax(observation) " + END,
    "Softmax of groups": "p = Reshape(observation, cube) q = Softmax(p) x = Reshape(q, row) " + END,
    "Softmax of groups that lie apart": "p = Reshape(observation, cube) q = Softmax<axis=1>(p) "
    "x = Reshape(q, row) " + END,
    "the RMS norm of what is part of another pattern": "p = Abs(observation) q = Mul(p, p) "
    "s = ReduceMean<axes=[-1]>(q) e = Add(s, epsilon) r = Sqrt(e) x = Div(p, r) " + END,
    "LogSigmoid": "p = Sigmoid(observation) x = Log(p) " + END,
    "Where of zero": "g = Greater(observation, half) x = Where(g, observation, zero) " + END,
    "Where": "p = Tanh(observation) g = GreaterOrEqual(observation, p) q = Neg(p) x = Where(g, q, six) "
    + END,
    "Where of others": "p = Tanh(observation) g = LessOrEqual(half, observation) n = Not(g) "
    "x = Where(n, p, observation) " + END,
    "Where by a constant": "x = Where(some, observation, six) " + END,
    "a comparison as a number": "g = Less(observation, six) p = Cast<to=1>(g) x = Mul(p, observation) " + END,
    "Max of two": "p = Neg(observation) q = Max(observation, p) r = Min(q, p) x = Add(q, r) " + END,
    "Max and Min of bounds for each": "p = Max(observation, six) x = Min(positive, p) " + END,
    "Max and Min of bounds of other rank": "p = Neg(six) q = Min(p, observation) r = Unsqueeze(six, axis0) "
    "x = Max(r, q) " + END,
    "Abs": "p = Abs(observation) x = Mul(p, observation) " + END,
    "ReduceMean": "m = ReduceMean<axes=[1]>(observation) x = Mul(observation, m) " + END,
    "ReduceMean of a part": "p = Reshape(observation, cube) m = ReduceMean<axes=[1]>(p) q = Sub(p, m) "
    "x = Reshape(q, row) " + END,
    "ReduceSum": "p = Reshape(observation, cube) m = ReduceSum<keepdims=0>(p, last) "
    "q = Concat<axis=1>(m, m, m) x = Reshape(q, row) " + END,
    "a mean that is subtracted": "m = ReduceMean<axes=[-1]>(observation) x = Sub(observation, m) " + END,
    "Softsign in parts": "p = Abs(observation) q = Add(one, p) x = Div(observation, q) " + END,
    "HardTanh": "p = Neg(one) x = Clip(observation, p, one) " + END,
    "Clip below": "x = Clip(observation, zero) " + END,
    "Min and Max": "a = Gemm<transB=1>(observation, w, four) b = Max(a, zeros) action = Min(ones, b)",
    "LayerNormalization": "x = LayerNormalization(observation, positive, six) " + END,
    "LayerNormalization without offset": "x = LayerNormalization<epsilon=0.1>(observation, positive) " + END,
    "RMSNormalization": "x = RMSNormalization(observation, positive) " + END,
    "the RMS norm in parts": RMS.format(square="Pow(observation, two)", quotient="n = Div(observation, r)"),
    "the RMS norm in other parts": RMS.format(
        square="Mul(observation, observation)", quotient="i = Div(one, r) n = Mul(i, observation)"
    ),
    "BatchNormalization": "x = BatchNormalization(observation, six, positive, six, positive) " + END,
    "Identity and Dropout": "p = Identity(observation) x, mask = Dropout(p, half) " + END,
    "Cast to float": "x = Cast<to=1>(observation) " + END,
    "Flatten": "p = Flatten(observation) x = Flatten<axis=-1>(p) " + END,
    "Reshape": "p = Reshape(observation, cube) x = Reshape(p, row) " + END,
    "Squeeze and Unsqueeze": "p = Unsqueeze(observation, axis1) q = Squeeze(p) x = Unsqueeze(q, axis0) "
    + END,
    "Transpose": "p = Reshape(observation, cube) q = Transpose<perm=[0, 2, 1]>(p) x = Reshape(q, row) " + END,
    "Expand": "s = Shape(observation) x = Expand(observation, s) " + END,
    "Concat": "p = Tanh(observation) q = Concat<axis=-1>(p, observation, p) s = Constant<value_ints=[6]>() "
    "e = Constant<value_ints=[18]>() t = Constant<value_ints=[2]>() x = Slice(q, s, e, last, t) " + END,
    "Concat of columns": "p = Transpose(observation) q = Concat<axis=1>(p, p) r = Reshape(q, row) "
    "s = Constant<value_ints=[0]>() e = Constant<value_ints=[12]>() t = Constant<value_ints=[2]>() "
    "x = Slice(r, s, e, last, t) " + END,
    "Slice backwards": "s = Constant<value_ints=[-1]>() e = Constant<value_ints=[-100]>() "
    "x = Slice(observation, s, e, last, last) " + END,
    "Split": "p, q = Split<axis=1>(observation, sizes) x = Concat<axis=1>(q, p) " + END,
    "Gather": "a = Gemm<transB=1>(observation, w, four) y = Gather<axis=1>(a, order) " + RESULT,
    "GatherND": "a = Gemm<transB=1>(observation, w, four) b = Transpose(a) c = GatherND(b, points) "
    "y = Transpose(c) " + RESULT,
    "constants computed from constants": "s = Shape(observation) n = Gather<axis=0>(s, axis1) "
    "h = Div(n, axis1) t = Sub(h, axis0) u = Concat<axis=0>(axis1, t) c = ConstantOfShape(u) o = Add(c, one) "
    "k = Cast<to=1>(t) l = Sqrt(k) b = Mul(o, l) x = Mul(observation, b) " + END,
    "the norm in parts": NORM.format(square="q = Pow(d, two)", quotient="n = Div(d, r)"),
    "the norm in other parts": NORM.format(
        square="q = Mul(d, d)", quotient="i = Reciprocal(r) n = Mul(i, d)"
    ),
    "the norm as TensorFlow has it": TF_NORM.format(
        end="k = Neg(m) l = Mul(k, j) o = Mul(observation, j) x = Add(o, l) "
    ),
    "the norm as TensorFlow has it, with an offset": TF_NORM.format(
        end="l = Mul(m, j) k = Sub(six, l) o = Mul(observation, j) x = Add(o, k) "
    ),
    "the norm as Flax has it": "q = Mul(observation, observation) m = ReduceMean<axes=[-1]>(observation) "
    "s = ReduceMean<axes=[-1]>(q) n = Mul(m, m) t = Sub(s, n) u = Max(zero, t) e = Add(u, epsilon) "
    "r = Sqrt(e) i = Reciprocal(r) j = Mul(i, positive) d = Sub(observation, m) k = Mul(d, j) "
    "x = Add(k, six) " + END,
    "a residual network": "p = Gemm(observation, square, six) q = Tanh(p) r = Add(observation, q) "
    "s = Gemm(r, square) t = Relu(s) x = Add(t, r) " + END,
    "a network that ends with Sigmoid": "y = Gemm(observation, v) action = Sigmoid(y)",
    "a network that ends with tanh in [0, 1]": "y = Gemm(observation, v) t = Tanh(y) u = Add(t, one) "
    "action = Mul(u, half)",
}
NEWER = {  # operators that opset 16 does not have
    "LayerNormalization": 17,
    "LayerNormalization without offset": 17,
    "Mish": 18,
    "Gelu": 20,
    "Gelu by tanh": 20,
    "RMSNormalization": 23,
}


def run(data: bytes, observation: NDArray[np.float32]) -> NDArray[np.float32]:
    """What onnxruntime computes."""
    session = onnxruntime.InferenceSession(data, providers=["CPUExecutionProvider"])
    return np.concatenate([session.run(None, {"observation": row[None]})[0] for row in observation])


@pytest.mark.parametrize("name", ACCEPTED)
def test_policy_computes_what_onnxruntime_does_when_its_operators_are_known(kit: Kit, name: str) -> None:
    data = kit.graph(ACCEPTED[name], CONSTANTS, NEWER.get(name, 16))
    observation = np.random.default_rng(1).normal(size=(200, 6)).astype(np.float32)
    network = parse_policy(data).network
    expected = run(data, observation)
    assert np.ptp(expected) > 0.1
    np.testing.assert_allclose(evaluate(network, observation), expected, rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("name", "operation", "count"),
    [
        ("SiLU", op.Silu, 4),
        ("Softsign in parts", op.Softsign, 3),
        ("the norm in parts", op.LayerNorm, 4),
        ("the norm in other parts", op.LayerNorm, 4),
        ("the norm as TensorFlow has it", op.LayerNorm, 4),
        ("the norm as TensorFlow has it, with an offset", op.LayerNorm, 4),
        ("the norm as Flax has it", op.LayerNorm, 6),
        ("the RMS norm in parts", op.RmsNorm, 6),
        ("the RMS norm in other parts", op.RmsNorm, 6),
        ("Softplus with its threshold", op.Softplus, 4),
        ("GELU in parts", op.Erf, 7),
        ("BatchNormalization", op.Affine, 3),
    ],
)
def test_pattern_is_one_operation_when_it_is_written_in_parts(
    kit: Kit, name: str, operation: type, count: int
) -> None:
    nodes = parse_policy(kit.graph(ACCEPTED[name], CONSTANTS, 16)).network.nodes
    assert sum(isinstance(node.operation, operation) for node in nodes) == 1
    assert len(nodes) <= count


@pytest.mark.parametrize(
    "name", ["Flatten", "Reshape", "Squeeze and Unsqueeze", "Expand", "Identity and Dropout", "Cast to float"]
)
def test_nothing_is_computed_when_values_stay_where_they_are(kit: Kit, name: str) -> None:
    assert len(parse_policy(kit.graph(ACCEPTED[name], CONSTANTS, 16)).network.nodes) == 2


def test_swish_is_read_when_the_opset_has_it(kit: Kit) -> None:
    data = kit.graph("x = Swish(observation) " + END, CONSTANTS, 24)
    assert parse_policy(data).network.nodes[0].operation == op.Silu()


@pytest.mark.parametrize("name", [name for name in ACCEPTED if name.startswith("a network that ends")])
def test_clip_is_added_when_the_last_activation_is_bounded(kit: Kit, name: str) -> None:
    network = parse_policy(kit.graph(ACCEPTED[name], CONSTANTS, 16)).network
    assert network.nodes[-1].operation == op.Clip(0.0, 1.0)
    assert not isinstance(network.nodes[-2].operation, op.Clip)


def test_page_names_every_operator_when_it_is_read() -> None:
    page = (Path(__file__).resolve().parents[3] / "docs" / "guides" / "policies.md").read_text()
    words = set(re.findall(r"\w+", page.partition("## What is read")[2].partition("##")[0]))
    assert not KNOWN - words - {"Constant"}


def test_node_keeps_its_name_when_it_has_one(kit: Kit) -> None:
    chain = kit.chain().add("Gemm", kit.weights(RNG, 6, 4), name="/net/0/Gemm").clip()
    assert parse_policy(chain.data()).network.nodes[0].name == "/net/0/Gemm"
