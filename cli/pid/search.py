"""The parts of `pid tune` that all its subjects share: progress, and the flights of the final figures."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Protocol

from neuroflight.cli.pid.options import BETAFLIGHT, FLYING, TuneOptions
from neuroflight.cli.progress import progress_bars
from neuroflight.toolchain.errors import TrainingError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from neuroflight.sim.aircraft.model import Aircraft
    from neuroflight.training.evaluation.evaluation import Evaluation, Flights
    from neuroflight.training.pid_tuning.trial import Tuning
    from neuroflight.training.pid_tuning.tuner import MakeTuner
    from neuroflight.training.tasks.flight import FlightTask

CHECKED_MAX = 500  # commands at each thrust: a Betaflight for each flight at a time
OF_A_PID = ("max_output", "max_idle", "name", "plot")  # options of its search alone


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


def check_thrusts_only(args: TuneOptions) -> None:
    """Refuse what only a PID's search has. Raises NeuroflightError."""
    from neuroflight.cli.output import check_output

    if args.terms != FLYING:
        raise TrainingError(f"--terms {args.terms}: of a PID's search; all others are by flying terms")
    args.refuse(*OF_A_PID, because="of a PID's search; leave it out")
    if args.unseen > CHECKED_MAX:
        raise TrainingError(f"--unseen {args.unseen}, expected 1 to {CHECKED_MAX}")
    check_output(args.write, ".txt" if args.of == BETAFLIGHT else ".toml")


def chosen_tuner(args: TuneOptions) -> MakeTuner:
    """Return the search method: CMA-ES, or the user's own."""
    from neuroflight.training.pid_tuning.cma_es import CmaEs
    from neuroflight.training.pid_tuning.tuner import load_tuner

    return CmaEs if args.tuner is None else load_tuner(args.tuner)


@contextmanager
def search_bar(budget: int, first: str) -> Iterator[Callable[[int, Candidate], None]]:
    """Show a search on a terminal; yields a function that takes the candidates flown so far and the best one.

    first: what is flown before the search.
    """
    with progress_bars() as bar:
        show_bar = bar(first)

        def show(flown: int, best: Candidate) -> None:
            figures = f"MAE {best.mae:.2f}  |Δu| {best.change:.4f}"
            show_bar(min(flown, budget), budget, f"search  {figures}")

        yield show


def tell_interruption(tuning: Tuning[Any]) -> None:
    """Say on stderr that the user ended a search, if so."""
    if tuning.interrupted:
        print(f"interrupted after {len(tuning.trials)} candidates; the best is kept", file=sys.stderr)


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
