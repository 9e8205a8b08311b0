"""The check of a pass: it finds what a pass could do wrong, and tolerates float32's rounding."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from neuroflight.toolchain.ir import operations as op
from neuroflight.toolchain.ir.network import Network, chain
from neuroflight.toolchain.passes.equivalence import (
    BOUND,
    MAGNITUDES,
    ROWS,
    Equivalence,
    EquivalenceError,
    check_equivalence,
)

CLIP = op.Clip(0.0, 1.0)


def array(*shape: int, seed: int = 0) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    return (0.4 * np.random.default_rng(seed).normal(size=shape)).astype(np.float32)


def linear(outputs: int, inputs: int, size: float = 1.0, seed: int = 0) -> op.Linear:
    weight = (size * array(outputs, inputs, seed=seed)).astype(np.float32)
    return op.Linear(weight, array(outputs, seed=seed + 1) + np.float32(0.5))


def turned(layer: op.Linear) -> op.Linear:
    """Two of its inputs change places."""
    order = [1, 0, *range(2, layer.inputs)]
    return op.Linear(layer.weight[:, order].copy(), layer.bias)


GRU = op.Gru(array(9, 6), array(9, 3, seed=1), array(9, seed=2), array(9, seed=3))
LSTM = op.Lstm(array(12, 6), array(12, 3, seed=1), array(12, seed=2))
HIDDEN, LAST = linear(8, 6), linear(4, 8)

# what a wrong pass leaves of (HIDDEN, Tanh(), LAST, CLIP)
WRONG: dict[str, tuple[op.Operation, ...]] = {
    "a weight is off by 1e-4": (
        HIDDEN,
        op.Tanh(),
        replace(LAST, weight=LAST.weight + np.float32(1e-4) * (LAST.weight == LAST.weight.max())),
        CLIP,
    ),
    "a bias is lost": (HIDDEN, op.Tanh(), replace(LAST, bias=0 * LAST.bias), CLIP),
    "inputs change places": (HIDDEN, op.Tanh(), turned(LAST), CLIP),
    "another activation": (HIDDEN, op.Softsign(), LAST, CLIP),
    "half a sigmoid": (HIDDEN, op.Sigmoid(), LAST, CLIP),
    "a bound too many": (HIDDEN, op.Tanh(), LAST, op.Clip(0.0, 0.75), CLIP),
    "a bound that only binds in a turn": (op.Clip(-100.0, None), HIDDEN, op.Tanh(), LAST, CLIP),
}


@pytest.mark.parametrize("name", WRONG)
def test_pass_is_caught_when(name: str) -> None:
    before = chain(6, (HIDDEN, op.Tanh(), LAST, CLIP))
    with pytest.raises(EquivalenceError, match=r"a test changes an action by .* expected at most"):
        check_equivalence(before, chain(6, WRONG[name]), "a test")


@pytest.mark.parametrize(
    ("cell", "wrong"),
    [
        (GRU, replace(GRU, state_weight=GRU.state_weight[::-1].copy())),
        (LSTM, replace(LSTM, state_weight=0 * LSTM.state_weight)),
    ],
    ids=["gru", "lstm"],
)
def test_pass_is_caught_when_only_later_steps_show_it(cell: op.Operation, wrong: op.Operation) -> None:
    last = linear(4, 3)
    with pytest.raises(EquivalenceError):
        check_equivalence(chain(6, (cell, last, CLIP)), chain(6, (wrong, last, CLIP)), "a test")
    assert check_equivalence(chain(6, (cell, last, CLIP)), chain(6, (cell, last, CLIP)), "a test").unit == 0


def test_pass_is_caught_when_it_errs_beyond_the_gyros_range_only() -> None:
    before = chain(6, (linear(4, 6, size=1e-4), CLIP))
    after = chain(6, (op.Clip(-1000.0, 1000.0), linear(4, 6, size=1e-4), CLIP))
    with pytest.raises(EquivalenceError, match="at magnitude 3000"):
        check_equivalence(before, after, "a test")


def folded(count: int, make: Callable[[int], tuple[op.Operation, ...]]) -> Network:
    return chain(
        6, [operation for index in range(count) for operation in make(index)] + [op.Slice(0, 4), CLIP]
    )


def test_rounding_is_no_fault_when_weights_are_large() -> None:
    scale = op.Affine(np.full(6, 1 / 3), np.full(6, 0.1))

    def layers(index: int) -> tuple[op.Operation, ...]:
        return scale, linear(6, 6, size=60, seed=index), op.Tanh()

    def merged(index: int) -> tuple[op.Operation, ...]:
        layer = linear(6, 6, size=60, seed=index)
        bias = layer.weight.astype(float) @ scale.offset + layer.bias
        return op.Linear((layer.weight * scale.scale).astype(np.float32), bias.astype(np.float32)), op.Tanh()

    proof = check_equivalence(folded(4, layers), folded(4, merged), "a test")
    assert proof.unit > BOUND


def test_observation_is_not_compared_when_a_value_overflows() -> None:
    large = op.Affine(np.full(6, 1e20), np.zeros(6))
    small = op.Affine(np.full(6, 1e-20), np.zeros(6))
    before, after = (
        chain(6, (large, small, HIDDEN, op.Tanh(), LAST, CLIP)),
        chain(6, (HIDDEN, op.Tanh(), LAST, CLIP)),
    )
    proof = check_equivalence(before, after, "a test")
    overflowing = sum(magnitude * 1e20 > 3.4e38 for magnitude in MAGNITUDES)
    assert 0 < proof.overflowing <= overflowing * ROWS
    assert check_equivalence(after, after, "a test").overflowing < proof.overflowing


def test_layer_norm_is_equal_to_itself_when_its_input_is_shifted() -> None:
    norm = op.LayerNorm(1e-5, array(8), array(8, seed=1))
    shifted = op.Linear(HIDDEN.weight, HIDDEN.bias + np.float32(0.25))
    proof = check_equivalence(
        chain(6, (HIDDEN, norm, LAST, CLIP)), chain(6, (shifted, norm, LAST, CLIP)), "a test"
    )
    assert 0 < proof.unit < BOUND


def test_worst_of_two_proofs_is_kept_when_a_pass_runs_twice() -> None:
    one, other = Equivalence(10, 1e-7, 3e-8, 0), Equivalence(20, 2e-7, 1e-8, 4)
    assert one.worst(other) == Equivalence(30, 2e-7, 3e-8, 4)
