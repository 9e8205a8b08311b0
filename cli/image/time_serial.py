"""`neuroflight image time --serial N`: control tasks as the firmware measures them, over its UART."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from neuroflight.sim.aircraft.model import Aircraft
    from neuroflight.sim.board.board import Board
    from neuroflight.sim.board.serial.told_times import ToldTimes
    from neuroflight.sim.flight.scenario import Scenario

BAUD = 921_600  # of the line while a flight is streamed: it carries 500 control steps a second
SOURCE = "firmware over UART"
NOTE = (
    "firmware_timing: by the firmware's cycle counter, what interrupts a task included; the emulated core "
    "takes the same 1.63 cycles for each instruction, see docs/explanation/emulated-board.md. Armed: control "
    "steps that were streamed, at most 500 a second"
)


def told_times(
    image: Path,
    steps: int,
    seed: int,
    aircraft: Aircraft,
    settings: Mapping[str, float],
    flights: Sequence[Scenario],
) -> list[ToldTimes]:
    """Return times of an idle board, and of each flight on a board that streams its control steps."""
    from neuroflight.sim.board.serial.idle_board import configured
    from neuroflight.sim.board.serial.told_times import told_of_samples, told_while_idle
    from neuroflight.toolchain.image.elf import read_flashable

    idle = configured(read_flashable(image), image.with_suffix(".elf"), settings)
    told = [told_while_idle(idle, steps)]
    for scenario in flights:
        told += told_of_samples(_stream(image, seed, aircraft, settings, scenario)).values()
    return told


def _stream(
    image: Path, seed: int, aircraft: Aircraft, settings: Mapping[str, float], scenario: Scenario
) -> list[Any]:
    """Return the samples of one flight."""
    import numpy as np

    from neuroflight.sim.board.serial.told_times import StreamListener
    from neuroflight.sim.flight.loop import fly
    from neuroflight.sim.physics.twin import Twin
    from neuroflight.sim.ports.emulator import EmulatedPort

    listeners: list[StreamListener] = []

    def attach(board: Board) -> Callable[[int], None]:
        listeners.append(StreamListener(board, BAUD))
        return board.run_to

    with closing(EmulatedPort(image, settings={**settings, "msp_baud": BAUD}, attach=attach)) as port:
        rng = np.random.default_rng((seed, 1))
        twin = Twin(aircraft, rate_hz=port.gyro_rate_hz, mount=scenario.mount, rng=rng)
        with closing(twin):
            listeners[0].begin()
            fly(twin, port, scenario)
            return listeners[0].samples()


def told_row(told: ToldTimes) -> dict[str, Any]:
    """Return the row as JSON data."""
    from neuroflight.toolchain.cortex_m7.cycles import CORE_HZ

    cycles = {
        "worst": told.worst,
        "best": told.best,
        "mean": told.mean,
        "window": told.worst - told.best,
    }
    return {
        "source": SOURCE,
        "work": "control task",
        "armed": told.armed,
        "controller": told.controller or None,
        "runs": told.runs,
        "cycles": cycles,
        "microseconds": {name: 1e6 * count / CORE_HZ for name, count in cycles.items()},
        "variability": told.variability,
        "missed_deadlines": told.missed,
    }


def print_told(rows: Sequence[dict[str, Any]]) -> None:
    """Print the rows as a table."""
    from rich.console import Console
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for heading in (f"control task, by the {SOURCE}", "runs", "worst/best µs", "mean µs", "varies"):
        table.add_column(heading, justify="right" if table.columns else "left", no_wrap=True)
    for row in rows:
        us = row["microseconds"]
        controller = {"policy": "policy, ", "pid": "PID, "}.get(row["controller"], "")
        table.add_row(
            f"  {controller}{'armed' if row['armed'] else 'disarmed'}",
            f"{row['runs']:,}",
            f"{us['worst']:.1f}/{us['best']:.1f}",
            f"{us['mean']:.1f}",
            f"{row['variability']:.1%}",
        )
    Console(highlight=False).print(table)
