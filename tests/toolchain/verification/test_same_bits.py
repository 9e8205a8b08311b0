"""One policy, many machines: torch, onnxruntime, the evaluator, this machine's C and the Cortex-M7's."""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import onnx
import onnxruntime
import pytest
import torch

from neuroflight.toolchain.ir.interpreter import evaluate
from tests.sampling import examples, sampled

if TYPE_CHECKING:
    from tests.toolchain.conftest import Chain, Float32, Kit

TOLERANCE = 1e-6  # absolute, at unit scale
COUNT = examples(10_000)  # of observations

SHAPES = {
    "6-64-64-4 tanh": ((6, 64, 64, 4), "Tanh"),
    "6-32-32-4 tanh": ((6, 32, 32, 4), "Tanh"),
    "6-33-7-4 relu": ((6, 33, 7, 4), "Relu"),
    "6-5-4 tanh": ((6, 5, 4), "Tanh"),
    "6-4": ((6, 4), "Tanh"),
}


def odd_chain(kit: Kit) -> Chain:
    """What no perceptron has: a clip first, bounds on one side, activations in a row, affine maps between."""
    rng = np.random.default_rng(5)
    chain = kit.chain(6, 4)
    chain.add("Clip", np.float32(-3), np.float32(3))
    chain.add("Gemm", kit.weights(rng, 13, 6), kit.weights(rng, 13), transB=1).add("Relu").add("Tanh")
    chain.add("Mul", np.float32(1.5)).add("Clip", None, np.float32(0.75)).add("Clip", np.float32(-0.5))
    chain.add("Gemm", kit.weights(rng, 4, 13), kit.weights(rng, 4), transB=1).add("Tanh")
    chain.add("Mul", np.float32(0.5)).add("Add", np.array([0.5, 0.4, 0.6, 0.5], np.float32))
    return chain.clip()


def chain_of(kit: Kit, name: str) -> Chain:
    return odd_chain(kit) if name == "odd" else kit.mlp(*SHAPES[name])


def assert_same_bits(got: Float32, expected: Float32) -> None:
    """NaN has many bits, so that it is compared as such."""
    numbers = ~np.isnan(expected)
    assert numbers.any()
    np.testing.assert_array_equal(np.isnan(got), ~numbers)
    np.testing.assert_array_equal(got[numbers].view(np.uint32), expected[numbers].view(np.uint32))


@pytest.mark.parametrize("name", [*SHAPES, "odd"])
def test_host_c_gives_the_evaluators_bits_when_observations_are_anything(
    kit: Kit, tmp_path: Path, name: str
) -> None:
    policy = kit.compiled(chain_of(kit, name))
    observation = kit.observations(COUNT, policy.policy.observation_count)
    expected = evaluate(policy.network, observation)
    assert_same_bits(kit.host(policy, tmp_path).actions(observation), expected)


@pytest.mark.parametrize("name", [*SHAPES, "odd"])
def test_cortex_m7_gives_the_hosts_bits_when_observations_are_anything(
    kit: Kit, tmp_path: Path, name: str
) -> None:
    policy = kit.compiled(chain_of(kit, name))
    observation = kit.observations(examples(1_000), policy.policy.observation_count, seed=1)
    host = kit.host(policy, tmp_path / "host").actions(observation)
    assert_same_bits(kit.arm(policy, tmp_path / "arm").actions(observation), host)


@pytest.mark.parametrize("name", [*SHAPES, "odd"])
def test_actions_agree_with_onnxruntime_when_observations_are_of_unit_scale(kit: Kit, name: str) -> None:
    chain = chain_of(kit, name)
    policy = kit.compiled(chain)
    session = onnxruntime.InferenceSession(chain.data(), providers=["CPUExecutionProvider"])
    rng = np.random.default_rng(3)
    observation = rng.normal(size=(COUNT, policy.policy.observation_count)).astype(np.float32)
    expected = np.concatenate([session.run(None, {"observation": row[None]})[0] for row in observation])
    assert np.ptp(expected) > 0.1
    np.testing.assert_allclose(evaluate(policy.network, observation), expected, rtol=0, atol=TOLERANCE)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_actions_agree_with_torch_when_torch_exported_the_model(kit: Kit, tmp_path: Path) -> None:
    torch.manual_seed(7)
    module = torch.nn.Sequential(
        torch.nn.Flatten(),
        torch.nn.Linear(6, 64),
        torch.nn.Tanh(),
        torch.nn.Linear(64, 64),
        torch.nn.ReLU(),
        torch.nn.Linear(64, 4),
        torch.nn.Hardtanh(0.0, 1.0),
    )
    path = tmp_path / "policy.onnx"
    torch.onnx.export(
        module,
        (torch.zeros(1, 6),),
        str(path),
        dynamo=False,
        opset_version=17,
        input_names=["observation"],
        output_names=["action"],
    )
    model = onnx.load(path)
    onnx.helper.set_model_props(model, kit.chain().metadata)
    policy = kit.compiled(model.SerializeToString())
    observation = np.random.default_rng(4).normal(size=(COUNT, 6)).astype(np.float32)
    with torch.no_grad():
        expected = module(torch.from_numpy(observation)).numpy()
    np.testing.assert_allclose(evaluate(policy.network, observation), expected, rtol=0, atol=TOLERANCE)


