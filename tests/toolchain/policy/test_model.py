"""read_policy: what it accepts, and one line for everything it refuses."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import onnx
import onnxruntime
import pytest
from onnx import TensorProto, helper

from neuroflight.toolchain import contract
from neuroflight.toolchain.errors import PolicyError
from neuroflight.toolchain.ir.interpreter import evaluate
from neuroflight.toolchain.passes import optimize
from neuroflight.toolchain.policy.gyro_filters import UNFILTERED, GyroFilters, RpmFilter
from neuroflight.toolchain.policy.model import parse_policy, read_policy

if TYPE_CHECKING:
    from tests.toolchain.conftest import Chain, Kit


def refusal(data: bytes) -> str:
    """The one line with which `data` is refused."""
    with pytest.raises(PolicyError) as caught:
        parse_policy(data)
    message = str(caught.value)
    assert "\n" not in message
    return message


def edited(chain: Chain, edit: Callable[[onnx.ModelProto], object]) -> bytes:
    """The chain's file after `edit`."""
    model = chain.model()
    edit(model)
    return bytes(model.SerializeToString())


def test_policy_tells_what_it_is_when_it_is_read(kit: Kit, tmp_path: Path) -> None:
    chain = kit.mlp()
    chain.metadata["neuroflight.training"] = '{"steps": 7}'
    path = tmp_path / "policy.onnx"
    path.write_bytes(chain.data())
    policy = read_policy(path)
    assert policy.network.text == "6-64-64-4 tanh"
    assert policy.observation == "rate_error,rate_error_delta"
    assert (policy.observation_count, policy.action_count) == (6, 4)
    assert (policy.control_rate_hz, policy.filters, policy.aircraft) == (1000, (), "nf1")
    assert policy.training == {"steps": 7}
    assert policy.idle == 0.0
    assert policy.source_sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.mark.parametrize(
    ("text", "idle"), [("0", 0.0), ("0.0", 0.0), ("0.23", 0.23), ("5e-2", 0.05), ("0.5", 0.5)]
)
def test_policy_has_the_idle_that_its_metadata_tell(kit: Kit, text: str, idle: float) -> None:
    chain = kit.mlp()
    chain.metadata["neuroflight.idle"] = text
    assert parse_policy(chain.data()).idle == idle


def test_policy_has_the_terms_that_its_metadata_tell(kit: Kit) -> None:
    chain = kit.mlp()
    chain.metadata["neuroflight.observation"] = "rate_error@2,rate~15.0Hz"
    policy = parse_policy(chain.data())
    assert policy.observation == "rate_error@2,rate~15Hz"
    assert [(term.cutoff_hz, term.age) for term in policy.blocks] == [(None, 2), (15.0, 0)]


@pytest.mark.parametrize(("text", "mix"), [("attitude-first", 0), ("centred", 1)])
def test_policy_has_the_mix_that_its_metadata_tell(kit: Kit, text: str, mix: int) -> None:
    chain = kit.mlp()
    assert parse_policy(chain.data()).mix is contract.Mix.ATTITUDE_FIRST
    chain.metadata["neuroflight.mix"] = text
    assert parse_policy(chain.data()).mix is contract.Mix(mix)


def test_policy_is_behind_the_gyros_filters_that_its_metadata_say(kit: Kit) -> None:
    chain = kit.mlp()
    assert parse_policy(chain.data()).gyro_filters == UNFILTERED
    chain.metadata["neuroflight.filters"] = '[["rpm",2,120500,4000],["mean"]]'
    policy = parse_policy(chain.data())
    assert policy.gyro_filters == GyroFilters(RpmFilter(2, 120.5, 4.0), mean=True)
    assert policy.gyro_filters.chain == list(policy.filters)
    chain.metadata["neuroflight.filters"] = '[["biquad",100000,700]]'
    with pytest.raises(PolicyError, match="behind gyro filters"):
        _ = parse_policy(chain.data()).gyro_filters


MODEL = {
    "delay_steps": 2,
    "speed_curve": [-900, 4000, 150],
    "rise": 0.0625,
    "fall": 0.03125,
    "gain_max": 1e9,
    "loss_max": 40,
    "correction": 0.0625,
    "turn": [[1, -1, 2, -2], [3, 3.5, -3, -3.5], [4, -4, -4.5, 4.5]],
    "reaction": [[0, 0, 0, 0]] * 3,
}


