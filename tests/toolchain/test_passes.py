"""Each rewrite of the optimizer: what it leaves, what it counts, and that the values stay."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from toolchain.errors import PolicyError
from toolchain.evaluate import evaluate
from toolchain.graph import Network, chain
from toolchain.operations import Affine, Clip, Linear, Operation, Tanh
from toolchain.passes import Saving, optimize

DOOR = Clip(0.0, 1.0)


def linear(outputs: int, inputs: int, seed: int = 0) -> Linear:
    rng = np.random.default_rng(seed)
    weight, bias = rng.normal(size=(outputs, inputs)), rng.normal(size=outputs)
    return Linear((0.3 * weight).astype(np.float32), (0.3 * bias).astype(np.float32))


def affine(count: int, seed: int = 0) -> Affine:
    rng = np.random.default_rng(seed)
    return Affine(rng.normal(size=count), rng.normal(size=count))


def actions(network: Network) -> NDArray[np.float32]:
    observation = np.random.default_rng(9).normal(size=(300, network.inputs)).astype(np.float32)
    return evaluate(network, observation)


def operations_of(network: Network) -> tuple[Operation, ...]:
    return tuple(node.operation for node in network.nodes)


def kinds_of(network: Network) -> list[type]:
    return [type(operation) for operation in operations_of(network)]


CASES: dict[str, tuple[tuple[Operation, ...], list[type], Saving]] = {
    "affine before linear": (
        (affine(6), linear(4, 6), DOOR),
        [Linear, Clip],
        Saving("fold affine map into linear layer", 1, 6, 48),
    ),
    "affine after linear": (
        (linear(4, 6), affine(4), DOOR),
        [Linear, Clip],
        Saving("fold affine map into linear layer", 1, 4, 32),
    ),
    "two affine maps": (
        (Tanh(), affine(6), affine(6, 1), DOOR),
        [Tanh, Affine, Clip],
        Saving("merge affine maps", 1, 6, 48),
    ),
    "two linear layers": (
        (linear(20, 6), linear(4, 20), DOOR),
        [Linear, Clip],
        Saving("merge linear layers", 1, 20 * 6 + 4 * 20 - 4 * 6, 4 * (20 * 7 + 4 * 21 - 4 * 7)),
    ),
    "identity": (
        (Tanh(), Affine(np.ones(6), np.zeros(6)), DOOR),
        [Tanh, Clip],
        Saving("drop identity", 1, 6, 48),
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_layers_are_joined_when_nothing_lies_between(name: str) -> None:
    operations, kinds, saving = CASES[name]
    network = chain(6, operations)
    shorter, savings = optimize(network)
    assert kinds_of(shorter) == kinds
    assert savings == (saving,)
    np.testing.assert_allclose(actions(shorter), actions(network), rtol=0, atol=1e-6)


def test_linear_layers_stay_apart_when_their_product_costs_more() -> None:
    layers = (linear(1, 30), linear(30, 1), DOOR)
    shorter, savings = optimize(chain(30, layers))
    assert operations_of(shorter) == layers
    assert not savings


def test_layers_stay_apart_when_an_activation_lies_between() -> None:
    layers = (linear(8, 6), Tanh(), linear(4, 8), DOOR)
    shorter, savings = optimize(chain(6, layers))
    assert operations_of(shorter) == layers
    assert not savings


def test_long_chain_becomes_one_layer_when_all_of_it_is_affine() -> None:
    layers = (affine(6), linear(9, 6), affine(9), affine(9, 3), linear(4, 9), affine(4), DOOR)
    network = chain(6, layers)
    shorter, _ = optimize(network)
    assert kinds_of(shorter) == [Linear, Clip]
    np.testing.assert_allclose(actions(shorter), actions(network), rtol=0, atol=1e-5)


def test_policy_is_refused_when_folding_leaves_float32() -> None:
    layers = (
        Affine(np.full(6, 1e30), np.zeros(6)),
        Affine(np.full(6, 1e30), np.zeros(6)),
        linear(4, 6),
        DOOR,
    )
    with pytest.raises(PolicyError, match="expected values of float32's range"):
        optimize(chain(6, layers))
