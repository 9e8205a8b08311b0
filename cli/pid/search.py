"""The parts of `pid tune` that all its subjects share: progress, and the flights of the final figures."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Protocol

from neuroflight.cli.pid.report import BETAFLIGHT, FLYING
from neuroflight.toolchain.errors import TrainingError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from neuroflight.sim.aircraft.model import Aircraft
    from neuroflight.training.evaluation.evaluation import Evaluation, Flights
    from neuroflight.training.pid_tuning.tuner import MakeTuner
    from neuroflight.training.tasks.flight import FlightTask

CHECKED_MAX = 500  # commands at each thrust: a Betaflight for each flight at a time
OF_A_PID = ("max_output", "max_idle", "name", "plot")  # options of its search alone
Show = Callable[[int, int], None]  # how much is done, of how much


class Candidate(Protocol):
    """The figures of a candidate that progress shows."""

    @property
    def mae(self) -> float:
        """Mean of the axes [deg/s]."""
        ...

    @property
    def change(self) -> float:
        """Mean |change| in 1 ms."""
        ...


def check_thrusts_only(args: argparse.Namespace) -> None:
    """Refuse options of a PID's search and fill in the defaults of all others. Raises NeuroflightError."""
    from neuroflight.cli.compare.controllers import check_ranges
    from neuroflight.cli.output import check_output
    from neuroflight.training.pid_tuning.flying import CHANGE

    if args.terms != FLYING:
        raise TrainingError(f"--terms {args.terms}: of a PID's search; all others are by flying terms")
    for name in OF_A_PID:
        if getattr(args, name) is not None:
            raise TrainingError(f"--{name.replace('_', '-')}: of a PID's search; leave it out")
    args.check = 50 if args.check is None else args.check
    check_ranges(("--check", args.check, 1, CHECKED_MAX))
    check_output(args.write, ".txt" if args.of == BETAFLIGHT else ".toml")
    args.limit = CHANGE if args.max_change is None else args.max_change


def chosen_tuner(args: argparse.Namespace) -> MakeTuner:
    """Return the search method: CMA-ES, or the user's own."""
    from neuroflight.training.pid_tuning.cma_es import CmaEs
    from neuroflight.training.pid_tuning.tuner import load_tuner

    return CmaEs if args.tuner is None else load_tuner(args.tuner)


@contextmanager
def search_bar(budget: int, first: str) -> Iterator[Callable[[int, Candidate], None]]:
    """Show a search on a terminal; yields a function that takes the candidates flown so far and the best one.

    first: what is flown before the search.
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description:<44}"), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(first, total=budget)

        def show(flown: int, best: Candidate) -> None:
            figures = f"MAE {best.mae:.2f}  |Δu| {best.change:.4f}"
            bar.update(task, completed=min(flown, budget), description=f"search  {figures}")

        yield show


@contextmanager
def flights_bar() -> Iterator[Callable[[str], Show]]:
    """Show the final flights on a terminal; yields a function that begins a line."""
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:

        def begin(what: str) -> Show:
            task = bar.add_task(what)
            return lambda done, total: bar.update(task, completed=done, total=total)

        yield begin


def final_flights(aircraft: Aircraft, idle: float, commands: int) -> tuple[FlightTask, NDArray[np.float32]]:
    """Return the task, and the throttle of each of its flights: `commands` at each thrust of the search."""
    import numpy as np

    from neuroflight.sim.analysis.holding import DRIFT_S
    from neuroflight.training.pid_tuning.flying import LEVELS, PULSES, throttle_for
    from neuroflight.training.tasks.flight import FlightTask

    task, count = FlightTask(pulses=PULSES, hover_s=DRIFT_S).of_commands(commands)
    throttle = [throttle_for(aircraft, level, idle) for level in LEVELS]
    return task, np.repeat(np.array(throttle, np.float32), count)


def by_thrust(flown: Flights) -> dict[str, Evaluation]:
    """Return the figures at each thrust of `final_flights`; the change is that of the motors."""
    from neuroflight.training.evaluation.evaluation import figures
    from neuroflight.training.pid_tuning.flying import LEVELS

    count = len(flown.rate) // len(LEVELS)
    found = {}
    for number, level in enumerate(LEVELS):
        evaluation = figures(_some(flown, slice(number * count, (number + 1) * count)))
        assert evaluation.motor_change is not None  # `record` keeps the motors
        change = float(evaluation.motor_change.value)
        found[f"thrust {level:g}"] = replace(evaluation, effort=replace(evaluation.effort, change=change))
    return found


def _some(flights: Flights, episodes: slice) -> Flights:
    """Return some of the episodes, with the signals of all figures but those of power."""
    assert flights.motors is not None  # `record` keeps them
    return replace(
        flights,
        setpoint=flights.setpoint[episodes],
        rate=flights.rate[episodes],
        output=flights.output[episodes],
        motors=flights.motors[episodes],
        lift=None,
        power=None,
        current=None,
    )
