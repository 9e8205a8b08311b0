"""`neuroflight timing IMAGE.bin`: what an image's control tasks take while it flies on the emulated board."""

from __future__ import annotations

import argparse
import json
import sys
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from rich.progress import TaskID

    from sim.aircraft.model import Aircraft
    from sim.board.board import Board
    from sim.board.debug.control_timing import Kind, Metered, Run, TaskCost
    from sim.flight.scenario import Scenario
    from toolchain.cortex_m7.cycles import Priced
    from toolchain.cortex_m7.disassembly import Instruction
    from toolchain.image.report import Built

SCENARIO, COUNT_MAX = "pulses", 100


def run(args: argparse.Namespace) -> int:
    """Fly the image under its policy and under its PID, count every control task, print what they took."""
    from sim.aircraft.model import load_aircraft
    from sim.board.debug.control_timing import task_costs
    from sim.flight.scenario import load_scenario
    from toolchain.cortex_m7.disassembly import disassemble
    from toolchain.errors import NeuroflightError
    from toolchain.image.report import built

    image: Path = args.policy
    if not 1 <= args.count <= COUNT_MAX:
        raise NeuroflightError(f"--count {args.count}, expected 1 to {COUNT_MAX}")
    inside = built(image)
    aircraft = load_aircraft(args.aircraft)
    scenario = load_scenario(SCENARIO, args.seed, args.count)
    code = disassemble(image.with_suffix(".elf"), lines=True)
    flights = [scenario] if inside.pid_motors is None else [scenario, scenario.under_pid()]
    metered = _fly_all(args, aircraft, flights, code)
    runs: dict[Kind, tuple[Run, ...]] = {}
    for flight in metered:
        for kind, found in flight.runs.items():
            runs[kind] = (*runs.get(kind, ()), *found)
    costs, priced = task_costs(runs, code)
    costs = tuple(sorted(costs, key=_place))
    document = _document(args, inside, aircraft, metered, costs, priced)
    if args.json:
        print(json.dumps(document, indent=2))
    else:
        _print(document, costs, priced)
    return 0


def _fly_all(
    args: argparse.Namespace, aircraft: Aircraft, scenarios: list[Scenario], code: Mapping[int, Instruction]
) -> list[Metered]:
    from rich.console import Console
    from rich.progress import Progress

    quiet = args.json or not sys.stderr.isatty()
    with Progress(console=Console(stderr=True), transient=True, disable=quiet) as bar:
        metered = []
        for scenario, name in zip(scenarios, ("policy", "PID"), strict=False):
            task = bar.add_task(name, total=1.0)

            def show(part: float, task: TaskID = task) -> None:
                bar.update(task, completed=part)

            metered.append(_fly(args, aircraft, scenario, code, show))
        return metered


def _fly(
    args: argparse.Namespace,
    aircraft: Aircraft,
    scenario: Scenario,
    code: Mapping[int, Instruction],
    progress: Callable[[float], None],
) -> Metered:
    """One flight on a board of its own."""
    import numpy as np

    from sim.board.debug.control_timing import ControlMeter
    from sim.flight.loop import fly
    from sim.physics.twin import Twin
    from sim.ports.emulator import EmulatedPort
    from sim.ports.port import twin_settings

    rng = np.random.default_rng((args.seed, 1))
    meters: list[ControlMeter] = []

    def attach(board: Board) -> Callable[[int], None]:
        meters.append(ControlMeter(board, args.policy.with_suffix(".elf"), code))
        return meters[0].run_to

    settings = twin_settings(aircraft)
    with closing(EmulatedPort(args.policy, settings=settings, attach=attach)) as port:
        twin = Twin(aircraft, rate_hz=port.gyro_rate_hz, mount=scenario.mount, rng=rng)
        with closing(twin):
            fly(twin, port, scenario, progress=progress)
            return meters[0].metered()


def _place(cost: TaskCost) -> tuple[int, bool, bool]:
    """Its row: by work, armed first, the policy first."""
    kind = cost.kind
    return list(type(kind.work)).index(kind.work), not kind.armed, kind.controller != "policy"


