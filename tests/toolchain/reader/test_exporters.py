"""Models as torch's two exporters write them, in every opset that they know, against torch itself."""

from __future__ import annotations

import contextlib
import io
import logging
import warnings
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
import onnx
import pytest
import torch
from numpy.typing import NDArray
from onnx import helper
from stable_baselines3.common.policies import ActorCriticPolicy
from torch import nn

from neuroflight.toolchain.errors import PolicyError
from neuroflight.toolchain.ir.interpreter import evaluate, replay
from neuroflight.toolchain.policy.import_onnx import PolicyClaims, imported_model
from neuroflight.toolchain.policy.model import parse_policy
from tests.sampling import sampled

if TYPE_CHECKING:
    from tests.toolchain.conftest import Kit

Float32 = NDArray[np.float32]
Way = tuple[bool, int]  # by torch.export, and the opset
SCRIPT_OPSETS = range(13, 24)  # of the exporter by TorchScript; it knows no newer one
DYNAMO_OPSETS = range(18, onnx.defs.onnx_opset_version() + 1)  # the exporter by torch.export writes no older
ALL = [(False, opset) for opset in SCRIPT_OPSETS] + [(True, opset) for opset in DYNAMO_OPSETS]
WAYS = pytest.mark.parametrize("way", sampled(ALL, (False, 13), (False, 23)))


class Clipped(nn.Module):
    """A network behind a clamp to [0, 1]."""

    def __init__(self, *layers: nn.Module) -> None:
        super().__init__()
        self.layers = nn.Sequential(*layers)

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        return torch.clamp(self.layers(observation), 0.0, 1.0)


class Branches(nn.Module):
    """Two branches, a residual, slices, chunks, views and a choice of motors."""

    def __init__(self) -> None:
        super().__init__()
        self.first, self.second = nn.Linear(6, 8), nn.Linear(3, 8)
        self.norm, self.last = nn.LayerNorm(18), nn.Linear(18, 8)

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        first = torch.tanh(self.first(observation.view(-1, 2, 3).flatten(1)))
        second = torch.relu(self.second(observation[:, 3:]))
        joined = torch.cat([first - second, first * second, observation[:, ::4]], -1)
        up, gate = self.last(joined + self.norm(joined)).chunk(2, -1)
        return torch.sigmoid(up)[:, [0, 3, 2, 1]] * torch.sigmoid(gate)


class Recurrent(nn.Module):
    """A GRU or LSTM of one step on a batch of one, as policies use them; `forward` starts from zeros."""

    def __init__(self, kind: type[nn.GRU] | type[nn.LSTM], *, batch_first: bool, layers: int) -> None:
        super().__init__()
        self.cell = kind(6, 8, layers, batch_first=batch_first)
        self.last = nn.Linear(8, 4)

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        row = observation.unsqueeze(1 if self.cell.batch_first else 0)
        outputs, _ = self.cell(row)
        return torch.clamp(self.last(outputs[:, -1] if self.cell.batch_first else outputs[-1]), 0.0, 1.0)

    def replay(self, observation: torch.Tensor) -> torch.Tensor:
        """Actions of a whole sequence (T, 6), the state carried along."""
        outputs, _ = self.cell(observation.unsqueeze(0 if self.cell.batch_first else 1))
        return torch.clamp(self.last(outputs.reshape(len(observation), -1)), 0.0, 1.0)


class Cell(nn.Module):
    """A cell that is called without a state: each export of it starts from zeros for ever."""

    def __init__(self, cell: nn.GRUCell | nn.LSTMCell) -> None:
        super().__init__()
        self.cell, self.last = cell, nn.Linear(8, 4)

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        state = self.cell(observation)
        return torch.clamp(self.last(state[0] if isinstance(state, tuple) else state), 0.0, 1.0)


