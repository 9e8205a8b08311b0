"""The profile of an image: exact counts by exception, function and address, coverage, and call stacks.

Counts include every executed instruction, also those skipped under a condition.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.board.core.engine import (
    CODE_HALFWORDS,
    FRACTION,
    ITCM_BYTES,
    Engine,
    code_row,
    row_address,
)
from neuroflight.sim.board.core.source_places import Places
from neuroflight.toolchain.contract import FLASH_BASE, FLASH_BYTES
from neuroflight.toolchain.cortex_m7.disassembly import disassemble
from neuroflight.toolchain.errors import BuildError

EXCEPTIONS = 16 + 104
NAMES = {2: "NMI", 3: "HardFault", 4: "MemManage", 5: "BusFault", 6: "UsageFault"}
NAMES |= {11: "SVCall", 14: "PendSV", 15: "SysTick"}
WIDE = 0xE800  # from here on a first halfword has a second one (ARMv7-M A5.1)


@dataclass(frozen=True)
class TaskCount:
    """The cost of one exception's handler, without what interrupted it."""

    exception: int  # 0: the thread
    name: str  # of the exception
    handler: str  # the function behind its vector, if the ELF is known
    activations: int
    instructions: int
    least: int  # of one activation
    most: int
    longest: float  # cycles from entry to return, what interrupted it included
    latest: float  # most cycles from request to entry
    latest_place: str  # what ran then


@dataclass(frozen=True)
class FunctionCount:
    """A function and what was executed in it."""

    name: str
    address: int
    instructions: int
    calls: int  # how often its first instruction was executed
    covered: int  # different instructions that were executed


@dataclass(frozen=True)
class FunctionCoverage:
    """A function of the image and what of it was never executed."""

    name: str
    address: int
    instructions: int  # that it has
    missed: tuple[int, ...]  # their addresses

    @property
    def share(self) -> float:
        """Share of its instructions that were executed, 0 to 1."""
        return 1 - len(self.missed) / self.instructions


def execution_counts(engine: Engine) -> dict[int, int]:
    """Return how often each instruction was executed, by address; the alias of flash counts as flash."""
    enters, leaves = code_counts(engine)
    counts = np.cumsum(enters - leaves)[:-1]  # of each halfword: begins less ends, summed along the addresses
    code = np.frombuffer(engine.memory(0, ITCM_BYTES) + engine.memory(FLASH_BASE, FLASH_BYTES), "<u2")
    found = {}
    end = 0
    for row in map(int, np.flatnonzero(counts)):
        if row < end:
            continue  # the second half of the instruction before
        end = row + (2 if code[row] >= WIDE else 1)
        found[row_address(row)] = int(counts[row])
    return found


def task_counts(engine: Engine) -> tuple[TaskCount, ...]:
    """Return a count for the thread and for every exception that was taken."""
    vectors = engine.load(0xE000ED08, 4)
    counts = {n: engine.library.engine_task(engine.handle, n) for n in range(1, EXCEPTIONS)}
    tasks = [
        _task(engine, number, task, engine.load(vectors + 4 * number, 4) & ~1)
        for number, task in counts.items()
        if task.activations
    ]
    others = sum(task.instructions for task in tasks)
    return (TaskCount(0, "thread", "", 1, engine.instructions - others, 0, 0, 0.0, 0.0, ""), *tasks)


def function_counts(engine: Engine) -> tuple[FunctionCount, ...]:
    """Count every function that was executed, the longest first. Raises BuildError without an ELF."""
    places = engine.places
    if places is None:
        raise BuildError("a profile by functions needs the image's ELF file")
    executed = execution_counts(engine)
    found = [
        FunctionCount(
            name, start, sum(executed[a] for a in addresses), executed.get(start, 0), len(addresses)
        )
        for (start, name), addresses in _by_function(places, executed).items()
    ]
    return tuple(sorted(found, key=lambda one: (-one.instructions, one.address)))


def coverage(engine: Engine) -> tuple[FunctionCoverage, ...]:
    """Return every function of the image, executed or not, by address. Raises BuildError without an ELF."""
    if engine.places is None:
        raise BuildError("coverage needs the image's ELF file")
    executed = execution_counts(engine)
    functions = _by_function(engine.places, disassemble(engine.places.path))
    return tuple(
        FunctionCoverage(name, start, len(addresses), tuple(a for a in addresses if a not in executed))
        for (start, name), addresses in sorted(functions.items())
        if start
    )


def _by_function(places: Places, addresses: Iterable[int]) -> dict[tuple[int, str], list[int]]:
    """Return addresses by start and name of the function that holds them; 0 and "?" where none does."""
    found: dict[tuple[int, str], list[int]] = {}
    for address in addresses:
        symbol = places.function(address)
        found.setdefault((symbol.address, symbol.name) if symbol else (0, "?"), []).append(address)
    return found


def folded_stacks(engine: Engine) -> tuple[str, ...]:
    """Return lines "caller;callee;leaf instructions", the input of flame graph programs.

    Raises BuildError if the engine was not made with `profile` and an ELF.
    """
    if engine.places is None or not engine.profiled:
        raise BuildError("a flame graph needs an engine made with profile and the image's ELF file")
    functions = engine.places.functions
    count = engine.ffi.new("uint32_t *")
    nodes = engine.library.engine_nodes(engine.handle, count)
    paths: list[str] = []
    totals: Counter[str] = Counter()
    for i in range(count[0]):
        node = nodes[i]
        name = functions[node.function - 1].name if node.function else "?"
        parent = paths[node.parent] if i and node.parent else ""
        paths.append(f"{parent};{name}" if parent else name)
        totals[paths[i] if i else "?"] += node.instructions
    return tuple(f"{path} {total}" for path, total in sorted(totals.items()) if total)


def profile_table(engine: Engine, rows: int = 30) -> Iterator[str]:
    """Yield the functions with most instructions, a line each."""
    total = max(engine.instructions, 1)
    yield f"{'function':32} {'instructions':>14} {'share':>7} {'calls':>10}"
    for function in function_counts(engine)[:rows]:
        share = function.instructions / total
        yield f"{function.name:32} {function.instructions:14,} {share:7.1%} {function.calls:10,}"


def _task(engine: Engine, number: int, task: Any, handler: int) -> TaskCount:  # noqa: ANN401 - struct task
    symbol = engine.places.function(handler) if engine.places else None
    return TaskCount(
        number,
        NAMES.get(number, f"IRQ{number - 16}"),
        symbol.name if symbol else f"0x{handler:08X}",
        task.activations,
        task.instructions,
        task.least,
        task.most,
        task.longest / (1 << FRACTION),
        task.latest / (1 << FRACTION),
        engine.place(task.latest_pc) if code_row(task.latest_pc) is not None else "between two handlers",
    )


def code_counts(engine: Engine) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the engine's counts along the halfwords of code: runs that began and that had ended."""
    places = (engine.library.engine_enters(engine.handle), engine.library.engine_leaves(engine.handle))
    enters, leaves = (np.frombuffer(engine.ffi.buffer(p, 8 * (CODE_HALFWORDS + 1)), np.int64) for p in places)
    return enters, leaves