def estimating(kit: Kit, model: object) -> Chain:
    """A policy that observes the estimated rates, with this model."""
    chain = kit.mlp()
    chain.metadata["neuroflight.observation"] = "rate_estimate,rate_estimate_error"
    chain.metadata["neuroflight.model"] = json.dumps(model)
    return chain


def test_policy_has_the_model_of_its_metadata_when_it_observes_by_one(kit: Kit) -> None:
    model = parse_policy(estimating(kit, MODEL).data()).model
    assert model is not None
    assert json.loads(json.dumps(model.document())) == MODEL
    unused = estimating(kit, MODEL)
    unused.metadata["neuroflight.observation"] = "rate_error,rate"
    assert parse_policy(unused.data()).model is None


def test_policy_is_refused_when_it_observes_by_a_model_and_has_none(kit: Kit) -> None:
    chain = estimating(kit, MODEL)
    del chain.metadata["neuroflight.model"]
    assert refusal(chain.data()).startswith("the metadata lack neuroflight.model")


@pytest.mark.parametrize(
    ("model", "text"),
    [
        ([], "neuroflight.model is "),
        ({**MODEL, "rise": 0}, "neuroflight.model: rise is 0.0, expected above 0 and at most 1; write the"),
        (
            {**MODEL, "turn": [[1] * 6] * 3, "reaction": [[1] * 6] * 3},
            "neuroflight.model is of 6 motors, the",
        ),
    ],
)
def test_policy_is_refused_when_its_model_is_that_of_no_aircraft(kit: Kit, model: object, text: str) -> None:
    assert refusal(estimating(kit, model).data()).startswith(text)


