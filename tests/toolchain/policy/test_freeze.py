"""Checkpoint to policy.onnx, with Stable-Baselines3's own policy as the peer."""

from __future__ import annotations

import json
import pickle
import warnings
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from stable_baselines3.common.policies import ActorCriticPolicy

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.control.estimator import model_constants
from neuroflight.toolchain.contract import Mix
from neuroflight.toolchain.errors import PolicyError
from neuroflight.toolchain.ir.interpreter import evaluate
from neuroflight.toolchain.passes import optimize, size
from neuroflight.toolchain.policy.freeze import freeze, to_onnx
from neuroflight.toolchain.policy.model import parse_policy, read_policy

SCALE = [0.3, 0.3, 0.3, 10.0, 10.0, 10.0]


def configuration(**changes: object) -> dict[str, Any]:
    """The configuration of a checkpoint as training writes it."""
    return {
        "aircraft": {"name": "nf1", "sha256": "ab" * 32},
        "observation": "rate_error,rate_error_delta",
        "observation_scale": SCALE,
        "control_rate_hz": 1000,
        "filters": [],
        "hidden": [64, 64],
        "activation": "tanh",
        "output": {"scale": 0.5, "offset": 0.25},
        "motors": 4,
        "seed": 3,
        **changes,
    }


def actor(hidden: list[int], activation: type[torch.nn.Module]) -> ActorCriticPolicy:
    """An untrained policy of Stable-Baselines3, with biases that matter."""
    torch.manual_seed(1)
    policy = ActorCriticPolicy(
        gymnasium.spaces.Box(-np.inf, np.inf, (6,)),
        gymnasium.spaces.Box(-1, 1, (4,)),
        lambda _: 1e-3,
        net_arch=hidden,
        activation_fn=activation,
    )
    with torch.no_grad():
        for name, value in policy.named_parameters():
            if name.endswith("bias"):
                value.normal_(std=0.2)
    return policy


def save(
    path: Path,
    configuration: dict[str, Any],
    weights: dict[str, torch.Tensor],
    changes: dict[str, object] | None = None,
) -> Path:
    """A checkpoint file; `changes` replaces whole entries, None leaves one out."""
    content: dict[str, object] = {
        "format": "neuroflight.checkpoint",
        "version": 1,
        "config": json.dumps(configuration),
        "state_dict": weights,
        "optimizer": {},
        "progress": {"steps": 12, "seconds": 3.4},
        **(changes or {}),
    }
    torch.save({key: value for key, value in content.items() if value is not None}, path)
    return path


@pytest.fixture
def state() -> dict[str, torch.Tensor]:
    """The weights of a 6-64-64-4 policy."""
    return dict(actor([64, 64], torch.nn.Tanh).state_dict())


@pytest.mark.parametrize(("name", "module"), [("tanh", torch.nn.Tanh), ("relu", torch.nn.ReLU)])
def test_policy_does_what_the_trained_one_did_when_frozen(
    tmp_path: Path, name: str, module: type[torch.nn.Module]
) -> None:
    trained = actor([32, 16], module)
    config = configuration(hidden=[32, 16], activation=name)
    freeze(save(tmp_path / "checkpoint.pt", config, trained.state_dict()), tmp_path / "policy.onnx")
    policy = read_policy(tmp_path / "policy.onnx")
    raw = np.random.default_rng(0).normal(size=(1000, 6)).astype(np.float32)
    scaled = torch.from_numpy(raw * np.array(SCALE, np.float32))
    with torch.no_grad():
        action = trained.get_distribution(scaled).mode().numpy()
    expected = np.clip(0.5 * action + 0.25, 0, 1)
    assert np.ptp(expected) > 0.05
    np.testing.assert_allclose(evaluate(policy.network, raw), expected, rtol=0, atol=3e-6)
    assert policy.network.text == f"6-32-16-4 {name}"


@pytest.mark.parametrize("squash", [False, True])
def test_policy_needs_less_for_the_same_actions_when_scale_and_map_are_folded(
    state: dict[str, torch.Tensor], squash: bool
) -> None:
    config = configuration(output={"scale": 0.5, "offset": 0.25, "squash": squash})
    folded = parse_policy(to_onnx(config, state)).network
    unfolded = parse_policy(to_onnx(config, state, fold=False)).network
    raw = np.random.default_rng(0).normal(size=(1000, 6)).astype(np.float32)
    np.testing.assert_allclose(evaluate(unfolded, raw), evaluate(folded, raw), rtol=0, atol=3e-6)
    before, after, optimized = size(unfolded), size(folded), size(optimize(unfolded)[0])
    assert (before.nodes, before.operations, before.bytes) > (after.nodes, after.operations, after.bytes)
    assert optimized == size(optimize(folded)[0])


