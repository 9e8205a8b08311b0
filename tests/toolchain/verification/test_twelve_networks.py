"""Twelve networks of every shape and operation: the host's C and the Cortex-M7 give the same bits.

Each goes the way of a user's policy: an ONNX file is read, optimized, compiled, and run on every machine.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from onnx import helper

from neuroflight.toolchain.ir import operations as op
from neuroflight.toolchain.ir.network import OBSERVATION, Network
from neuroflight.toolchain.ir.onnx_export import to_model
from neuroflight.toolchain.verification.inputs import make_inputs
from neuroflight.toolchain.verification.verify import MachineReport, all_candidates, verify
from tests.random_networks import Maker, gru, lstm, norm, perceptron
from tests.sampling import PROVES, sampled

if TYPE_CHECKING:
    from tests.toolchain.conftest import Kit

BLOCKS = {
    3: "rate_error",
    6: "rate_error,rate_error_delta",
    10: "rate_error,rate_error_delta,previous_action",
}
PEERS = ("onnxruntime", "evaluator", "host C, gcc", "Cortex-M7, emulated")
TOLERANCE = 1e-6  # from onnxruntime, at unit scale and in proportion beyond
KINDS = 8  # of observations


def normed() -> Network:
    """Layer norms between linear layers, one behind and one before an activation."""
    make = Maker(6, 8)
    make.linear(48)
    make.add(norm(make, 48))
    make.add(op.Silu())
    make.linear(21)
    make.add(op.Tanh())
    make.add(norm(make, 21))
    return make.clipped()


def branched() -> Network:
    """Two branches from slices, one gating the other; a residual; the observation joined in at the end."""
    make = Maker(10, 9)
    left = make.add(op.Tanh(), make.linear(16, make.add(op.Slice(0, 6), OBSERVATION)))
    right = make.add(op.Sigmoid(), make.linear(16, make.add(op.Slice(9, 5, -2), OBSERVATION)))
    gated = make.add(op.Multiply(), left, right)
    residual = make.add(op.Add(), gated, make.add(op.Elu(1.0), make.linear(16, gated)))
    make.add(op.Concat(), residual, OBSERVATION, right)
    make.linear(24)
    make.add(op.LeakyRelu(0.2))
    return make.clipped()


def gated() -> Network:
    """A GRU on the observation."""
    make = Maker(6, 10)
    make.add(gru(make, 6, 24))
    return make.clipped()


def remembering() -> Network:
    """An LSTM behind a linear layer."""
    make = Maker(6, 11)
    make.linear(20)
    make.add(op.Relu())
    make.add(lstm(make, 20, 17))
    return make.clipped()


def everything() -> Network:
    """Both cells in a row, a norm, the observation past both."""
    make = Maker(6, 12)
    make.linear(32)
    make.add(op.Softsign())
    make.add(gru(make, 32, 16))
    cell = make.add(lstm(make, 16, 8))
    make.add(norm(make, 8), cell)
    make.add(op.Concat(), len(make.nodes), OBSERVATION)
    make.linear(13)
    make.add(op.Clip(-1.0, 1.0))
    return make.clipped()


def smooth() -> Network:
    """Build a network with erf, softplus, an RMS norm, and a softmax that weights two values."""
    make = Maker(6, 13)
    seen = make.add(op.Erf(), make.linear(17))
    soft = make.add(op.Softplus(), make.linear(17, seen))
    shares = make.add(op.Softmax(), make.add(op.Tanh(), make.linear(17, soft)))
    normed = make.add(op.RmsNorm(1e-5, 1 + 0.1 * make.weights(17), make.weights(17)), soft)
    larger = make.add(op.Add(), normed, make.add(op.Affine(np.full(17, -1.0), np.zeros(17)), seen))
    make.add(op.Multiply(), make.add(op.Select(), larger, normed, seen), shares)
    return make.clipped()


NETWORKS: dict[str, Callable[[], Network]] = {
    "6-4": lambda: perceptron(6, seed=1),
    "6-3-4 softsign": lambda: perceptron(6, 3, op.Softsign(), seed=2),
    "6-32-32-4 tanh": lambda: perceptron(6, 32, op.Tanh(), 32, op.Tanh(), seed=3),
    "6-64-64-4 tanh": lambda: perceptron(6, 64, op.Tanh(), 64, op.Tanh(), seed=4),
    "3-128-4 relu": lambda: perceptron(3, 128, op.Relu(), seed=5),
    "10-17-33-9-4 leakyrelu elu silu": lambda: perceptron(
        10, 17, op.LeakyRelu(0.01), 33, op.Elu(0.7), 9, op.Silu(), seed=6
    ),
    "6-128-128-4 sigmoid hardtanh": lambda: perceptron(6, 128, op.Sigmoid(), 128, op.Clip(-1.0, 1.0), seed=7),
    "layer norm": normed,
    "branches": branched,
    "erf softplus softmax, rms norm": smooth,
    "gru": gated,
    "lstm": remembering,
    "gru, lstm, norm, skip": everything,
}
ORDINARY = (
    "6-32-32-4 tanh",
    "10-17-33-9-4 leakyrelu elu silu",
    "branches",
    "erf softplus softmax, rms norm",
    "gru, lstm, norm, skip",
)


def verified(kit: Kit, name: str, directory: Path, count: int, steps: int) -> dict[str, MachineReport]:
    """What each of PEERS made of about `count` observations; fails with the first law that is broken."""
    network = NETWORKS[name]()
    model = to_model(network)
    helper.set_model_props(model, {**kit.chain().metadata, "neuroflight.observation": BLOCKS[network.inputs]})
    data = model.SerializeToString()
    compiled = kit.compiled(data)
    candidates = [c for c in all_candidates(compiled, data, directory, None) if c.name in PEERS]
    seen = verify(compiled, candidates, make_inputs(network.inputs, count // KINDS, 1, steps))
    assert seen.finding is None, seen.finding.message
    assert not seen.missing
    return {machine.name: machine for machine in seen.machines}


def assert_near_onnxruntime(machine: MachineReport) -> None:
    """The project's bar. `verify` has a closer one, but not where rounding itself must do more."""
    for group in machine.figures:
        assert group.compared > 0, group.inputs
        assert group.scaled is not None
        assert group.scaled <= TOLERANCE, group.inputs


@pytest.mark.parametrize("name", sampled(NETWORKS, *ORDINARY))
def test_host_and_cortex_m7_agree_when_networks_are_of_every_kind(
    kit: Kit, tmp_path: Path, name: str
) -> None:
    count, steps = (10_800, 200) if PROVES else (500, 30)
    machine = verified(kit, name, tmp_path, count, steps)["Cortex-M7, emulated"]
    assert machine.count >= (10_000 if PROVES else 400)
    assert_near_onnxruntime(machine)
