"""The cost of control tasks on the emulated board in flight: each run, to the instruction.

The core is stopped where the handler of the gyro's samples begins and ends, and where the controller in it
does. What it executed in between is the difference of the engine's counts of executed code, without what
interrupted it. A stop takes no time of the board: the flight is the same with a meter and without.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.board.board import Board
from neuroflight.sim.board.core.engine import CODE_HALFWORDS, Outcome, code_row, row_address
from neuroflight.sim.board.debug.profile import code_counts, task_counts
from neuroflight.sim.board.debug.variables import Variable, read_variables
from neuroflight.toolchain.contract import Task
from neuroflight.toolchain.cortex_m7.cycles import Priced, Route, RouteCost, price_routes
from neuroflight.toolchain.cortex_m7.disassembly import Instruction
from neuroflight.toolchain.errors import BuildError

HANDLER = "gyro_sample_handler"  # from the gyro's bytes in memory to the motors' frame
EDGE_HANDLER = "gyro_edge_handler"  # before it: starts the chip's read
CONTROLLERS = {"policy_step": "policy", "pid_step": "pid"}  # which of them a step asked, by its function
VTOR, VECTORS = 0xE000ED08, 16 + 104
STACKED_PC = 0x18  # in an exception's frame (ARMv7-M B1.5.6)
GAP = 0x400  # bytes without an instruction that part two pieces of code

Counts = NDArray[np.int64]


class Work(Enum):
    """Pieces of work that are measured."""

    ALGORITHM = "control algorithm"  # the controller's own function
    TASK = "control task"  # the handler's run that is a control step
    SAMPLE = "gyro sample between"  # one that is none


@dataclass(frozen=True)
class Kind:
    """The kinds of runs that are counted apart."""

    work: Work
    armed: bool  # after it; of an algorithm True: it is only asked where the motors may turn
    controller: str  # that was asked in it, of CONTROLLERS' values; "" for none


@dataclass(frozen=True)
class Run:
    """The code executed by one run, with the number of equal runs."""

    route: Route
    accesses: int  # to registers of peripherals
    times: int


@dataclass(frozen=True)
class TaskCost:
    """The cost of all runs of one kind."""

    kind: Kind
    times: int
    routes: int  # distinct ones
    instructions: tuple[int, int]  # fewest and most
    cycles: tuple[float, float] | None  # likewise, predicted, with accesses of devices; None without a model
    accesses: tuple[int, int]  # to registers of peripherals, fewest and most
    spread: tuple[tuple[float, int], ...] = ()  # cycles (no model: instructions), and how many runs took them

    @property
    def variability(self) -> float:
        """(worst - best) / worst, of cycles where there are some (Koch 2019, ch. 4)."""
        best, worst = self.cycles or self.instructions
        return (worst - best) / worst


@dataclass(frozen=True)
class Metered:
    """The results of a meter in a flight."""

    runs: Mapping[Kind, tuple[Run, ...]]
    interruptions: int  # of what is measured, by other handlers
    interrupting: int  # instructions of theirs
    edge: tuple[int, int]  # fewest and most instructions of a run of EDGE_HANDLER
    missed: int  # deadlines of control steps since boot, as the firmware counts them


@dataclass
class _Call:
    """A function that has begun and not yet ended."""

    name: str  # "" for a handler that interrupted what is measured
    return_to: int
    depth: int  # of active exceptions
    counts: Counts
    instructions: int
    accesses: int
    steps: int = 0  # control steps before it
    controller: str = ""


class _Key(NamedTuple):
    """The properties that distinguish two runs."""

    places: bytes  # in `_Code.rows` at which the number of executions changes
    changes: bytes
    instructions: int
    accesses: int


class ControlMeter:
    """A meter that runs a board and records what its control tasks execute."""

    def __init__(self, board: Board, elf: Path, code: Mapping[int, Instruction]) -> None:
        """elf: of the image on `board`. code: its disassembly.

        Raises BuildError when `elf` lacks the functions and variables that are looked for.
        """
        self._board, self._engine, self._elf = board, board.engine, elf
        for name in (HANDLER, *CONTROLLERS):
            if name not in board.symbols:
                raise BuildError(f"{elf}: has no function {name}; build it with `make firmware`")
        self._steps, self._armed = read_variables(
            elf, "firmware.control_steps", "firmware.status.trace.armed"
        )
        self._handler = board.symbols[HANDLER] & ~1
        self._controllers = {board.symbols[name] & ~1: name for name in CONTROLLERS}
        self._handlers: frozenset[int] = frozenset()  # of all exceptions
        self._code = _Code(code)
        self._enters, self._leaves = code_counts(self._engine)
        self._open: list[_Call] = []
        self._runs: dict[Kind, Counter[_Key]] = {}
        self.interruptions = self.interrupting = 0
        self._watch()

    def run_to(self, cycle: int) -> None:
        """Run until `cycle`, as `Board.run_to`. Raises BoardError."""
        while (outcome := self._engine.run(cycle)) is not Outcome.REACHED:
            if outcome is Outcome.BREAKPOINT:
                self._stop()
            else:
                self._open.clear()
                self._handlers = frozenset()
            self._watch()

    def metered(self) -> Metered:
        """Return all results. Raises BuildError as `runs` does, and if EDGE_HANDLER never ran."""
        for task in task_counts(self._engine):
            if task.handler == EDGE_HANDLER:
                edge = (task.least, task.most)
                missed = missed_deadlines(self._board, self._elf)
                return Metered(self.runs(), self.interruptions, self.interrupting, edge, missed)
        raise BuildError(f"the image never ran {EDGE_HANDLER}")

    def runs(self) -> dict[Kind, tuple[Run, ...]]:
        """Return all runs measured so far. Raises BuildError if code ran that is not in the ELF."""
        return {
            kind: tuple(Run(self._route(key), key.accesses, times) for key, times in counted.items())
            for kind, counted in self._runs.items()
        }

    # ---- stops ----

    def _stop(self) -> None:
        engine = self._engine
        pc, depth = engine.pc, engine.depth
        if not self._handlers:  # the image has put its vectors in their place by now
            self._handlers = self._read_vectors()
        # A handler is over when its exception is, also where another follows without a return in between.
        while self._open and (
            depth < self._open[-1].depth
            or (depth == self._open[-1].depth and pc in (self._open[-1].return_to, *self._handlers))
        ):
            self._close(self._open.pop())
        if pc in self._handlers:
            if pc == self._handler or self._open:
                stacked = engine.memory(engine.register(13) + STACKED_PC, 4)
                name = HANDLER if pc == self._handler else ""
                self._begin(name, int.from_bytes(stacked, "little"), depth)
        elif pc in self._controllers and self._open and self._open[-1].name == HANDLER:
            self._open[-1].controller = CONTROLLERS[self._controllers[pc]]
            self._begin(self._controllers[pc], engine.register(14) & ~1, depth)

    def _read_vectors(self) -> frozenset[int]:
        table = self._engine.load(VTOR, 4)
        vectors = np.frombuffer(self._engine.memory(table, 4 * VECTORS), "<u4")[1:]
        return frozenset((vectors[vectors != 0] & ~np.uint32(1)).tolist())

    def _watch(self) -> None:
        """Set the next stops: where open calls may end, and where measured ones may begin."""
        stops = {self._handler}
        if self._open:
            stops |= {*self._handlers, self._open[-1].return_to}
        if self._open and self._open[-1].name == HANDLER:
            stops |= set(self._controllers)
        self._engine.set_breakpoints(stops)
        self._engine.skip_breakpoint()

    def _begin(self, name: str, return_to: int, depth: int) -> None:
        self._open.append(_Call(name, return_to, depth, *self._now(), self._read_steps()))

    def _close(self, call: _Call) -> None:
        counts, instructions, accesses = self._now()
        counts -= call.counts
        instructions, accesses = instructions - call.instructions, accesses - call.accesses
        if not call.name:
            self.interruptions += 1
            self.interrupting += instructions
            for outer in self._open:  # as if the interruption had not happened
                outer.counts = outer.counts + counts
                outer.instructions += instructions
                outer.accesses += accesses
            return
        if call.name in CONTROLLERS:
            kind = Kind(Work.ALGORITHM, True, CONTROLLERS[call.name])
        else:
            work = Work.SAMPLE if self._read_steps() == call.steps else Work.TASK
            kind = Kind(work, bool(self._read(self._armed)), call.controller)
        places = np.flatnonzero(counts)
        key = _Key(places.tobytes(), counts[places].tobytes(), instructions, accesses)
        self._runs.setdefault(kind, Counter())[key] += 1

    def _now(self) -> tuple[Counts, int, int]:
        """Return changes of execution counts along the code, instructions and accesses to devices so far."""
        self._engine.library.engine_enters(self._engine.handle)  # adds the counts of blocks in use
        counts = self._code.pick(self._enters, self._leaves)
        return counts, self._engine.instructions, self._engine.accesses

    def _read_steps(self) -> int:
        return self._read(self._steps)

    def _read(self, variable: Variable) -> int:
        return int.from_bytes(self._engine.memory(variable.address, variable.size), "little")

    def _route(self, key: _Key) -> Route:
        route = frozenset(self._code.runs(*(np.frombuffer(part, np.int64) for part in key[:2])))
        counted = sum(times * self._code.instructions(start, size) for (start, size), times in route)
        if counted != key.instructions:
            raise BuildError(
                f"a control task executed {key.instructions} instructions, {counted} of them in the ELF "
                f"file: is it this image's?"
            )
        return route


class _Code:
    """The places of the image's instructions in the engine's rows of counts."""

    def __init__(self, instructions: Mapping[int, Instruction]) -> None:
        self._starts = np.zeros(CODE_HALFWORDS + 2, np.int64)
        ends: list[tuple[int, int]] = []
        for instruction in instructions.values():
            row = code_row(instruction.address)
            if row is None:
                continue
            self._starts[row + 1] = 1
            end = row + instruction.size // 2
            if ends and 0 <= row - ends[-1][1] <= GAP // 2:
                ends[-1] = (ends[-1][0], end)
            else:
                ends.append((row, end))
        self._starts = np.cumsum(self._starts)
        # One row more than each piece has: it ends there.
        self._pieces = [slice(first, end + 1) for first, end in ends]
        self.rows = np.concatenate([np.arange(piece.start, piece.stop) for piece in self._pieces])

    def pick(self, enters: Counts, leaves: Counts) -> Counts:
        """Subtract ends from begins of executed code, in the rows with instructions."""
        return np.concatenate([enters[piece] - leaves[piece] for piece in self._pieces])

    def instructions(self, start: int, size: int) -> int:
        """Count the instructions in `size` bytes at `start`."""
        row = code_row(start)
        assert row is not None
        return int(self._starts[row + size // 2] - self._starts[row])

    def runs(self, places: NDArray[np.int64], changes: Counts) -> Iterator[tuple[tuple[int, int], int]]:
        """Yield runs of code and how often each was executed."""
        times = 0
        for place, after, change in zip(places, (*places[1:], places[-1]), changes, strict=True):
            times += int(change)
            if times:
                first, end = int(self.rows[place]), int(self.rows[after])
                yield (row_address(first), 2 * (end - first)), times


def missed_deadlines(board: Board, elf: Path) -> int:
    """Read the number of control steps since boot that missed their deadline, as the firmware of `elf` counts
    them.

    A step whose gyro samples were lost counts too. Raises BuildError where the ELF has no such count.
    """
    (stats,) = read_variables(elf, "stats")
    tasks = np.frombuffer(board.engine.memory(stats.address, stats.size), stats.dtype.base)
    return int(tasks[Task.CONTROL]["misses"])


def task_costs(
    runs: Mapping[Kind, Sequence[Run]], code: Mapping[int, Instruction]
) -> tuple[tuple[TaskCost, ...], Priced]:
    """Compute the cost of each kind of run, and the prices behind it. code: the image's disassembly."""
    routes = list(dict.fromkeys(run.route for found in runs.values() for run in found))
    priced = price_routes(routes, code)
    costs = dict(zip(routes, priced.costs, strict=True))
    return tuple(_task_cost(kind, found, costs) for kind, found in runs.items()), priced


def _task_cost(kind: Kind, runs: Sequence[Run], costs: Mapping[Route, RouteCost]) -> TaskCost:
    instructions = [costs[run.route].instructions for run in runs]
    accesses = [run.accesses for run in runs]
    taken = [costs[run.route].cycles_with_devices(run.accesses) for run in runs]
    cycles = [one for one in taken if one is not None]
    spread: Counter[float] = Counter()
    for one, run in zip(cycles or instructions, runs, strict=True):
        spread[float(one)] += run.times
    return TaskCost(
        kind,
        times=sum(run.times for run in runs),
        routes=len({run.route for run in runs}),
        instructions=(min(instructions), max(instructions)),
        cycles=(min(cycles), max(cycles)) if cycles else None,
        accesses=(min(accesses), max(accesses)),
        spread=tuple(sorted(spread.items())),
    )
