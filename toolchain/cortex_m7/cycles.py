"""The cost of a function on the Cortex-M7: instructions, exactly; cycles, as predicted.

An emulated core says which runs of code a call executes and how often, the disassembly which instructions
stand in them. Runs are cut into basic blocks by two rules that need no knowledge of the program: a block
ends after a branch, and wherever the number of executions changes. The cost of a call is then a sum over
blocks, so that calls which took the same route cost the same.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from neuroflight.toolchain.cortex_m7.disassembly import Instruction
from neuroflight.toolchain.cortex_m7.llvm_mca import PricingError, block_cycles, pricer_version
from neuroflight.toolchain.errors import BuildError

CORE_HZ = 216_000_000  # of the MATEKF722: firmware/hal/stm32f7/core/clock.h
# llvm-mca knows memory without a wait. A register of a peripheral lies behind bridges, the slower of them at
# half or a quarter of the core's clock: so much more for each access, and for each barrier, is assumed.
DEVICE_CYCLES = 12
BARRIERS = ("dsb", "isb")

Route = frozenset[tuple[tuple[int, int], int]]  # ((address, size) of a run of code, times executed)


@dataclass(frozen=True)
class BlockCost:
    """A basic block in one call."""

    instructions: tuple[Instruction, ...]
    times: int  # executed
    cycles: float | None  # of one execution, the branch included; None: no price

    @property
    def total_instructions(self) -> int:
        """Instructions of all executions."""
        return self.times * len(self.instructions)

    @property
    def total_cycles(self) -> float | None:
        """Predicted cycles of all executions."""
        return None if self.cycles is None else self.times * self.cycles


@dataclass(frozen=True)
class RouteCost:
    """The cost of one route through a function, block by block in order of addresses."""

    blocks: tuple[BlockCost, ...]

    @property
    def instructions(self) -> int:
        """Executed, those skipped under a condition included."""
        return sum(block.total_instructions for block in self.blocks)

    @property
    def conditional(self) -> int:
        """Executed instructions that could have been skipped in their place."""
        return sum(block.times * sum(i.is_conditional for i in block.instructions) for block in self.blocks)

    @property
    def cycles(self) -> float | None:
        """Predicted; None without prices."""
        totals = [block.total_cycles for block in self.blocks]
        return None if None in totals else sum(total for total in totals if total is not None)

    @property
    def barriers(self) -> int:
        """Executed instructions that wait for memory."""
        return sum(
            block.times * sum(i.operation in BARRIERS for i in block.instructions) for block in self.blocks
        )

    def cycles_with_devices(self, accesses: int) -> float | None:
        """Predict the cycles, with those for `accesses` to peripherals' registers and for barriers."""
        return None if self.cycles is None else self.cycles + DEVICE_CYCLES * (accesses + self.barriers)


@dataclass(frozen=True)
class Priced:
    """The costs of routes, in cycles as well if there is a model."""

    costs: tuple[RouteCost, ...]
    pricer: str  # which model priced cycles; "" for none
    no_cycles_reason: str | None  # why there are none


def route_of(runs: Iterable[tuple[int, int]]) -> Route:
    """Return the route of a call from the runs of code it executed (`CortexM7.recording`)."""
    return frozenset(Counter(runs).items())


def route_costs(routes: Sequence[Route], code: Mapping[int, Instruction], *, price: bool) -> list[RouteCost]:
    """Compute the cost of each route. `code`: the program's disassembly.

    price: predict cycles; llvm-mca runs once, for the blocks of all routes. Raises PricingError then, and
    BuildError if executed code is not in the disassembly.
    """
    executed = [_executed(route, code) for route in routes]
    blocks = _blocks(executed, code)
    cycles: Sequence[float | None] = block_cycles(blocks) if price else [None] * len(blocks)
    return [
        RouteCost(
            tuple(
                BlockCost(block, counts[block[0].address], cost)
                for block, cost in zip(blocks, cycles, strict=True)
                if counts[block[0].address]
            )
        )
        for counts in executed
    ]


def price_routes(routes: Sequence[Route], code: Mapping[int, Instruction]) -> Priced:
    """Compute the cost of each route, without cycles if llvm-mca is missing or lacks an instruction.

    Raises BuildError if executed code is not in the disassembly.
    """
    try:
        pricer = pricer_version()
        return Priced(tuple(route_costs(routes, code, price=True)), pricer, None)
    except PricingError as error:
        return Priced(tuple(route_costs(routes, code, price=False)), "", str(error))


def _executed(route: Route, code: Mapping[int, Instruction]) -> Counter[int]:
    """Count the executions of each instruction, by address."""
    counts: Counter[int] = Counter()
    for (start, size), times in route:
        address = start
        while address < start + size:
            if address not in code:
                raise BuildError(f"code at 0x{address:08X} was executed, but is none to the disassembler")
            counts[address] += times
            address += code[address].size
    return counts


def _blocks(
    executed: Sequence[Counter[int]], code: Mapping[int, Instruction]
) -> list[tuple[Instruction, ...]]:
    """Split all executed code into basic blocks.

    Code that does not branch runs on, so the count can only grow from one instruction to the next within a
    route; if the sum over all routes is level, it is level in each.
    """
    total: Counter[int] = Counter()
    for counts in executed:
        total.update(counts)
    blocks: list[list[Instruction]] = []
    last: Instruction | None = None
    for address in sorted(total):
        goes_on = (
            last is not None
            and not last.is_branch
            and last.address + last.size == address
            and total[last.address] == total[address]
        )
        if not goes_on:
            blocks.append([])
        last = code[address]
        blocks[-1].append(last)
    return [tuple(block) for block in blocks]
