"""`neuroflight image time`: durations of an image's control tasks in flights on the emulated board."""

from __future__ import annotations

import json
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from neuroflight.cli.options import FlownSettings
from neuroflight.cli.progress import progress_bars
from neuroflight.cli.requests import Argument, Option, Request

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from neuroflight.sim.aircraft.model import Aircraft
    from neuroflight.sim.board.board import Board
    from neuroflight.sim.board.debug.control_timing import Kind, Metered, Run, TaskCost
    from neuroflight.sim.flight.scenario import Scenario
    from neuroflight.toolchain.cortex_m7.cycles import Priced
    from neuroflight.toolchain.cortex_m7.disassembly import Instruction
    from neuroflight.toolchain.image.report import Built

SCENARIO, COUNT_MAX = "pulses", 100
DISARMED_MAX = 1_000_000  # control steps
SERIAL_MAX = 1_000_000  # control tasks
NOTES = (
    "instructions are exact, of the emulated board; cycles are predicted by llvm-mca's model of the "
    "Cortex-M7, see docs/explanation/timing.md",
    "the control algorithm is asked only where the motors may turn: disarmed it has no runs",
    "highest_rate_hz: core_hz over the worst control task, with what a gyro sample between two steps takes "
    "left out",
)


@dataclass(frozen=True, kw_only=True)
class Time(Request):
    """A request to count the instructions and cycles of an image."""

    image: Annotated[Path, Argument("IMAGE.bin", "whose control tasks are counted in flight")]
    aircraft: Annotated[str, Option("NAME|FILE", "whose twin it flies; default: nf1")] = "nf1"
    count: Annotated[int, Option("N", "commands that it flies; default: 3", low=1, high=COUNT_MAX)] = 3
    seed: Annotated[int, Option("S", "of commands and noise; default: 1")] = 1
    set: FlownSettings = ()
    disarmed: Annotated[
        int,
        Option(
            "N",
            "control steps of another board that stays disarmed; default: 0, those before arming alone",
            low=0,
            high=DISARMED_MAX,
        ),
    ] = 0
    serial: Annotated[
        int,
        Option(
            "N",
            "ask the firmware over its UART how long N control tasks of an idle board and those of the "
            "flights took; default: 0, do not ask",
            low=0,
            high=SERIAL_MAX,
            name="--uart-tasks",
            old=("--serial",),
        ),
    ] = 0
    plot: Annotated[Path | None, Option("FILE.png", "draw how long its runs took", recorded=False)] = None
    json: Annotated[bool, Option(None, "print JSON instead of a table", recorded=False)] = False

    def run(self) -> int:
        """Fly the image under its policy and its PID, count every control task, print the durations."""
        from neuroflight.cli.image.time_serial import NOTE, print_told, told_row, told_times
        from neuroflight.cli.output import check_output
        from neuroflight.sim.aircraft.model import load_aircraft
        from neuroflight.sim.board.debug.control_timing import task_costs
        from neuroflight.sim.flight.scenario import load_scenario
        from neuroflight.toolchain.cortex_m7.disassembly import disassemble
        from neuroflight.toolchain.errors import NeuroflightError
        from neuroflight.toolchain.image.report import built

        image = self.image
        if image.suffix == ".onnx":
            raise NeuroflightError(f"{image}: is a policy; run: neuroflight policy time {image}")
        check_output(self.plot, ".png")
        aircraft = load_aircraft(self.aircraft)
        settings = _settings(self, aircraft)
        inside = built(image)
        scenario = load_scenario(SCENARIO, self.seed, self.count)
        code = disassemble(image.with_suffix(".elf"), lines=True)
        flights = [scenario]
        if inside.pid_motors is not None:
            flights.append(scenario.under_pid())
        metered = _fly_all(self, aircraft, settings, [*flights, *([None] if self.disarmed else [])], code)
        runs: dict[Kind, tuple[Run, ...]] = {}
        for flight in metered:
            for kind, found in flight.runs.items():
                runs[kind] = (*runs.get(kind, ()), *found)
        costs, priced = task_costs(runs, code)
        costs = tuple(sorted(costs, key=_place))
        document = _document(self, inside, aircraft, metered, costs, priced)
        if self.serial:
            told = told_times(image, self.serial, self.seed, aircraft, settings, flights)
            document["firmware_timing"] = [told_row(one) for one in told]
            document["notes"].append(NOTE)
        if self.plot:
            from neuroflight.sim.board.debug.control_timing_plot import draw_task_costs
            from neuroflight.sim.plotting import save_png

            save_png(
                self.plot,
                draw_task_costs(costs, f"{image.name}, {inside.policy}: runs on the emulated board"),
            )
        if self.json:
            print(json.dumps(document, indent=2))
        else:
            _print(document, costs, priced)
            print_told(document.get("firmware_timing", ()))
        return 0


def _settings(args: Time, aircraft: Aircraft) -> dict[str, float]:
    """Return the settings that the image flies with. Raises LinkError for one that it would refuse."""
    from neuroflight.flash.settings.values import check_known, parse_change
    from neuroflight.sim.ports.port import flight_settings, twin_settings
    from neuroflight.toolchain.image.report import needed_settings

    settings = {**twin_settings(aircraft), **needed_settings(args.image)}
    settings |= dict(parse_change(text) for text in args.set)
    check_known(flight_settings(settings))
    return settings


def _fly_all(
    args: Time,
    aircraft: Aircraft,
    settings: Mapping[str, float],
    scenarios: list[Scenario | None],
    code: Mapping[int, Instruction],
) -> list[Metered]:
    """Fly all scenarios, each on a board of its own; None: the board stays disarmed."""
    metered = []
    with progress_bars(args.json) as add:
        for scenario in scenarios:
            flown = "disarmed" if scenario is None else "PID" if scenario.segments[0].pid else "policy"
            metered.append(_fly(args, aircraft, settings, scenario, code, add(flown)))
    return metered