def _document(
    args: argparse.Namespace,
    inside: Built,
    aircraft: Aircraft,
    metered: list[Metered],
    costs: tuple[TaskCost, ...],
    priced: Priced,
) -> dict[str, Any]:
    from cli.output import command_line
    from toolchain.cortex_m7.cycles import CORE_HZ, DEVICE_CYCLES

    given = {name: getattr(args, name) for name in ("aircraft", "count", "seed")}
    return {
        "command": command_line("timing", str(args.policy), **given),
        "image": str(args.policy),
        "image_sha256": inside.sha256,
        "network": inside.policy,
        "policy_sha256": inside.policy_sha256,
        "aircraft": aircraft.name,
        "aircraft_sha256": aircraft.sha256,
        "scenario": SCENARIO,
        "count": args.count,
        "seed": args.seed,
        "core_hz": CORE_HZ,
        "device_cycles": DEVICE_CYCLES,
        "model": priced.pricer or None,
        "predicted_cycles_reason": priced.no_cycles_reason,
        "interruptions": sum(flight.interruptions for flight in metered),
        "interrupting_instructions": sum(flight.interrupting for flight in metered),
        "edge_instructions": {
            "worst": max(flight.edge[1] for flight in metered),
            "best": min(flight.edge[0] for flight in metered),
        },
        "board_timing": [_row(cost) for cost in costs],
    }


def _row(cost: TaskCost) -> dict[str, Any]:
    cycles = cost.cycles
    return {
        "work": cost.kind.work.value,
        "armed": cost.kind.armed,
        "controller": cost.kind.controller or None,
        "runs": cost.times,
        "routes": cost.routes,
        "instructions": {"worst": cost.instructions[1], "best": cost.instructions[0]},
        "predicted_cycles": None if cycles is None else {"worst": cycles[1], "best": cycles[0]},
        "variability": cost.variability,
        "device_accesses": {"most": cost.accesses[1], "fewest": cost.accesses[0]},
    }


def _print(document: dict[str, Any], costs: tuple[TaskCost, ...], priced: Priced) -> None:
    from rich.console import Console
    from rich.table import Table

    from toolchain.cortex_m7.cycles import CORE_HZ, DEVICE_CYCLES

    console = Console(highlight=False)
    console.print(
        f"{document['image']}, {document['image_sha256'][:12]}: {document['network']}, flown on the emulated "
        f"board: {SCENARIO}, seed {document['seed']}"
    )
    table = Table(box=None, pad_edge=False)
    for heading in ("worst/best", "runs", "instructions", "cycles", f"µs at {CORE_HZ / 1e6:g} MHz", "varies"):
        table.add_column(heading, justify="right" if table.columns else "left", no_wrap=True)
    work = ""
    for cost in costs:
        if work != cost.kind.work.value:
            work = cost.kind.work.value
            table.add_row(work)
        best, worst = cost.cycles or (None, None)
        table.add_row(
            f"  {_name(cost.kind)}",
            f"{cost.times:,}",
            f"{cost.instructions[1]:,}/{cost.instructions[0]:,}",
            "" if worst is None else f"{worst:,.0f}/{best:,.0f}",
            "" if worst is None or best is None else f"{_us(worst):.1f}/{_us(best):.1f}",
            f"{cost.variability:.1%}",
        )
    console.print(table)
    if priced.no_cycles_reason:
        model = f"No predicted cycles: {priced.no_cycles_reason}"
    else:
        model = (
            f"Instructions are exact, cycles predicted by {priced.pricer}, {DEVICE_CYCLES} more for each "
            f"access of a peripheral's register and each barrier (docs/timing.md)."
        )
    console.print(
        f"{model} What other interrupts executed in between is left out: they came "
        f"{document['interruptions']:,} times.",
        style="dim",
    )


def _name(kind: Kind) -> str:
    controller = {"policy": "policy", "pid": "PID"}.get(kind.controller)
    return ", ".join(filter(None, (controller, "armed" if kind.armed else "disarmed")))


def _us(cycles: float) -> float:
    from toolchain.cortex_m7.cycles import CORE_HZ

    return 1e6 * cycles / CORE_HZ
