"""Executed runs of code become basic blocks, and blocks become instructions and cycles."""

from __future__ import annotations

import pytest

from neuroflight.toolchain.cortex_m7.cycles import Route, RouteCost, route_costs, route_of
from neuroflight.toolchain.cortex_m7.disassembly import Instruction
from neuroflight.toolchain.cortex_m7.llvm_mca import block_cycles, find_pricer
from neuroflight.toolchain.errors import BuildError

# start: two instructions; loop: three, the last a branch back to it; end: two.
TEXTS = (
    ("movs", "r0, #9"),
    ("movs", "r1, #0"),
    ("adds", "r1, #1"),
    ("subs", "r0, #1"),
    ("bne.n", "4"),
    ("mov", "r0, r1"),
    ("bx", "lr"),
)
CODE = {
    2 * i: Instruction(2 * i, 2, *text, condition="", function="f", line="") for i, text in enumerate(TEXTS)
}


def loop(times: int) -> Route:
    """The route of `times` rounds, as an emulator sees it: the first round runs on from the start."""
    return route_of([(0, 10), *[(4, 6)] * (times - 1), (10, 4)])


def shape(cost: RouteCost) -> list[tuple[int, int, int]]:
    return [(block.instructions[0].address, len(block.instructions), block.times) for block in cost.blocks]


def test_blocks_end_at_branches_and_where_counts_change_when_a_loop_runs() -> None:
    (cost,) = route_costs([loop(9)], CODE, price=False)
    assert shape(cost) == [(0, 2, 1), (4, 3, 9), (10, 2, 1)]
    assert cost.instructions == 2 + 27 + 2
    assert cost.cycles is None


def test_blocks_are_the_same_for_all_routes_when_one_shows_a_cut() -> None:
    once, often = route_costs([loop(1), loop(9)], CODE, price=False)
    assert shape(once) == [(0, 2, 1), (4, 3, 1), (10, 2, 1)]
    assert often.instructions - once.instructions == 8 * 3
    (alone,) = route_costs([loop(1)], CODE, price=False)
    assert shape(alone) == [(0, 5, 1), (10, 2, 1)]


def test_blocks_ignore_it_when_the_emulator_cut_elsewhere() -> None:
    cut = route_of([(0, 6), (6, 4), *[(4, 2), (6, 4)] * 8, (10, 2), (12, 2)])
    (cost,) = route_costs([cut], CODE, price=False)
    assert shape(cost) == [(0, 2, 1), (4, 3, 9), (10, 2, 1)]


def test_route_is_the_same_when_runs_come_in_another_order() -> None:
    assert route_of([(0, 4), (4, 6), (4, 6)]) == route_of([(4, 6), (0, 4), (4, 6)])
    assert loop(2) != loop(3)


def test_skipped_instructions_count_when_they_stand_in_an_executed_run() -> None:
    code = {
        0: Instruction(0, 2, "it", "ne", "", "f", ""),
        2: Instruction(2, 2, "movne", "r0, #1", "ne", "f", ""),
        4: Instruction(4, 2, "bx", "lr", "", "f", ""),
    }
    (cost,) = route_costs([route_of([(0, 6)])], code, price=False)
    assert (cost.instructions, cost.conditional) == (3, 1)


def test_executed_data_is_refused_when_the_disassembly_has_none() -> None:
    with pytest.raises(BuildError, match="code at 0x0000000E was executed"):
        route_costs([route_of([(10, 6)])], CODE, price=False)


@pytest.mark.skipif(find_pricer() is None, reason="llvm-mca is not installed")
def test_cycles_are_the_blocks_prices_times_their_counts_when_priced() -> None:
    instructions = list(CODE.values())
    start, body, end = block_cycles([instructions[:2], instructions[2:5], instructions[5:]])
    few, many = route_costs([loop(1), loop(9)], CODE, price=True)
    assert few.cycles == start + body + end
    assert many.cycles == start + 9 * body + end
