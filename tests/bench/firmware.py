"""What the whole control task takes on the Cortex-M7: from the gyro's bytes in memory to the motors' frame.

The image flies on the emulated board, as delivered and with all that ESCs tell, and each run of its handler
is counted (`neuroflight image time` does the same).
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.board.board import Board
from neuroflight.sim.board.debug.control_timing import ControlMeter, TaskCost, Work, task_costs
from neuroflight.sim.control.pid_table import pid_table
from neuroflight.sim.flight.loop import fly
from neuroflight.sim.flight.scenario import Scenario, Segment
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.ports.emulator import EmulatedPort
from neuroflight.toolchain.contract import GYRO_EDGE_RATE_HZ, LogDevice
from neuroflight.toolchain.cortex_m7.cycles import CORE_HZ, DEVICE_CYCLES
from neuroflight.toolchain.cortex_m7.disassembly import disassemble
from neuroflight.toolchain.image.build import build
from neuroflight.toolchain.image.report import needed_settings

ROOT = Path(__file__).resolve().parents[2]
POLICIES = ROOT / "training" / "policies"
AIRCRAFT, SEED = "nf1", 1
CYCLES_BAR = 22_000  # of 216,000 in a control period at 1 kHz, 108,000 at 2 kHz
VARIES_BAR = 0.06  # a frame of the receiver, in some steps, takes about 1,000 cycles
LOGGED_BAR = 0.02  # of a control step's instructions
# Of each flight the shipped policy, and settings besides those that it needs. The second one's are notches on
# three harmonics of each motor, by the answers of all ESCs; the slowest rotor is kept turning as well.
FLIGHTS: Mapping[str, tuple[str, Mapping[str, float]]] = {
    "as delivered": ("nf1", {}),
    "all that ESCs tell": ("nf1-rpm", {"dynamic_idle_rpm": 2000}),
}


@dataclass(frozen=True)
class Row:
    """The control task of one flight."""

    flight: str
    network: str
    steps: int  # armed control steps
    routes: int  # distinct ones
    instructions: tuple[int, int]  # fewest, most
    cycles: tuple[float, float] | None  # predicted, device accesses included
    no_cycles_reason: str | None
    device_accesses: int  # in a control step, at most
    between: tuple[int, int]  # instructions of a gyro sample that is no control step
    logged: float  # part of the longest control step's instructions that the log adds
    logged_between: int  # instructions that it adds to the longest gyro sample that is no control step

    @property
    def varies(self) -> float:
        """(worst - best) / worst, of cycles where there are some."""
        best, worst = self.cycles or self.instructions
        return (worst - best) / worst


def rows(steps: int, say: Callable[[str], None] = lambda text: None) -> list[Row]:
    """The control task over `steps` armed control steps of each of FLIGHTS."""
    with tempfile.TemporaryDirectory(prefix="neuroflight-bench-") as folder:
        return [_row(flight, *flown, steps, Path(folder), say) for flight, flown in FLIGHTS.items()]


def print_table(measured: Sequence[Row]) -> None:
    """The rows, beside what they may take at most."""
    print(
        f"{'the control task on the Cortex-M7':36}{'instructions':>16}{'cycles':>18}{'varies':>8}{'8 kHz':>8}"
    )
    for row in measured:
        cycles = "" if row.cycles is None else _span(*map(round, row.cycles))
        share = "" if row.cycles is None else f"{row.cycles[1] * GYRO_EDGE_RATE_HZ / CORE_HZ:.0%}"
        print(f"{row.flight:36}{_span(*row.instructions):>16}{cycles:>18}{row.varies:>8.1%}{share:>8}")
        print(f"{'  a gyro sample between':36}{_span(*row.between):>16}")
    print(f"{'  at most':36}{'':>16}{CYCLES_BAR:>18,}{VARIES_BAR:>8.1%}")
    for row in measured:
        flown = f"{row.flight}: {row.network}, {row.steps:,} armed steps on {row.routes:,} routes"
        print(f"{flown}; {row.device_accesses} device accesses, taken as {DEVICE_CYCLES} cycles more each")
        print(
            f"{row.flight}: the log adds {row.logged:.2%} to the longest control step, {row.logged_between} "
            f"instructions to the longest sample between"
        )
        if row.no_cycles_reason:
            print(row.no_cycles_reason)


def _span(least: int, most: int) -> str:
    return f"{least:,}" if least == most else f"{least:,}..{most:,}"


def _row(
    flight: str,
    policy: str,
    besides: Mapping[str, float],
    steps: int,
    folder: Path,
    say: Callable[[str], None],
) -> Row:
    say(f"{flight}: building")
    network = POLICIES / policy / "policy.onnx"
    report = build("MATEKF722", network, ROOT, folder, pid_table(load_aircraft(AIRCRAFT)))
    image = folder / "MATEKF722" / "neuroflight.bin"
    settings = {**needed_settings(image), **besides}
    say(f"{flight}: flying")
    (task, between), reason = _costs(image, settings, steps)
    bare, bare_between = _costs(image, {**settings, "blackbox_device": LogDevice.NONE}, steps)[0]
    return Row(
        flight=flight,
        network=report.policy.network,
        steps=task.times,
        routes=task.routes,
        instructions=task.instructions,
        cycles=task.cycles,
        no_cycles_reason=reason,
        device_accesses=task.accesses[1],
        between=between.instructions,
        logged=task.instructions[1] / bare.instructions[1] - 1,
        logged_between=between.instructions[1] - bare_between.instructions[1],
    )


def _costs(
    image: Path, settings: Mapping[str, float], steps: int
) -> tuple[tuple[TaskCost, TaskCost], str | None]:
    """Armed control tasks and samples between them, by the policy; why there are no cycles."""
    elf = image.with_suffix(".elf")
    code = disassemble(elf, lines=True)
    meters: list[ControlMeter] = []

    def attach(board: Board) -> Callable[[int], None]:
        meters.append(ControlMeter(board, elf, code))
        return meters[0].run_to

    segments = (
        Segment(0.1, (150.0 * (-1) ** k, 40.0 * (k % 5), -30.0), 0.3) for k in range(1 + steps // 100)
    )
    scenario = Scenario("busy", tuple(segments))
    with closing(EmulatedPort(image, settings=settings, attach=attach)) as port:
        rng = np.random.default_rng((SEED, 1))
        twin = Twin(load_aircraft(AIRCRAFT), rate_hz=port.gyro_rate_hz, mount=scenario.mount, rng=rng)
        with closing(twin):
            fly(twin, port, scenario)
            costs, priced = task_costs(meters[0].runs(), code)
    armed = {cost.kind.work: cost for cost in costs if cost.kind.armed}
    return (armed[Work.TASK], armed[Work.SAMPLE]), priced.no_cycles_reason
