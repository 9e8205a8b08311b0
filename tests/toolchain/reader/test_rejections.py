"""What the reader refuses, each in one line that names the node or value."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np
import onnx
import pytest
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

from neuroflight.toolchain.errors import PolicyError
from neuroflight.toolchain.policy.model import parse_policy

if TYPE_CHECKING:
    from tests.toolchain.conftest import Kit

CONSTANTS: Mapping[str, NDArray[np.generic]] = {
    "w": np.full((4, 6), 0.1, np.float32),
    "v": np.full((6, 4), 0.1, np.float32),
    "cube": np.full((2, 6, 4), 0.1, np.float32),
    "column": np.ones((6, 1), np.float32),
    "whole": np.ones((6, 4), np.int64),
    "byte": np.ones((6, 4), np.int8),
    "wide": np.zeros((6, 4)),
    "half": np.zeros((6, 4), np.float16),
    "six": np.ones(6, np.float32),
    "three": np.ones(3, np.float32),
    "large": np.full((6, 4), 1e3, np.float32),
    "rising": np.arange(6, dtype=np.float32),
    "noughts": np.zeros(6, np.float32),
    "tiny": np.full(6, 1e-45, np.float32),
    "nan": np.full((6, 4), np.nan, np.float32),
    "infinity": np.array(np.inf, np.float32),
    "zero": np.array(0, np.float32),
    "one": np.array(1, np.float32),
    "two": np.array(2, np.float32),
    "true": np.array(True),
    "ratio": np.array(0.5, np.float32),
    "whole_one": np.array([1], np.int64),
    "ten": np.array([10], np.int64),
    "two_rows": np.array([2, 3]),
    "one_row": np.array([1, 6]),
    "odd": np.array([1, 5], np.int64),
    "huge": np.array([1, 1 << 20, 6], np.int64),
    "negative": np.array([-3, 6], np.int64),
    "megabyte": np.array([1 << 18], np.int64),
}
END = " a = Gemm<transB=1>(x, w) action = Clip(a, zero, one)"  # of a body that computes x
OUT = " action = Clip(a, zero, one)"  # of a body that computes a, the four motors
BRANCH = "{}_branch = {} () => (float[1,6] y) {{ y = Constant<value_floats=[1.0]>() }}"
IF = f"<{BRANCH.format('then', 'g')}, {BRANCH.format('else', 'h')}>"
REFUSED = [
    # operators
    ("x = LogSoftmax(observation)", "node 'x' (LogSoftmax) is not supported, supported are Add, BatchNor"),
    (f"x = If{IF}(true)", "node 'x' (If) is not supported"),
    (
        "x = com.microsoft.Gelu(observation)",
        "the model was optimized by onnxruntime: node 'x' (com.microsoft::Gelu)",
    ),
    (
        "x = Where(observation, observation, six)",
        "(Where) chooses by what is no comparison of values",
    ),
    ("x = Exp(observation)", "node 'x' (Exp) takes values computed from the observation"),
    # weights
    (
        "a = MatMul(observation, whole)" + OUT,
        "(MatMul) takes weights 'whole' of type int64, expected float32",
    ),
    ("a = MatMul(observation, byte)" + OUT, "initializer 'byte' is of type int8, expected float32"),
    ("a = MatMul(observation, wide)" + OUT, "initializer 'wide' is of type double, expected float32"),
    (
        "a = MatMul(observation, half)" + OUT,
        "the model computes in float16: initializer 'half'; export it in float32",
    ),
    ("a = MatMul(observation, nan)" + OUT, "node 'a' (MatMul) takes 'nan', which holds 24 NaN or infinite"),
    ("a = MatMul(observation, cube)" + OUT, "(MatMul) has weights of shape [2, 6, 4], expected a matrix"),
    ("a = Gemm(observation, w)" + OUT, "node 'a' (Gemm) has weights for 4 inputs, expected 6"),
    ("a = Gemm<alpha=3e38>(observation, large)" + OUT, "scales its weights beyond the range of float32"),
    ("x = Add(observation, whole_one)", "(Add) takes 'whole_one' of type int64, expected float32"),
    ("x = Cast<to=10>(observation)", "the model computes in float16: node 'x' (Cast); export it in float32"),
    # arithmetic
    ("p = Tanh(observation) x = Div(observation, p)", "node 'x' (Div) divides a value by another"),
    ("x = Div(six, observation)", "node 'x' (Div) divides a constant by a value"),
    ("x = Div(observation, noughts)", "node 'x' (Div) divides by zero"),
    ("x = Div(observation, tiny)", "node 'x' (Div) scales its value beyond the range of float32"),
    ("x = Mul(observation, noughts)", "(Mul) computes with zeros only; a recurrent cell exported with"),
    (
        "p = MatMul(six, v) q = MatMul(observation, v) a = Add(p, q)" + OUT,
        "'p' (MatMul) multiplies constants only",
    ),
    ("p = Tanh(observation) x = Max(observation, p, six)", "node 'x' (Max) takes 3 values, expected two"),
    (
        "p = MatMul(observation, v) a = Gemm(observation, v, p)" + OUT,
        "takes 'p' where a constant is expected",
    ),
    # activations and norms
    (
        "x = Clip(observation, one, zero)",
        "(Clip) has the bounds 1.0 and 0.0, expected finite ones, the lower",
    ),
    ("x = Clip(observation, infinity)", "node 'x' (Clip) has the bounds inf and None"),
    ("p = Abs(observation) x = Sqrt(p)", "node 'x' (Sqrt) takes values computed from the observation"),
    (
        "m = ReduceMean(observation) d = Sub(observation, m) q = Mul(d, d) s = ReduceMean(q) "
        "x = Mul(observation, s)",
        "node 'x' (Mul) takes a value and the variance: parts of no pattern",
    ),
    ("x = Pow(observation, one)", "node 'x' (Pow) raises to another power than 2 or 3"),
    ("p = Celu<alpha=-1.0>(observation)  x = Neg(p)", "node 'p' (Celu) has alpha -1, expected more than 0"),
    ("x = Selu<gamma=inf>(observation)", "node 'x' (Selu) has gamma inf, expected a finite number"),
    ("x = PRelu(observation, w)", "node 'x' (PRelu) has slopes that do not fit a value of shape [1, 6]"),
    ("x = Softmax<axis=2>(observation)", "node 'x' (Softmax) shares out axis 2 of a value of shape [1, 6]"),
    ("x = Log(observation)", "node 'x' (Log) takes the logarithm of what is no Sigmoid"),
    ("x = LayerNormalization<epsilon=0.0>(observation, six)", "has epsilon 0.0, expected more than 0"),
    (
        "q = Reshape(observation, two_rows) p = LayerNormalization(q, three) x = Reshape(p, one_row)",
        "node 'p' (LayerNormalization) normalizes part of a value of shape [2, 3]",
    ),
    ("x = Dropout(observation, ratio, true)", "node 'x' (Dropout) is in training mode"),
    (
        "x, m, n = BatchNormalization<training_mode=1>(observation, six, six, six, six)",
        "node 'x, m, n' (BatchNormalization) is in training mode, expected inference",
    ),
    # shapes
    ("x = Reshape(observation, odd)", "node 'x' (Reshape) does not fit the values it takes: cannot reshape"),
    ("x = Reshape(observation, negative)", "(Reshape) does not fit the values it takes: shape [-3, 6]"),
    (
        "c0 = ConstantOfShape(megabyte) "
        + " ".join(f"c{n + 1} = Neg(c{n})" for n in range(300))
        + " x = Identity(observation)",
        "makes it more than 268435456 bytes of constants",
    ),
    ("x = Expand(observation, huge)", "(Expand) does not fit the values it takes: shape [1, 1048576, 6]"),
    (
        "x, y = Split<axis=1, num_outputs=3>(observation)",
        "(Split) does not fit the values it takes: num_outputs 3",
    ),
    ("x = Slice(observation, ten, ten, whole_one)", "node 'x' (Slice) gives 0 values"),
    ("x = Gather<axis=1>(observation, ten)", "node 'x' (Gather) does not fit the values it takes: index 10"),
    (
        "p = MatMul(observation, column) q = Squeeze(p) a = MatMul(q, v)" + OUT,
        "value of shape [], expected one row",
    ),
    ("x = Add(observation, three)", "node 'x' (Add) joins values of shapes [1, 6] and [3]"),
    ("action = Clip(observation, zero, one)", "computes actions of shape [1, 6], declared [1, 4]"),
    # the graph
    ("action = Identity(three)", "output 'action' is no function of the observation"),
    (
        "p = Add(observation, q) q = Tanh(p) x = Identity(q)",
        "'q', which depends on that node itself: a cyclic",
    ),
    ("x = Tanh(p) p = Tanh(observation)", "node 'x' (Tanh) takes 'p', which a later node computes"),
    ("x = Tanh(p)", "node 'x' (Tanh) takes 'p', which nothing computes"),
    ("x = Tanh(observation) x = Tanh(x)", "node 'x' (Tanh) computes 'x', which has a value already"),
    ("x = LayerNormalization(observation, )", "node 'x' (LayerNormalization) lacks its input Scale"),
    ("a = MatMul(observation, v) action = Tanh(a)", "the policy ends with Tanh, expected Clip within [0, 1]"),
]
BODIES = [body if "action" in body else body + END for body, _ in REFUSED]


def refusal(data: bytes) -> str:
    """The one line with which `data` is refused."""
    with pytest.raises(PolicyError) as caught:
        parse_policy(data)
    message = str(caught.value)
    assert "\n" not in message
    assert len(message) < 700
    return message


@pytest.mark.parametrize(
    ("body", "words"), [(body, words) for body, (_, words) in zip(BODIES, REFUSED, strict=True)]
)
def test_policy_is_refused_by_node_when_it_cannot_be_proven(kit: Kit, body: str, words: str) -> None:
    assert words in refusal(kit.graph(body, CONSTANTS, 22))


def edited(kit: Kit, edit: Callable[[onnx.ModelProto], object]) -> bytes:
    """A sound policy after `edit`."""
    model = kit.mlp((6, 3, 4)).model()
    edit(model)
    return bytes(model.SerializeToString())


def two_names(model: onnx.ModelProto) -> None:
    model.graph.initializer.append(model.graph.initializer[0])


def state_as_input(model: onnx.ModelProto) -> None:
    model.graph.input.append(helper.make_tensor_value_info("state", TensorProto.FLOAT, [1, 8]))


def many_nodes(model: onnx.ModelProto) -> None:
    model.graph.node.extend(helper.make_node("Tanh", ["observation"], [f"t{i}"]) for i in range(5000))


def extra_output(model: onnx.ModelProto) -> None:
    model.graph.node[1].output.append("second")


MODELS: dict[str, Callable[[onnx.ModelProto], object]] = {
    "is of opset 12, expected 13 or newer": lambda model: setattr(model.opset_import[0], "version", 12),
    "is of opset 99, and onnx": lambda model: setattr(model.opset_import[0], "version", 99),
    "names no opset": lambda model: model.ClearField("opset_import"),
    "two initializers of the policy have one name": two_names,
    "'state', expected one input 'observation'; state is carried by GRU and LSTM nodes": state_as_input,
    "the policy has 5004 nodes, expected at most": many_nodes,
    "local functions or sparse weights": lambda model: model.functions.add(),
    "it has no graph": lambda model: model.ClearField("graph"),
    "an ONNX model without metadata; add them with `neuroflight policy import MODEL.onnx --observation": (
        lambda model: model.ClearField("metadata_props")
    ),
    "not a valid ONNX model, or a truncated one": extra_output,
    "input 'observation' is double": lambda model: setattr(
        model.graph.input[0].type.tensor_type, "elem_type", TensorProto.DOUBLE
    ),
}


@pytest.mark.parametrize("words", MODELS)
def test_policy_is_refused_as_a_whole_when_its_model_is_not_sound(kit: Kit, words: str) -> None:
    assert words in refusal(edited(kit, MODELS[words]))


def test_operator_is_refused_when_its_opset_lacks_it(kit: Kit) -> None:
    data = kit.graph("x = LayerNormalization(observation, six)" + END, CONSTANTS, 16)
    assert "node 'x' (LayerNormalization) does not exist in opset 16" in refusal(data)


def shared_matrix(kit: Kit, count: int) -> bytes:
    """A small file that asks for much: one matrix, multiplied `count` times."""
    chain = kit.chain().add("Gemm", np.ones((400, 6), np.float32), transB=1)
    chain.add("MatMul", np.full((400, 400), 1e-3, np.float32))
    matrix = chain.tensors[-1].name
    for _ in range(count):
        index, value = len(chain.nodes), chain.nodes[-1].output[0]
        chain.nodes.append(helper.make_node("MatMul", [value, matrix], [f"value{index}"], name=f"mul{index}"))
    return bytes(chain.add("Gemm", np.ones((4, 400), np.float32), transB=1).clip().data())


def test_policy_is_refused_at_once_when_a_small_file_asks_for_much(kit: Kit) -> None:
    started = time.process_time()
    message = refusal(shared_matrix(kit, 500))
    assert (
        "node 'mul2' (MatMul) brings the policy to 322400 multiply-adds, expected at most 216000" in message
    )
    assert time.process_time() - started < 2


def test_policy_is_refused_when_a_node_shuffles_its_values(kit: Kit) -> None:
    order = np.random.default_rng(0).permutation(400)
    chain = kit.chain().add("Gemm", np.ones((400, 6), np.float32), transB=1).add("Gather", order, axis=1)
    data = chain.add("Gemm", np.ones((4, 400), np.float32), transB=1).clip().data()
    assert "pieces, expected at most 64; sort the weights before or after it instead" in refusal(data)


def test_message_stays_short_when_a_name_is_long(kit: Kit) -> None:
    def lengthen(model: onnx.ModelProto) -> None:
        model.graph.node[1].name = "x" * 100_000
        model.graph.node[1].op_type = "LogSoftmax"

    assert len(refusal(edited(kit, lengthen))) < 700


RECURRENT = (
    "s = Constant<value_ints=[0]>() r = Unsqueeze(observation, s) y, h = GRU<hidden_size=2, "
    "linear_before_reset=1>(r, W, R, B) c = Squeeze(h, s) e = Concat<axis=1>(c, observation) "
    "p, q = Split<axis=1, num_outputs=2>(e) u = LayerNormalization(p, scale) g = Sigmoid(q) m = Mul(q, g) "
    "n = Elu<alpha=0.5>(m) k = Add(u, n) b = Gather<axis=1>(k, order) l = MatMul(b, out) "
    "action = Clip(l, zero, one)"
)


def test_reader_never_crashes_when_bytes_of_many_operators_are_damaged(kit: Kit) -> None:
    rng = np.random.default_rng(0)
    constants = {
        "W": kit.weights(rng, 1, 6, 6),
        "R": kit.weights(rng, 1, 6, 2),
        "B": kit.weights(rng, 1, 12),
        "scale": np.ones(4, np.float32),
        "order": np.array([3, 0, 1, 2]),
        "out": kit.weights(rng, 4, 4),
        **CONSTANTS,
    }
    data = kit.graph(RECURRENT, constants, 18)
    parse_policy(data)
    outcomes = [0, 0]
    for count in (1, 2, 3) * 200:
        damaged = bytearray(data[: rng.integers(1, len(data))] if rng.random() < 0.1 else data)
        for place in rng.integers(0, len(damaged), count):
            damaged[place] = (
                rng.integers(0, 256) if rng.random() < 0.5 else damaged[place] ^ (1 << rng.integers(8))
            )
        outcomes[outcome(bytes(damaged))] += 1
    assert min(outcomes) > 50


def test_reader_never_crashes_when_nodes_are_rewired(kit: Kit) -> None:
    rng = np.random.default_rng(1)
    sound = [
        "p = Tanh(observation) q = Mul(p, six) x = Add(q, observation)",
        "p = Reshape(observation, two_rows) q = Transpose(p) x = Reshape(q, one_row)",
        "p = Slice(observation, whole_one, ten, whole_one) q = Concat<axis=1>(p, observation, p) "
        "r = Gather<axis=1>(q, odd) x = Concat<axis=1>(r, r, r)",
        "p = LayerNormalization(observation, six) q = Clip(p, zero, one) x = Sub(six, q)",
    ]
    files = [kit.graph(body + END, CONSTANTS, 22) for body in sound]
    assert not any(map(outcome, files))
    models = [onnx.load_from_string(data) for data in files]
    operators = sorted({node.op_type for model in models for node in model.graph.node})
    seen = [0, 0]
    for _ in range(600):
        model = onnx.ModelProto()
        model.CopyFrom(models[rng.integers(len(models))])
        graph = model.graph
        node = graph.node[rng.integers(len(graph.node))]
        names = ["", *(name for other in graph.node for name in (*other.input, *other.output))]
        match rng.integers(4):
            case 0:
                node.op_type = operators[rng.integers(len(operators))]
            case 1:
                node.input.append(names[rng.integers(len(names))])
            case 2 if node.input:
                node.input[rng.integers(len(node.input))] = names[rng.integers(len(names))]
            case _ if graph.initializer:
                tensor = graph.initializer[rng.integers(len(graph.initializer))]
                values = numpy_helper.to_array(tensor)
                tensor.CopyFrom(numpy_helper.from_array(np.array([values, values]), tensor.name))
        seen[outcome(model.SerializeToString())] += 1
    assert min(seen) > 20


def outcome(data: bytes) -> int:
    """1 for a policy that is refused in one line, 0 for one that is read."""
    try:
        parse_policy(data)
    except PolicyError as error:
        assert "\n" not in str(error)
        return 1
    return 0