class Onnxable(nn.Module):
    """Stable-Baselines3's own recipe of an export: actions, values and log-probabilities."""

    def __init__(self, policy: ActorCriticPolicy) -> None:
        super().__init__()
        self.policy = policy

    def forward(self, observation: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        actions, values, chances = self.policy(observation, deterministic=True)
        return actions, values, chances


def every_activation() -> nn.Module:
    kinds = (nn.Tanh, nn.ReLU, nn.LeakyReLU, nn.ELU, nn.Sigmoid, nn.SiLU, nn.Softsign, nn.Hardtanh, nn.ReLU6)
    hidden = [module for kind in kinds for module in (kind(), nn.Linear(8, 8))]
    return Clipped(nn.Linear(6, 8), *hidden, nn.LayerNorm(8), nn.Dropout(), nn.Flatten(), nn.Linear(8, 4))


SMOOTH: dict[str, Callable[[], nn.Module]] = {  # activations and norms that are made of others
    "GELU": nn.GELU,
    "GELU by tanh": lambda: nn.GELU("tanh"),
    "Softplus": nn.Softplus,
    "Softplus, sharp": lambda: nn.Softplus(beta=3.0, threshold=15.0),
    "Mish": nn.Mish,
    "SELU": nn.SELU,
    "CELU": nn.CELU,
    "CELU of 0.4": lambda: nn.CELU(0.4),
    "PReLU": nn.PReLU,
    "PReLU a value": lambda: SlopedPrelu(8),
    "Hardsigmoid": nn.Hardsigmoid,
    "Hardswish": nn.Hardswish,
    "RMSNorm": lambda: nn.RMSNorm(8, eps=1e-5),
    "Softmax": lambda: nn.Softmax(dim=-1),
    "Threshold": lambda: nn.Threshold(0.2, -0.3),
    "LogSigmoid": nn.LogSigmoid,
}


NEW_EXPORTER_ONLY = ("RMSNorm", "Threshold")


class SlopedPrelu(nn.PReLU):
    """A PReLU with a slope for each value."""

    def __init__(self, width: int) -> None:
        super().__init__(width)
        with torch.no_grad():
            self.weight.copy_(torch.linspace(-0.5, 0.8, width))


@pytest.fixture(autouse=True)
def quiet() -> Iterator[None]:
    """The exporters talk much of themselves."""
    logging.disable(logging.CRITICAL)
    torch.manual_seed(0)
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")
        yield
    logging.disable(logging.NOTSET)


def export(module: nn.Module, dynamo: bool, opset: int, outputs: int = 1) -> onnx.ModelProto:
    """The model as an exporter writes it, its output called `action`."""
    names: dict[str, Any] = {
        "input_names": ["observation"],
        "output_names": ["action", "value", "chance"][:outputs],
    }
    example = (torch.randn(1, 6),)
    if dynamo:
        pytest.importorskip("onnxscript", reason="torch's newer exporter needs onnxscript")
        program = torch.onnx.export(
            module.eval(), example, dynamo=True, opset_version=opset, verbose=False, **names
        )
        assert program is not None
        exported: onnx.ModelProto = program.model_proto
        return exported
    file: Any = io.BytesIO()  # which it takes, whatever its signature says
    torch.onnx.export(module.eval(), example, file, dynamo=False, opset_version=opset, **names)
    loaded: onnx.ModelProto = onnx.load_from_string(file.getvalue())
    return loaded


def policy(kit: Kit, model: onnx.ModelProto) -> bytes:
    """The model with the metadata of a policy."""
    helper.set_model_props(model, kit.chain().metadata)
    return bytes(model.SerializeToString())


def sequence(count: int) -> Float32:
    return np.random.default_rng(1).normal(size=(count, 6)).astype(np.float32)


def by_torch(compute: Callable[[torch.Tensor], torch.Tensor], observation: Float32) -> Float32:
    with torch.no_grad():
        actions: Float32 = compute(torch.from_numpy(observation)).numpy()
    return actions


@WAYS
@pytest.mark.parametrize("make", [every_activation, Branches])
def test_policy_computes_what_torch_does_when_exported(
    kit: Kit, make: Callable[[], nn.Module], way: Way
) -> None:
    module = make()
    network = parse_policy(policy(kit, export(module, *way))).network
    observation = sequence(100)
    expected = by_torch(module, observation)
    assert np.ptp(expected) > 0.02
    np.testing.assert_allclose(evaluate(network, observation), expected, rtol=0, atol=1e-6)


@WAYS
@pytest.mark.parametrize(
    ("kind", "batch_first", "layers"), [(nn.GRU, True, 1), (nn.LSTM, True, 2), (nn.GRU, False, 1)]
)
def test_state_is_carried_as_torch_carries_it_when_exported(
    kit: Kit, kind: type[nn.GRU], batch_first: bool, layers: int, way: Way
) -> None:
    module = Recurrent(kind, batch_first=batch_first, layers=layers)
    with torch.no_grad():
        for parameter in module.cell.parameters():
            parameter.mul_(2)
    network = parse_policy(policy(kit, export(module, *way))).network
    observation = sequence(50)
    expected = by_torch(module.replay, observation)
    np.testing.assert_allclose(replay(network, observation), expected, rtol=0, atol=1e-6)
    assert np.abs(by_torch(module, observation[-1:]) - expected[-1]).max() > 0.01  # the state matters


@pytest.mark.parametrize("cell", [nn.GRUCell, nn.LSTMCell])
@pytest.mark.parametrize("way", sampled([(False, 17), (True, 18)], (False, 17)))
def test_cell_is_refused_when_its_state_became_a_constant(kit: Kit, cell: type[nn.GRUCell], way: Way) -> None:
    with pytest.raises(PolicyError) as caught:
        parse_policy(policy(kit, export(Cell(cell(6, 8)), *way)))
    assert "a recurrent cell exported with a constant state forgets at every step" in str(caught.value)


def test_activation_is_refused_by_name_when_no_kernel_computes_it(kit: Kit) -> None:
    model = export(Clipped(nn.Linear(6, 8), nn.LogSoftmax(-1), nn.Linear(8, 4)), False, 17)
    with pytest.raises(PolicyError, match=r"node '/layers/layers.1/\w+' \(LogSoftmax\) is not supported"):
        parse_policy(policy(kit, model))


@pytest.mark.parametrize("way", sampled([(False, 17), (True, 18), (True, 20)], (False, 17)))
@pytest.mark.parametrize("name", SMOOTH)
def test_activation_computes_what_torch_does_when_exported(kit: Kit, name: str, way: Way) -> None:
    if name in NEW_EXPORTER_ONLY and way[0] is False:
        pytest.skip("the exporter by TorchScript does not know it")
    module = Clipped(nn.Linear(6, 8), SMOOTH[name](), nn.Linear(8, 8), SMOOTH[name](), nn.Linear(8, 4))
    network = parse_policy(policy(kit, export(module, *way))).network
    observation = np.concatenate([sequence(100), 10 * sequence(100), np.zeros((1, 6), np.float32)])
    expected = by_torch(module, observation)
    assert np.ptp(expected) > 0.02
    np.testing.assert_allclose(evaluate(network, observation), expected, rtol=0, atol=1e-6)


def test_actor_is_adopted_when_stable_baselines_exports_its_critic_too() -> None:
    actor = ActorCriticPolicy(
        gymnasium.spaces.Box(-np.inf, np.inf, (6,)),
        gymnasium.spaces.Box(-1, 1, (4,)),
        lambda _: 1e-3,
        net_arch=[16, 16],
    )
    with torch.no_grad():
        for parameter in actor.parameters():
            parameter.normal_(std=0.3)
    model = export(Onnxable(actor), False, 17, outputs=3)
    claims = PolicyClaims("rate_error,rate_error_delta", 1000, "[]", "nf1", "ab" * 32, 4)
    data, changes = imported_model(model.SerializeToString(), claims, clip=True, output="action")
    assert "appended a Clip to [0, 1]" in changes
    network = parse_policy(data).network
    assert network.text == "6-16-16-4 tanh"
    observation = sequence(50)
    expected = by_torch(lambda x: actor._predict(x, deterministic=True).clamp(0, 1), observation)
    np.testing.assert_allclose(evaluate(network, observation), expected, rtol=0, atol=1e-6)
