"""The table's layout and what the architecture hash tells apart."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from toolchain.contract import observation_blocks
from toolchain.graph import chain
from toolchain.network import PolicyModel
from toolchain.operations import Clip, Linear, Operation, Tanh
from toolchain.plan import Blocks, lower

if TYPE_CHECKING:
    from tests.toolchain.conftest import Kit


@pytest.fixture
def policy(kit: Kit) -> PolicyModel:
    """A small policy whose layers need full blocks, a rest and padding."""
    return kit.compiled(kit.mlp((6, 11, 4))).policy


def test_blocks_cover_every_output_when_the_last_is_not_full(policy: PolicyModel) -> None:
    plan = lower(policy, policy.network)
    assert plan.steps[0].blocks == (Blocks(0, 8, 1), Blocks(8, 3, 1))
    assert plan.steps[1].blocks == (Blocks(0, 4, 1),)


def test_table_holds_biases_then_weights_by_input_when_read_block_by_block(policy: PolicyModel) -> None:
    first = policy.network.nodes[0].operation
    assert isinstance(first, Linear)
    table = lower(policy, policy.network).table
    np.testing.assert_array_equal(table[:8], first.bias[:8])
    np.testing.assert_array_equal(table[8:56].reshape(6, 8), first.weight[:8].T)
    np.testing.assert_array_equal(table[56:59], first.bias[8:])
    np.testing.assert_array_equal(table[59:77].reshape(6, 3), first.weight[8:].T)


def test_blocks_start_on_even_words_when_one_has_an_odd_size(policy: PolicyModel) -> None:
    plan = lower(policy, policy.network)
    assert plan.table[77] == 0  # 56 + 7 x 3 is odd: one word of padding
    assert plan.steps[1].offset == 78
    assert plan.table.size == 78 + 4 * 12


def hash_of(policy: PolicyModel) -> int:
    return lower(policy, policy.network).architecture_hash


def test_hash_stays_when_only_weights_differ(kit: Kit) -> None:
    one, two = (kit.compiled(kit.mlp(seed=seed)).policy for seed in (1, 2))
    assert hash_of(one) == hash_of(two)


def edited(policy: PolicyModel, place: slice, *operations: Operation) -> PolicyModel:
    kept = [node.operation for node in policy.network.nodes]
    kept[place] = operations
    return replace(policy, network=chain(policy.network.inputs, kept))


CHANGES: dict[str, Callable[[PolicyModel], PolicyModel]] = {
    "rate": lambda p: replace(p, control_rate_hz=2000),
    "filters": lambda p: replace(p, filters=("pt1", 100)),
    "blocks": lambda p: replace(p, blocks=observation_blocks("rate,rate_error")),
    "order": lambda p: replace(p, blocks=tuple(reversed(p.blocks))),
    "activation": lambda p: edited(p, slice(1, 2), Clip(-1.0, 1.0)),
    "bounds": lambda p: edited(p, slice(-1, None), Clip(0.0, 0.5)),
    "depth": lambda p: edited(p, slice(-1, -1), Tanh()),
}


@pytest.mark.parametrize("change", CHANGES)
def test_hash_differs_when_the_code_would(policy: PolicyModel, change: str) -> None:
    assert hash_of(CHANGES[change](policy)) != hash_of(policy)