def test_actions_are_bounded_or_nan_when_observations_are_anything(kit: Kit) -> None:
    policy = kit.compiled(kit.mlp())
    observation = kit.observations(COUNT, 6, seed=2)
    action = evaluate(policy.network, observation)
    sane = (np.abs(observation) < 1e30).all(axis=1)  # false for NaN
    assert np.isfinite(action[sane]).all()
    assert np.isnan(action[~np.isfinite(observation).all(axis=1)]).all()
    assert np.nanmin(action) >= 0
    assert np.nanmax(action) <= 1


@pytest.mark.parametrize("activation", ["Tanh", "Relu"])
def test_all_actions_are_nan_when_one_value_is_nan(kit: Kit, tmp_path: Path, activation: str) -> None:
    policy = kit.compiled(kit.mlp(activation=activation))
    observation = np.zeros((6, 6), np.float32)
    np.fill_diagonal(observation, np.nan)
    assert np.isnan(kit.host(policy, tmp_path / "host").actions(observation)).all()
    assert np.isnan(kit.arm(policy, tmp_path / "arm").actions(observation)).all()


@pytest.mark.parametrize("activation", ["Tanh", "Relu", "LeakyRelu", "Softsign", "Elu", "Sigmoid"])
@pytest.mark.parametrize("bad", sampled([np.nan, np.inf], np.inf))
def test_an_action_is_nan_when_a_weight_is_no_number(
    kit: Kit, tmp_path: Path, activation: str, bad: float
) -> None:
    """Each weight in turn. Layers stand behind the tables of functions; these widths need no padding."""
    policy = kit.compiled(kit.mlp((6, 8, 8, 4), activation))
    host, arm = kit.host(policy, tmp_path / "host"), kit.arm(policy, tmp_path / "arm")
    observation = kit.observations(2, 6)[:1]
    table_of_policy, silent = policy.plan.table, []
    layers = range(table_of_policy.size - (7 * 8 + 9 * 8 + 9 * 4), table_of_policy.size)
    for index in layers:
        table = table_of_policy.copy()
        table[index] = bad
        host.init(ctypes.c_void_p(table.ctypes.data))
        if not np.isnan(host.actions(observation)).any():
            silent.append(index)
    assert not silent
    struck = table_of_policy.copy()
    struck[layers[0]] = bad
    arm.init(struck)
    assert np.isnan(arm.actions(observation)).all()


@pytest.mark.parametrize("name", ["6-64-64-4 tanh", "6-33-7-4 relu", "odd"])
def test_cortex_m7_takes_the_same_path_when_observations_differ(kit: Kit, tmp_path: Path, name: str) -> None:
    policy = kit.compiled(chain_of(kit, name))
    arm = kit.arm(policy, tmp_path)
    paths = []
    with arm.machine.recording() as runs:
        for row in kit.observations(40, policy.policy.observation_count, seed=6):
            arm.observe(row)
            runs.clear()
            arm.machine.call(*arm.step)
            paths.append(list(runs))
    assert len(paths[0]) > 10
    assert all(path == paths[0] for path in paths)


def test_table_of_another_policy_is_used_when_it_is_given_at_init(kit: Kit, tmp_path: Path) -> None:
    ours, other = kit.compiled(kit.mlp(seed=1)), kit.compiled(kit.mlp(seed=2))
    assert ours.plan.architecture_hash == other.plan.architecture_hash
    host = kit.host(ours, tmp_path)
    table = other.plan.table
    host.init(ctypes.c_void_p(table.ctypes.data))
    observation = kit.observations(200, 6)
    assert_same_bits(host.actions(observation), evaluate(other.network, observation))
    host.init(None)
    assert_same_bits(host.actions(observation), evaluate(ours.network, observation))