def _fly(
    args: Time,
    aircraft: Aircraft,
    settings: Mapping[str, float],
    scenario: Scenario | None,
    code: Mapping[int, Instruction],
    progress: Callable[[float], None],
) -> Metered:
    """Fly once on a board of its own."""
    import numpy as np

    from neuroflight.sim.board.debug.control_timing import ControlMeter
    from neuroflight.sim.flight.loop import fly, stand
    from neuroflight.sim.physics.twin import Twin
    from neuroflight.sim.physics.world import Mount
    from neuroflight.sim.ports.emulator import EmulatedPort

    rng = np.random.default_rng((args.seed, 1))
    meters: list[ControlMeter] = []

    def attach(board: Board) -> Callable[[int], None]:
        meters.append(ControlMeter(board, args.image.with_suffix(".elf"), code))
        return meters[0].run_to

    with closing(EmulatedPort(args.image, settings=settings, attach=attach)) as port:
        mount = Mount.CENTRE if scenario is None else scenario.mount
        twin = Twin(aircraft, rate_hz=port.gyro_rate_hz, mount=mount, rng=rng)
        with closing(twin):
            if scenario is None:
                stand(twin, port, args.disarmed)
            else:
                fly(twin, port, scenario, progress=progress)
            return meters[0].metered()


def _place(cost: TaskCost) -> tuple[int, bool, bool]:
    """Return the key that orders the rows: by work, armed first, the policy first."""
    kind = cost.kind
    return list(type(kind.work)).index(kind.work), not kind.armed, kind.controller != "policy"


def _document(
    args: Time,
    inside: Built,
    aircraft: Aircraft,
    metered: list[Metered],
    costs: tuple[TaskCost, ...],
    priced: Priced,
) -> dict[str, Any]:
    from neuroflight.toolchain.cortex_m7.cycles import CORE_HZ, DEVICE_CYCLES

    return {
        "command": args.command,
        "image": str(args.image),
        "image_sha256": inside.sha256,
        "network": inside.policy,
        "policy_sha256": inside.policy_sha256,
        "aircraft": aircraft.name,
        "aircraft_sha256": aircraft.sha256,
        "scenario": SCENARIO,
        "count": args.count,
        "seed": args.seed,
        "disarmed_steps": args.disarmed,
        "core_hz": CORE_HZ,
        "device_cycles": DEVICE_CYCLES,
        "model": priced.pricer or None,
        "predicted_cycles_reason": priced.no_cycles_reason,
        "missed_deadlines": sum(flight.missed for flight in metered),
        "interruptions": sum(flight.interruptions for flight in metered),
        "interrupting_instructions": sum(flight.interrupting for flight in metered),
        "edge_instructions": {
            "worst": max(flight.edge[1] for flight in metered),
            "best": min(flight.edge[0] for flight in metered),
        },
        "board_timing": [_row(cost) for cost in costs],
        "highest_rate_hz": _highest_rates(costs),
        "notes": list(NOTES),
    }


def _row(cost: TaskCost) -> dict[str, Any]:
    cycles = cost.cycles and {
        "worst": cost.cycles[1],
        "best": cost.cycles[0],
        "window": cost.cycles[1] - cost.cycles[0],
    }
    return {
        "work": cost.kind.work.value,
        "armed": cost.kind.armed,
        "controller": cost.kind.controller or None,
        "runs": cost.times,
        "routes": cost.routes,
        "instructions": {"worst": cost.instructions[1], "best": cost.instructions[0]},
        "predicted_cycles": cycles,
        "microseconds": cycles and {name: _us(count) for name, count in cycles.items()},
        "variability": cost.variability,
        "device_accesses": {"most": cost.accesses[1], "fewest": cost.accesses[0]},
    }


def _highest_rates(costs: tuple[TaskCost, ...]) -> dict[str, float] | None:
    """Return, by controller, the rate at which its worst armed task fills the time; None: no cycles."""
    from neuroflight.sim.board.debug.control_timing import Work
    from neuroflight.toolchain.cortex_m7.cycles import CORE_HZ

    worst: dict[str, float] = {}
    for cost in costs:
        if cost.kind.work is Work.TASK and cost.kind.armed and cost.kind.controller:
            if cost.cycles is None:
                return None
            worst[cost.kind.controller] = max(cost.cycles[1], worst.get(cost.kind.controller, 0.0))
    return {name: CORE_HZ / cycles for name, cycles in worst.items()}


def _print(document: dict[str, Any], costs: tuple[TaskCost, ...], priced: Priced) -> None:
    from rich.console import Console
    from rich.table import Table

    from neuroflight.toolchain.cortex_m7.cycles import CORE_HZ, DEVICE_CYCLES

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
    if rates := document["highest_rate_hz"]:
        words = ", ".join(
            f"{'PID' if name == 'pid' else name} {rate:,.0f} Hz" for name, rate in rates.items()
        )
        console.print(f"highest control rate, by the worst armed control task: {words}")
    console.print(f"missed deadlines, as the firmware counts them: {document['missed_deadlines']:,}")
    if priced.no_cycles_reason:
        model = f"No predicted cycles: {priced.no_cycles_reason}"
    else:
        model = (
            f"Instructions are exact, cycles predicted by {priced.pricer}, {DEVICE_CYCLES} more for each "
            f"access of a peripheral's register and each barrier (docs/explanation/timing.md)."
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
    from neuroflight.toolchain.cortex_m7.cycles import CORE_HZ

    return 1e6 * cycles / CORE_HZ