RNG = np.random.default_rng(0)
ACCEPTED: dict[str, Callable[[Kit], Chain]] = {
    "Gemm with options": lambda kit: kit.chain().add(
        "Gemm", kit.weights(RNG, 6, 4), kit.weights(RNG, 4), alpha=0.3, beta=2.0
    ),
    "Gemm without bias": lambda kit: kit.chain().add("Gemm", kit.weights(RNG, 6, 4)),
    "MatMul": lambda kit: (
        kit.chain().add("MatMul", kit.weights(RNG, 6, 4)).add("Add", kit.weights(RNG, 1, 4))
    ),
    "arithmetic": lambda kit: (
        kit.chain()
        .add("Sub", np.float32(0.25)).add("Div", np.full(6, 3, np.float32)).add("Mul", kit.weights(RNG, 6))
        .add("Sub", np.float32(0.5), first=False).add("Mul", np.float32(2), first=False)
        .add("MatMul", kit.weights(RNG, 6, 4)).add("Add", np.float32(0.3), first=False)
    ),
    "identities": lambda kit: (
        kit.chain()
        .add("Identity").add("Flatten").add("Gemm", kit.weights(RNG, 4, 6), transB=1)
        .add("Flatten", axis=0).add("Tanh").add("Relu")
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", ACCEPTED)
def test_policy_computes_what_onnxruntime_does_when_its_operators_are_known(kit: Kit, name: str) -> None:
    data = ACCEPTED[name](kit).clip().data()
    observation = np.random.default_rng(1).normal(size=(200, 6)).astype(np.float32)
    session = onnxruntime.InferenceSession(data, providers=["CPUExecutionProvider"])
    expected = np.concatenate([session.run(None, {"observation": row[None]})[0] for row in observation])
    policy = parse_policy(data)
    for network in (policy.network, optimize(policy.network)[0]):
        np.testing.assert_allclose(evaluate(network, observation), expected, rtol=0, atol=1e-6)


def test_constants_are_found_when_nodes_hold_them(kit: Kit) -> None:
    def hold(model: onnx.ModelProto) -> None:
        for name, value in (("low", 0.0), ("high", 1.0)):
            node = helper.make_node("Constant", [], [name], value_float=value)
            model.graph.node.insert(0, node)
        model.graph.node[-1].input[1:] = ["low", "high"]

    assert parse_policy(edited(kit.mlp(), hold)).network.text == "6-64-64-4 tanh"


@pytest.mark.parametrize("keep", [0, 1, 100, 0.5, 0.999])
def test_truncated_file_is_refused_when_bytes_are_missing(kit: Kit, keep: float) -> None:
    data = kit.mlp().data()
    length = int(keep if keep in (0, 1, 100) else keep * len(data))
    assert "truncated" in refusal(data[:length])


def test_garbage_is_refused_when_read_as_a_policy() -> None:
    assert "not an ONNX file" in refusal(b"\xff" * 1000)


def test_file_is_refused_when_it_is_missing_or_too_large(tmp_path: Path) -> None:
    with pytest.raises(PolicyError, match=r"cannot read the policy .*: No such file"):
        read_policy(tmp_path / "absent.onnx")
    large = tmp_path / "large.onnx"
    with large.open("wb") as file:
        file.truncate(contract.POLICY_FILE_BYTES_MAX + 1)
    with pytest.raises(PolicyError, match="expected at most 4194304"):
        read_policy(large)


def test_operator_is_refused_by_node_and_name_when_it_is_unsupported(kit: Kit) -> None:
    chain = kit.mlp()
    chain.nodes.insert(1, helper.make_node("LogSoftmax", ["value0"], ["soft"], name="/net/1/Softmax"))
    chain.nodes[2].input[0] = "soft"
    assert "node '/net/1/Softmax' (LogSoftmax) is not supported" in refusal(chain.data())


def test_operator_is_refused_when_no_standard_knows_it(kit: Kit) -> None:
    def edit(model: onnx.ModelProto) -> None:
        model.graph.node[1].op_type = "FancyTanh"

    assert "(FancyTanh) is not supported" in refusal(edited(kit.mlp(), edit))


def test_input_is_refused_when_its_shape_is_dynamic(kit: Kit) -> None:
    def edit(model: onnx.ModelProto) -> None:
        model.graph.input[0].type.tensor_type.shape.dim[0].dim_param = "batch"

    assert "dynamic shape [batch, 6]" in refusal(edited(kit.mlp(), edit))


def test_input_is_refused_when_it_is_named_otherwise(kit: Kit) -> None:
    def edit(model: onnx.ModelProto) -> None:
        model.graph.input[0].name = model.graph.node[0].input[0] = "obs"

    assert "inputs are 'obs', expected one input 'observation'" in refusal(edited(kit.mlp(), edit))


def test_output_is_refused_when_there_are_two(kit: Kit) -> None:
    def edit(model: onnx.ModelProto) -> None:
        model.graph.output.append(helper.make_tensor_value_info("value0", TensorProto.FLOAT, [1, 64]))

    assert "outputs are 'action', 'value0'" in refusal(edited(kit.mlp(), edit))


def test_input_is_refused_when_it_is_no_row(kit: Kit) -> None:
    def edit(model: onnx.ModelProto) -> None:
        model.graph.input[0].type.tensor_type.shape.dim[0].dim_value = 2
        model.graph.output[0].type.tensor_type.shape.dim[0].dim_value = 2

    assert "shape [2, 6], expected [1, n]" in refusal(edited(kit.mlp(), edit))


def test_weights_are_refused_when_they_are_float64(kit: Kit) -> None:
    chain = kit.chain().add("MatMul", np.zeros((6, 4))).clip()
    assert "initializer 'constant0_0' is of type double, expected float32" in refusal(chain.data())


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_weights_are_refused_when_one_is_not_finite(kit: Kit, value: float) -> None:
    weight = np.zeros((6, 4), np.float32)
    weight[2, 3] = value
    message = refusal(kit.chain().add("MatMul", weight, name="/0/MatMul").clip().data())
    assert "node '/0/MatMul' (MatMul)" in message
    assert "holds 1 NaN or infinite values" in message


def test_weights_are_refused_when_they_lie_in_another_file(kit: Kit) -> None:
    def edit(model: onnx.ModelProto) -> None:
        tensor = model.graph.initializer[0]
        tensor.data_location = TensorProto.EXTERNAL
        tensor.external_data.add(key="location", value="../weights.bin")

    assert "initializer 'constant0_0' keeps its values in another file" in refusal(edited(kit.mlp(), edit))


def test_nodes_after_the_action_are_left_out_when_a_graph_branches(kit: Kit) -> None:
    chain = kit.mlp((6, 4, 4, 4))
    chain.nodes[2].input[0] = "value0"  # past the first activation, which stays without a taker
    network = parse_policy(chain.data()).network
    assert [node.inputs for node in network.nodes[:3]] == [(0,), (1,), (1,)]


def test_division_is_refused_when_its_divisor_is_zero(kit: Kit) -> None:
    chain = kit.chain(6, 6).add("Div", np.zeros(6, np.float32)).clip()
    assert "divides by zero" in refusal(chain.data())


@pytest.mark.parametrize("bounds", [(0, 1.5), (-0.1, 1), (0, None), (None, 1)])
def test_policy_is_refused_when_its_output_may_leave_0_to_1(
    kit: Kit, bounds: tuple[float | None, float | None]
) -> None:
    operands = [None if bound is None else np.float32(bound) for bound in bounds]
    chain = kit.chain().add("Gemm", np.zeros((6, 4), np.float32)).add("Clip", *operands)
    assert "expected Clip within [0, 1]" in refusal(chain.data())


def test_policy_is_refused_when_nothing_bounds_its_output(kit: Kit) -> None:
    assert "expected Clip within [0, 1]" in refusal(
        kit.chain().add("Gemm", np.zeros((6, 4), np.float32)).data()
    )


OPTIONAL = ("META_IDLE", "META_MIX", "META_MODEL", "META_GENERAL", "META_SPECIALIZED")


@pytest.mark.parametrize(
    "key", sorted(k for k in vars(contract) if k.startswith("META_") and k not in OPTIONAL)
)
def test_policy_is_refused_when_a_key_of_its_metadata_is_missing(kit: Kit, key: str) -> None:
    chain = kit.mlp()
    del chain.metadata[getattr(contract, key)]
    assert refusal(chain.data()).startswith(f"the metadata lack {getattr(contract, key)}")


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("version", "2"),
        ("observation", "rate_error,rate_of_climb"),
        ("control_rate_hz", "fast"),
        ("control_rate_hz", "-1000"),
        ("control_rate_hz", "8001"),
        ("control_rate_hz", "999999"),
        ("filters", "{}"),
        ("filters", "["),
        ("observation", "rate_error@17,rate"),
        ("mix", "centered"),
        ("mix", ""),
        ("mix", "x" * 100_000),
        ("idle", ""),
        ("idle", "0.51"),
        ("idle", "-0.1"),
        ("idle", "nan"),
        ("idle", "1e-999999999"),
        ("idle", "0" * 100_000),
        ("aircraft", '"; system("rm") /*'),
        ("aircraft", ""),
        ("aircraft_sha256", "abc"),
        ("training", "[]"),
        ("training", "[" * 100_000),
    ],
)
def test_policy_is_refused_by_key_when_its_metadata_make_no_sense(kit: Kit, key: str, value: str) -> None:
    chain = kit.mlp()
    chain.metadata[f"neuroflight.{key}"] = value
    message = refusal(chain.data())
    assert message.startswith(f"neuroflight.{key} is ")
    assert len(message) < 400


@pytest.mark.parametrize(
    ("observation", "words"),
    [
        ("rate_error,rate~500Hz", "observation 'rate~500Hz': a low-pass at 500 Hz, expected"),
        ("rate_error", "takes 6 values, but its blocks rate_error make 3 with 4 motors"),
    ],
)
def test_policy_is_refused_when_its_observation_is_none(kit: Kit, observation: str, words: str) -> None:
    chain = kit.mlp()
    chain.metadata["neuroflight.observation"] = observation
    assert words in refusal(chain.data())


def test_reader_never_crashes_when_bytes_are_damaged(kit: Kit) -> None:
    data = bytearray(kit.mlp((6, 3, 4)).data())
    rng = np.random.default_rng(0)
    refused = 0
    for _ in range(400):
        damaged = bytearray(data)
        for place in rng.integers(0, len(data), 3):
            damaged[place] = rng.integers(0, 256)
        try:
            parse_policy(bytes(damaged))
        except PolicyError as error:
            assert "\n" not in str(error)
            refused += 1
    assert refused > 50