def test_policy_squashes_its_last_sum_when_the_trained_one_did(state: dict[str, torch.Tensor]) -> None:
    output = {"scale": 0.75, "offset": 0.375, "squash": True}
    policy = parse_policy(to_onnx(configuration(output=output), state))
    raw = np.random.default_rng(0).normal(size=(1000, 6)).astype(np.float32)
    hidden = torch.from_numpy(raw * np.array(SCALE, np.float32))
    for name in ("mlp_extractor.policy_net.0", "mlp_extractor.policy_net.2", "action_net"):
        layer = torch.nn.functional.linear(hidden, state[f"{name}.weight"], state[f"{name}.bias"])
        hidden = torch.tanh(layer)
    expected = np.clip(0.75 * hidden.numpy() + 0.375, 0, 1)
    assert np.ptp(expected) > 0.05
    np.testing.assert_allclose(evaluate(policy.network, raw), expected, rtol=0, atol=3e-6)


def test_policy_has_the_idle_that_it_was_trained_with(state: dict[str, torch.Tensor]) -> None:
    assert parse_policy(to_onnx(configuration(idle=0.23), state)).idle == 0.23
    assert parse_policy(to_onnx(configuration(), state)).idle == 0.0


def test_policy_has_mix_filters_and_model_of_its_training(
    tmp_path: Path, state: dict[str, torch.Tensor]
) -> None:
    model = model_constants(load_aircraft("nf1"), 1000)
    told = configuration(
        observation="rate_estimate,rate_estimate_error",
        filters=[["mean"]],
        mix="centred",
        gyro_filter="mean",
        model=model.document(),
    )
    freeze(save(tmp_path / "checkpoint.pt", told, state), tmp_path / "policy.onnx")
    policy = read_policy(tmp_path / "policy.onnx")
    assert (policy.mix, policy.filters, policy.model) == (Mix.CENTRED, (["mean"],), model)
    assert not {"mix", "model", "filters", "gyro_filter"} & set(policy.training)
    plain = parse_policy(to_onnx(configuration(), state))
    assert (plain.mix, plain.filters, plain.model) == (Mix.ATTITUDE_FIRST, (), None)


def test_freeze_is_refused_when_mix_or_model_is_none_that_is_known(state: dict[str, torch.Tensor]) -> None:
    with pytest.raises(PolicyError, match=r"neuroflight\.mix is 'sideways', expected attitude-first or"):
        to_onnx(configuration(mix="sideways"), state)
    with pytest.raises(PolicyError, match=r"the metadata lack neuroflight\.model"):
        to_onnx(configuration(observation="rate_estimate,rate_estimate_error"), state)


def test_file_holds_the_policy_only_when_frozen(state: dict[str, torch.Tensor]) -> None:
    data = to_onnx(configuration(), state)
    assert len(data) < 4 * 4868 + 2500
    assert b"value_net" not in data
    assert b"log_std" not in data


def test_metadata_tell_the_training_without_bulk_and_times_when_frozen(
    tmp_path: Path, state: dict[str, torch.Tensor]
) -> None:
    config = configuration(curve=[0.5] * 1000)
    freeze(save(tmp_path / "checkpoint.pt", config, state), tmp_path / "policy.onnx")
    policy = read_policy(tmp_path / "policy.onnx")
    assert (policy.training["seed"], policy.training["steps"]) == (3, 12)
    assert "curve" not in policy.training
    assert "seconds" not in policy.training
    assert (policy.aircraft, policy.aircraft_sha256) == ("nf1", "ab" * 32)


def test_bytes_are_the_same_when_frozen_twice(state: dict[str, torch.Tensor]) -> None:
    shuffled = dict(reversed(configuration().items()))
    assert to_onnx(configuration(), state) == to_onnx(shuffled, dict(reversed(state.items())))


BAD_CONFIGURATIONS: dict[str, dict[str, Any]] = {
    "lacks 'hidden'": {"hidden": None},
    "activation is 'gelu', expected tanh or relu": {"activation": "gelu"},
    "observation_scale has 5 values, expected 6": {"observation_scale": SCALE[:5]},
    "unknown observation block 'altitude'": {"observation": "altitude"},
    "is float32 [64, 6], expected float32 [32, 6]": {"hidden": [32, 64]},
    "lacks the tensor 'mlp_extractor.policy_net.4.weight'": {"hidden": [64, 64, 64]},
    "neuroflight.aircraft is 'n f/1'": {"aircraft": {"name": "n f/1", "sha256": "ab" * 32}},
    "configuration is damaged": {"motors": "four"},
    "configuration is damaged: cannot convert float infinity": {"control_rate_hz": float("inf")},
    "neuroflight.idle is '0.75', expected a motor fraction of 0 to 0.5": {"idle": 0.75},
    "unknown observation block 'rate error'": {"observation": "rate error"},
    "weights of layer 0 hold NaN or infinite values": {"observation_scale": [1e300] * 6},
}


