"""What a network is lowered to: the table's layout, memory, and what the architecture hash tells apart."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
import pytest

from neuroflight.toolchain.codegen.kernel_calls import Call
from neuroflight.toolchain.codegen.plan import CodePlan, lower
from neuroflight.toolchain.contract import observation_blocks
from neuroflight.toolchain.ir import operations as op
from neuroflight.toolchain.ir.activation_tables import TANH
from neuroflight.toolchain.ir.lanes import LANES
from neuroflight.toolchain.ir.network import Network, Node, chain
from neuroflight.toolchain.policy.model import PolicyModel

if TYPE_CHECKING:
    from tests.toolchain.conftest import Kit

CLIP = op.Clip(0.0, 1.0)
TANH_FLOATS = TANH.rows.size


@pytest.fixture
def policy(kit: Kit) -> PolicyModel:
    """A small policy whose layers need full blocks and a rest."""
    return kit.compiled(kit.mlp((6, 11, 4))).policy


def lowered(policy: PolicyModel, network: Network | None = None) -> CodePlan:
    return lower(policy, network or policy.network)


def linear(outputs: int, inputs: int) -> op.Linear:
    count = np.arange(outputs * inputs, dtype=np.float32)
    return op.Linear(count.reshape(outputs, inputs), -1 - np.arange(outputs, dtype=np.float32))


@pytest.mark.parametrize(
    ("outputs", "blocks"),
    [
        (1, {"linear4": 1}),
        (4, {"linear4": 1}),
        (5, {"linear8": 1}),
        (8, {"linear8": 1}),
        (11, {"linear8": 1, "linear4": 1}),
        (13, {"linear8": 2}),
        (64, {"linear8": 8}),
    ],
)
def test_blocks_cover_every_output_when_the_last_is_not_full(
    policy: PolicyModel, outputs: int, blocks: dict[str, int]
) -> None:
    plan = lowered(policy, chain(6, [linear(outputs, 6), CLIP]))
    assert {call.kernel: call.count for call in plan.calls[1:-1]} == blocks
    assert plan.table.size == sum({"linear8": 8, "linear4": 4}[name] * 7 * n for name, n in blocks.items())


def test_table_holds_biases_then_weights_by_input_when_read_block_by_block(policy: PolicyModel) -> None:
    layer = linear(11, 6)
    table = lowered(policy, chain(6, [layer, CLIP])).table
    eight, four = table[:56].reshape(7, 8), table[56:].reshape(7, 4)
    np.testing.assert_array_equal(eight[0], layer.bias[:8])
    np.testing.assert_array_equal(eight[1:], layer.weight[:8].T)
    np.testing.assert_array_equal(four[:, :3], np.vstack([layer.bias[8:], layer.weight[8:].T]))
    assert not four[:, 3].any()  # an output that nobody has


def test_functions_come_first_and_once_when_several_layers_look_them_up(policy: PolicyModel) -> None:
    plan = lowered(policy, chain(6, [linear(4, 6), op.Tanh(), linear(4, 4), op.Tanh(), CLIP]))
    assert [call.table for call in plan.calls if call.kernel == "look_up"] == [0, 0]
    np.testing.assert_array_equal(plan.table[:TANH_FLOATS], TANH.rows.ravel())
    assert [call.table for call in plan.calls if call.kernel == "linear4"] == [TANH_FLOATS, TANH_FLOATS + 28]


def test_parts_of_the_table_start_on_whole_lanes_when_widths_are_odd(policy: PolicyModel) -> None:
    plan = lowered(policy, chain(3, [linear(7, 3), op.Tanh(), linear(9, 7), op.Relu(), linear(1, 9), CLIP]))
    assert all(call.table % LANES == 0 for call in plan.calls if call.table is not None)
    assert all(place.offset % LANES == 0 for call in plan.calls for place in call.sources)


def deep() -> Network:
    """Values of many widths and lives: the observation is needed at the very end."""
    nodes = [
        Node(linear(40, 6), (0,)),
        Node(op.Tanh(), (1,)),
        Node(linear(9, 40), (2,)),
        Node(op.Relu(), (3,)),
    ]
    nodes += [Node(linear(17, 9), (4,)), Node(op.Slice(1, 9), (5,)), Node(op.Add(), (6, 4))]
    return Network(6, (*nodes, Node(op.Concat(), (7, 0)), Node(linear(4, 15), (8,)), Node(CLIP, (9,))))


def spans(call: Call) -> list[tuple[int, int]]:
    """Floats of the scratch that a call writes, at least."""
    width = {"linear8": 8 * call.count, "linear4": 4}.get(call.kernel, call.count)
    target = call.target
    return [(target.offset, target.offset + width)] if target and target.memory == "scratch" else []


def test_scratch_is_shared_when_values_live_at_different_times(policy: PolicyModel) -> None:
    plan = lowered(policy, deep())
    assert plan.scratch < plan.scratch_unshared
    assert max(end for call in plan.calls for _, end in spans(call)) <= plan.scratch
    lower_bound = 40 + 40  # the widest layer before and after its activation
    assert lower_bound <= plan.scratch <= lower_bound + 8  # and the observation


def test_no_value_is_overwritten_when_it_is_still_needed(policy: PolicyModel) -> None:
    """Plays the calls on a memory that remembers which call wrote each float."""
    calls = lowered(policy, deep()).calls
    writer: dict[int, int] = {}
    reads: dict[int, set[int]] = {}
    for index, call in enumerate(calls):
        for place in call.sources:
            reads.setdefault(index, set()).add(writer[place.offset])
        for begin, end in spans(call):
            writer.update(dict.fromkeys(range(begin, end), index))
    kernels = [call.kernel for call in calls]
    last = kernels.index("add")
    assert {kernels[source] for source in reads[last]} == {"copy", "at_least"}
    copies = [index for index, kernel in enumerate(kernels) if kernel == "copy"]
    assert kernels[reads[copies[-1]].pop()] == "enter"  # the observation, read long after it came in


def cell(kind: type, units: int, inputs: int) -> op.Operation:
    gates = 3 if kind is op.Gru else 4
    arrays = [np.ones((gates * units, width), np.float32) for width in (inputs, units)]
    biases = [np.ones(gates * units, np.float32)] * (2 if kind is op.Gru else 1)
    return kind(*arrays, *biases)  # type: ignore[no-any-return]


@pytest.mark.parametrize(("kind", "floats"), [(op.Gru, 8), (op.Lstm, 16)])
def test_state_has_room_for_whole_lanes_when_a_cell_is_recurrent(
    policy: PolicyModel, kind: type, floats: int
) -> None:
    assert lowered(policy, chain(6, [cell(kind, 5, 6), linear(4, 5), CLIP])).state == floats
    assert lowered(policy).state == 0


def test_calls_in_one_step_do_not_share_places_when_both_are_in_use(policy: PolicyModel) -> None:
    plan = lowered(policy, chain(6, [cell(op.Lstm, 5, 6), linear(4, 5), CLIP]))
    for call in plan.calls:
        sources = [place for place in call.sources if place.memory == "scratch"]
        for one, other in combinations([*sources, *([call.target] if call.target else [])], 2):
            assert one != other or one.memory == "state"


def hash_of(policy: PolicyModel) -> int:
    return lowered(policy).architecture_hash


def test_hash_stays_when_only_weights_differ(kit: Kit) -> None:
    one, two = (kit.compiled(kit.mlp(seed=seed)).policy for seed in (1, 2))
    assert hash_of(one) == hash_of(two)


def edited(policy: PolicyModel, place: slice, *operations: op.Operation) -> PolicyModel:
    kept = [node.operation for node in policy.network.nodes]
    kept[place] = operations
    return replace(policy, network=chain(policy.network.inputs, kept))


CHANGES: dict[str, Callable[[PolicyModel], PolicyModel]] = {
    "rate": lambda p: replace(p, control_rate_hz=2000),
    "filters": lambda p: replace(p, filters=("pt1", 100)),
    "blocks": lambda p: replace(p, blocks=observation_blocks("rate,rate_error")),
    "order": lambda p: replace(p, blocks=tuple(reversed(p.blocks))),
    "activation": lambda p: edited(p, slice(1, 2), op.Clip(-1.0, 1.0)),
    "bounds": lambda p: edited(p, slice(-1, None), op.Clip(0.0, 0.5)),
    "depth": lambda p: edited(p, slice(-1, -1), op.Tanh()),
}


@pytest.mark.parametrize("change", CHANGES)
def test_hash_differs_when_the_code_would(policy: PolicyModel, change: str) -> None:
    assert hash_of(CHANGES[change](policy)) != hash_of(policy)
