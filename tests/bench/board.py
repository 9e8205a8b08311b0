"""How fast the emulated board flies, in multiples of real time, and which parts take the time.

The image of a policy is built, and flown by `fly` on the emulated board with its twin, first with nothing but
a clock before and after, then once more with a stopwatch at every border between the parts. What the port was
given in that flight is given to a second board: that is the time of board and port, without twin and loop.
"""

from __future__ import annotations

import gc
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import wraps
from multiprocessing import get_context
from pathlib import Path
from typing import Any, TypeVar
from unittest import mock

import numpy as np

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.board.core.context import TIME_HZ
from neuroflight.sim.board.core.engine import Engine
from neuroflight.sim.board.native.library import Native
from neuroflight.sim.control.pid_table import pid_table
from neuroflight.sim.flight.loop import fly
from neuroflight.sim.flight.scenario import Scenario, load_scenario
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.ports.emulator import EmulatedPort
from neuroflight.sim.ports.port import Reply, Sample
from tests.bench.unicorn_cost import BLOCK, Cost, unicorn_costs

T = TypeVar("T")
ROOT = Path(__file__).resolve().parents[2]
POLICY = ROOT / "training" / "policies" / "nf1" / "policy.onnx"
AIRCRAFT, SCENARIO, SEED, COUNT = "nf1", "pulses", 1, 2
IDLE_S = 2.0
BAR = 2.0  # of real time, with a policy flying
PARTS = (
    "instructions, and the engine's look at each (unicorn)",
    "exceptions, events, time (engine)",
    "peripherals in C",
    "peripherals in Python",
    "twin",
    "loop and port",
)


@dataclass(frozen=True)
class Row:
    """A flight, or the idle board."""

    name: str
    board_s: float  # time of the board
    wall_s: float
    cpu_s: float
    instructions: int

    @property
    def factor(self) -> float:
        """Of real time, by the clock on the wall."""
        return self.board_s / self.wall_s

    @property
    def cpu_factor(self) -> float:
        """Of real time, by the seconds of a processor that nobody else would have had."""
        return self.board_s / self.cpu_s


@dataclass(frozen=True)
class Speed:
    """What was measured."""

    rows: tuple[Row, ...]
    shares: dict[str, float]  # of the policy's flight, by part; together 1
    costs: tuple[Cost, ...]  # of an instruction


