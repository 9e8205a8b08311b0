"""Checkpoints with a GRU or an LSTM to policy.onnx, with torch's own as the peer."""

from __future__ import annotations

from typing import Any

import numpy as np
import onnxruntime
import pytest
import torch

from neuroflight.toolchain.errors import PolicyError
from neuroflight.toolchain.ir.interpreter import advance, clear_state
from neuroflight.toolchain.policy.freeze import to_onnx
from neuroflight.toolchain.policy.model import parse_policy

SCALE = [0.3, 0.3, 0.3, 10.0, 10.0, 10.0]
UNITS, HIDDEN, MOTORS = 5, 7, 4


def configuration(recurrent: str, **changes: object) -> dict[str, Any]:
    return {
        "aircraft": {"name": "nf1", "sha256": "ab" * 32},
        "observation": "rate_error,rate_error_delta",
        "observation_scale": SCALE,
        "control_rate_hz": 1000,
        "filters": [],
        "hidden": [UNITS, HIDDEN],
        "recurrent": recurrent,
        "activation": "tanh",
        "output": {"scale": 0.5, "offset": 0.25},
        "motors": MOTORS,
        **changes,
    }


class Peer(torch.nn.Module):
    """The policy of `configuration` in torch: a sequence of observations to motor fractions."""

    def __init__(self, kind: str) -> None:
        super().__init__()
        torch.manual_seed(2)
        self.kind = kind
        self.recurrent = {"gru": torch.nn.GRU, "lstm": torch.nn.LSTM}[kind](len(SCALE), UNITS)
        self.hidden = torch.nn.Linear(UNITS, HIDDEN)
        self.last = torch.nn.Linear(HIDDEN, MOTORS)

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        memory, _ = self.recurrent(observation * torch.tensor(SCALE))
        output: torch.Tensor = 0.5 * self.last(torch.tanh(self.hidden(memory))) + 0.25
        return output.clamp(0.0, 1.0)

    def tensors(self) -> dict[str, torch.Tensor]:
        """By the names of a checkpoint."""
        places = {"hidden": "mlp_extractor.policy_net.0", "last": "action_net"}
        return {
            ".".join([places.get(name.split(".")[0], "recurrent"), name.split(".")[1]]): value.detach()
            for name, value in self.state_dict().items()
        }


@pytest.fixture(params=["gru", "lstm"])
def peer(request: pytest.FixtureRequest) -> Peer:
    return Peer(request.param)


def test_policy_remembers_as_torch_does(peer: Peer) -> None:
    policy = parse_policy(to_onnx(configuration(peer.kind), peer.tensors()))
    observation = np.random.default_rng(1).normal(size=(30, 1, 6)).astype(np.float32)
    with torch.no_grad():
        expected = peer(torch.from_numpy(observation)).numpy()
    state = clear_state(policy.network, 1)
    for seen, wanted in zip(observation, expected, strict=True):
        action, state = advance(policy.network, seen, state)
        assert action == pytest.approx(wanted, abs=1e-5)


def test_the_file_is_one_step_of_the_policy_in_onnxruntime(peer: Peer) -> None:
    session = onnxruntime.InferenceSession(to_onnx(configuration(peer.kind), peer.tensors()))
    observation = np.random.default_rng(1).normal(size=(1, 6)).astype(np.float32)
    with torch.no_grad():
        expected = peer(torch.from_numpy(observation[None])).numpy()[0]
    assert session.run(None, {"observation": observation})[0] == pytest.approx(expected, abs=1e-5)


def test_the_memory_may_be_the_only_hidden_layer(peer: Peer) -> None:
    tensors = peer.tensors()
    tensors["action_net.weight"] = torch.randn(MOTORS, UNITS)
    del tensors["mlp_extractor.policy_net.0.weight"], tensors["mlp_extractor.policy_net.0.bias"]
    policy = parse_policy(to_onnx(configuration(peer.kind, hidden=[UNITS]), tensors))
    assert policy.action_count == MOTORS


@pytest.mark.parametrize(
    ("changes", "removed", "message"),
    [
        ({"recurrent": "rnn"}, None, "recurrent is 'rnn', expected none or gru or lstm"),
        ({}, "recurrent.bias_hh_l0", "lacks the tensor 'recurrent.bias_hh_l0'"),
        ({"hidden": [6, HIDDEN]}, None, r"tensor '.*' is float32 \[.*\], expected float32"),
    ],
)
def test_a_checkpoint_that_does_not_fit_is_rejected(
    peer: Peer, changes: dict[str, object], removed: str | None, message: str
) -> None:
    tensors = peer.tensors()
    tensors.pop(removed or "", None)
    with pytest.raises(PolicyError, match=message):
        to_onnx(configuration(peer.kind) | changes, tensors)