@pytest.mark.parametrize("words", BAD_CONFIGURATIONS)
def test_checkpoint_is_refused_in_one_line_when_its_configuration_does_not_fit(
    tmp_path: Path, state: dict[str, torch.Tensor], words: str
) -> None:
    changed = configuration(**BAD_CONFIGURATIONS[words])
    config = {key: value for key, value in changed.items() if value is not None}
    out = tmp_path / "out" / "policy.onnx"
    with pytest.raises(PolicyError) as caught:
        freeze(save(tmp_path / "checkpoint.pt", config, state), out)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not out.parent.exists()


def test_checkpoint_is_refused_when_training_diverged(state: dict[str, torch.Tensor]) -> None:
    state["action_net.bias"] = torch.tensor([0.0, float("nan"), 0.0, 0.0])
    with pytest.raises(PolicyError, match="biases of layer 2 hold NaN or infinite values"):
        to_onnx(configuration(), state)


class Bomb:
    """A pickle that runs code when it is loaded: it touches a file beside itself."""

    def __init__(self, checkpoint: Path) -> None:
        self.crater = checkpoint.with_name("crater")

    def __reduce__(self) -> tuple[object, ...]:
        return Path.touch, (self.crater,)


def make_garbage(path: Path) -> None:
    path.write_bytes(b"not a checkpoint at all")


def make_bomb(path: Path) -> None:
    path.write_bytes(pickle.dumps(Bomb(path), protocol=2))


def make_torch_bomb(path: Path) -> None:
    torch.save({"format": Bomb(path)}, path)


def make_tensor(path: Path) -> None:
    torch.save(torch.zeros(3), path)


def make_other_version(path: Path) -> None:
    torch.save({"format": "neuroflight.checkpoint", "version": 2}, path)


def make_empty(path: Path) -> None:
    path.touch()


@pytest.mark.parametrize(
    "make", [make_garbage, make_bomb, make_torch_bomb, make_tensor, make_other_version, make_empty]
)
def test_file_is_refused_when_it_is_no_checkpoint(tmp_path: Path, make: Any) -> None:
    path, out = tmp_path / "checkpoint.pt", tmp_path / "policy.onnx"
    make(path)
    with pytest.raises(PolicyError) as caught:
        freeze(path, out)
    assert f"{path} is no checkpoint" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert [file.name for file in tmp_path.iterdir()] == ["checkpoint.pt"]


@pytest.mark.parametrize(
    "changes", [{"config": "{"}, {"config": "3"}, {"state_dict": None}, {"state_dict": {"a": 1}}]
)
def test_checkpoint_is_refused_when_a_part_is_damaged(
    tmp_path: Path, state: dict[str, torch.Tensor], changes: dict[str, object]
) -> None:
    path = save(tmp_path / "checkpoint.pt", configuration(), state, changes)
    with pytest.raises(PolicyError, match="is a damaged checkpoint"):
        freeze(path, tmp_path / "policy.onnx")


def test_checkpoint_is_refused_when_it_is_cut_short(tmp_path: Path, state: dict[str, torch.Tensor]) -> None:
    path = save(tmp_path / "checkpoint.pt", configuration(), state)
    path.write_bytes(path.read_bytes()[:-2000])
    with pytest.raises(PolicyError, match="is no checkpoint"):
        freeze(path, tmp_path / "policy.onnx")


def test_old_policy_stays_when_its_successor_is_refused(tmp_path: Path) -> None:
    out = tmp_path / "policy.onnx"
    out.write_bytes(to_onnx(configuration(), actor([64, 64], torch.nn.Tanh).state_dict()))
    before = out.read_bytes()
    make_garbage(tmp_path / "checkpoint.pt")
    with pytest.raises(PolicyError):
        freeze(tmp_path / "checkpoint.pt", out)
    assert out.read_bytes() == before
    assert parse_policy(before).action_count == 4


BOTTOMLESS = "[" * 100_000 + "]" * 100_000


@pytest.mark.parametrize(
    "changes",
    [
        {"config": BOTTOMLESS},
        {"config": f'{{"filters": {BOTTOMLESS}}}'},
        {"state_dict": {"action_net.bias": torch.empty(4, device="meta")}},
    ],
    ids=["nested", "nested entry", "tensor without values"],
)
def test_checkpoint_is_refused_in_one_line_when_its_content_cannot_be_used(
    tmp_path: Path, state: dict[str, torch.Tensor], changes: dict[str, object]
) -> None:
    path = save(tmp_path / "checkpoint.pt", configuration(), state, changes)
    with pytest.raises(
        PolicyError, match=r"is a damaged checkpoint|takes torch\._utils\._rebuild_meta_tensor"
    ) as caught:
        freeze(path, tmp_path / "policy.onnx")
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "policy.onnx").exists()


def test_nothing_but_the_error_is_told_when_torch_has_a_warning_for_the_file(tmp_path: Path) -> None:
    path = tmp_path / "script.pt"
    torch.save({"format": torch.nn.Linear(2, 2)}, path)
    with warnings.catch_warnings(record=True) as heard, pytest.raises(PolicyError, match="is no checkpoint"):
        warnings.simplefilter("always")
        freeze(path, tmp_path / "policy.onnx")
    assert heard == []