class Stopwatch:
    """Time by part: what a part calls of another one is the other's."""

    def __init__(self, rest: str) -> None:
        self.spent: dict[str, float] = dict.fromkeys(PARTS, 0.0)
        self._parts = [rest]
        self._since = time.perf_counter()

    def _turn(self) -> None:
        now = time.perf_counter()
        self.spent[self._parts[-1]] += now - self._since
        self._since = now

    def stop(self) -> None:
        """The last part ends."""
        self._turn()

    def of(self, part: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """`function`, its time charged to `part`."""

        @wraps(function)
        def timed(*arguments: Any, **named: Any) -> Any:
            self._turn()
            self._parts.append(part)
            try:
                return function(*arguments, **named)
            finally:
                self._turn()
                self._parts.pop()

        return timed


def measure(report: Callable[[str], None]) -> Speed:
    """Build the image, fly and rest; `report` hears of the progress."""
    from neuroflight.toolchain.image.build import build

    with tempfile.TemporaryDirectory() as folder:
        build("MATEKF722", POLICY, ROOT, Path(folder), pid_table(load_aircraft(AIRCRAFT)))
        image = Path(folder) / "MATEKF722" / "neuroflight.bin"
        policy = load_scenario(SCENARIO, seed=SEED, count=COUNT)
        rows = []
        for name, scenario in (("policy flies", policy), ("PID flies", policy.under_pid())):
            report(f"board: {name}")
            rows.append(_apart(_flight, name, image, scenario))
        report("board: the policy's flight again, without twin and loop")
        rows.append(_apart(_replay, "policy, board alone", image, policy))
        report("board: idle")
        rows.append(_apart(_idle, image))
        report("board: where the time goes")
        return Speed(tuple(rows), _apart(_shares, image, policy), _apart(unicorn_costs))


def _apart(function: Callable[..., T], *arguments: object) -> T:
    """In a process of its own, as a flight is: what a build leaves in this one slows a flight down."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(function, *arguments).result()


def _twin(port: EmulatedPort, scenario: Scenario) -> Twin:
    rng = np.random.default_rng((SEED, 1))
    return Twin(load_aircraft(AIRCRAFT), rate_hz=port.gyro_rate_hz, mount=scenario.mount, rng=rng)


@contextmanager
def _measured(name: str, port: EmulatedPort, rows: list[Row]) -> Iterator[None]:
    board = port.board
    gc.collect()  # what is left of the build and of other flights
    cycle, instructions = board.cycle, board.engine.instructions
    wall, cpu = time.perf_counter(), time.process_time()
    yield
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    passed = (board.cycle - cycle) / TIME_HZ
    rows.append(Row(name, passed, wall, cpu, board.engine.instructions - instructions))


def _flight(name: str, image: Path, scenario: Scenario) -> Row:
    rows: list[Row] = []
    with closing(EmulatedPort(image)) as port:
        twin = _twin(port, scenario)
        with _measured(name, port, rows):
            fly(twin, port, scenario)
        twin.close()
    return rows[0]


class _Recorder(EmulatedPort):
    """Keeps what it is given."""

    given: list[tuple[str, tuple[Any, ...]]]  # method and arguments

    def announce(self, channels_us: Sequence[int], samples: int) -> None:
        """Likewise."""
        self.given.append(("announce", (list(channels_us), samples)))
        super().announce(channels_us, samples)

    def exchange(self, sample: Sample, channels_us: Sequence[int] | None) -> Reply:
        """Likewise."""
        kept = sample.copy()
        self.given.append(("exchange", (kept, channels_us)))
        return super().exchange(sample, channels_us)


def _replay(name: str, image: Path, scenario: Scenario) -> Row:
    """A flight's samples and frames, given to a second board."""
    rows: list[Row] = []
    with closing(_Recorder(image)) as recorder:
        recorder.given = []
        twin = _twin(recorder, scenario)
        fly(twin, recorder, scenario)
        twin.close()
    with closing(EmulatedPort(image)) as port:
        calls = [(getattr(port, method), arguments) for method, arguments in recorder.given]
        gc.collect()
        gc.freeze()  # a flight keeps no samples for the collector to look through
        with _measured(name, port, rows):
            for call, arguments in calls:
                call(*arguments)
    return rows[0]


def _idle(image: Path) -> Row:
    """Powered, booted, at rest."""
    rows: list[Row] = []
    with closing(EmulatedPort(image)) as port, _measured("idle", port, rows):
        port.board.run(IDLE_S)
    return rows[0]


def _shares(image: Path, scenario: Scenario) -> dict[str, float]:
    code, engine, devices, python, twin_part, rest = PARTS
    watch = Stopwatch(rest)
    callbacks = ("source", "exchange", "errors", "pulses", "frames", "query", "pin", "reject", "sample")
    patches: list[Any] = [
        *(
            mock.patch.object(Native, f"_{name}", watch.of(python, getattr(Native, f"_{name}")))
            for name in callbacks
        ),
        mock.patch.object(Engine, "run", watch.of(engine, Engine.run)),
        *(mock.patch.object(Twin, name, watch.of(twin_part, getattr(Twin, name))) for name in ("step",)),
    ]
    for patch in patches:
        patch.start()
    try:
        with closing(EmulatedPort(image)) as port:
            core = port.board.engine
            for listeners in (core._reads, core._writes, core._rings):
                listeners[:] = [watch.of(python, listener) for listener in listeners]
            twin = _twin(port, scenario)
            core.clock()
            watch.stop()
            watch.spent.update(dict.fromkeys(PARTS, 0.0))
            fly(twin, port, scenario)
            watch.stop()
            spent = watch.spent
            in_code, in_devices = core.spent_s
            twin.close()
    finally:
        for patch in patches:
            patch.stop()
    # Python's peripherals are called from within the others, and from the port as well.
    spent[code] = in_code
    spent[devices] = max(0.0, in_devices - spent[python])
    spent[engine] -= in_code + spent[devices]
    total = sum(spent.values())
    return {part: spent[part] / total for part in PARTS}


def print_table(speed: Speed, line: Callable[[str], None] = print) -> None:
    """For people."""
    heads = f"{'real time':>11}{'of CPU':>9}{'M instructions a second':>26}{'a board second':>16}"
    line(f"{'emulated board':20}{heads}")
    for row in speed.rows:
        million = row.instructions / 1e6
        line(
            f"{row.name:20}{row.factor:>10.2f}x{row.cpu_factor:>8.2f}x{million / row.wall_s:>26.1f}"
            f"{million / row.board_s:>16.1f}"
        )
    first = speed.rows[0]
    met = "met" if first.factor >= BAR else "missed"
    line(f"bar: {BAR:g}x of real time while a policy flies: {met}")
    line("where the time of the policy's flight goes")
    for part in PARTS:
        line(f"  {part:56}{speed.shares[part]:>5.0%}")
    bare = speed.costs[0].ns
    line(f"{f'a loop of {BLOCK} instructions':28}{'ns an instruction':>20}{'ns a block above bare':>24}")
    for cost in speed.costs:
        line(f"  {cost.name:26}{cost.ns:>20.2f}{BLOCK * (cost.ns - bare):>24.1f}")


def document(speed: Speed) -> dict[str, Any]:
    """For programs."""
    return {
        "rows": [
            {
                "name": row.name,
                "real_time_factor": round(row.factor, 3),
                "cpu_factor": round(row.cpu_factor, 3),
                "instructions_a_second": round(row.instructions / row.wall_s),
                "instructions_a_board_second": round(row.instructions / row.board_s),
            }
            for row in speed.rows
        ],
        "shares": {part: round(share, 4) for part, share in speed.shares.items()},
        "bar": BAR,
        "unicorn_ns_an_instruction": {cost.name: round(cost.ns, 3) for cost in speed.costs},
    }
