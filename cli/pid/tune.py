"""neuroflight pid tune: PID gains for an aircraft, by Ziegler and Nichols' rules, then by CMA-ES.

Or, with `--of betaflight`, settings of Betaflight by the same search, or with `--of FILE.py:CLASS` the
parameters of a user's own controller.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from neuroflight.cli.pid.betaflight import tune_betaflight_of
from neuroflight.cli.pid.report import (
    BETAFLIGHT,
    DISSERTATION,
    FLYING,
    PID,
    SUBJECTS,
    TERMS,
    USUAL,
    comment,
    document,
    print_tables,
)
from neuroflight.cli.pid.search import (
    Show,
    by_thrust,
    check_thrusts_only,
    chosen_tuner,
    final_flights,
    flights_bar,
    search_bar,
)
from neuroflight.cli.pid.users import tune_users_of
from neuroflight.toolchain.errors import TrainingError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from neuroflight.sim.aircraft.model import Aircraft, PidSettings
    from neuroflight.training.evaluation.evaluation import Evaluation, Flights
    from neuroflight.training.pid_tuning.trial import Limits
    from neuroflight.training.pid_tuning.tuning import Tuning
    from neuroflight.training.tasks.task import Task

BUDGET_MAX = 100_000


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--aircraft", default="nf1", metavar="NAME|FILE", help="shipped name or a .toml file")
    parser.add_argument(
        "--of",
        metavar="|".join([*SUBJECTS, "FILE.py:CLASS"]),
        default=SUBJECTS[0],
        help="what is tuned: the PID that stands beside a policy; Betaflight, so that `compare` can fly one "
        "as a pilot would have it; or a controller of a file of yours",
    )
    parser.add_argument(
        "--parameters",
        nargs="+",
        metavar="NAME",
        help="of a controller of yours: those to search; default: all that its class declares",
    )
    parser.add_argument(
        "--tuner",
        metavar="FILE.py:CLASS",
        help="a search of yours, with ask() and tell(), instead of CMA-ES",
    )
    parser.add_argument(
        "--terms",
        choices=TERMS,
        default=FLYING,
        help="flying (default): at four thrusts, commands one after another, mean of the gyro's samples, "
        "centred mix; dissertation: from rest without throttle, idle searched",
    )
    parser.add_argument("--seed", type=int, default=1, metavar="S", help="of commands, noise and search")
    parser.add_argument(
        "--budget", type=int, default=USUAL["budget"], metavar="N", help="candidates to try, about"
    )
    parser.add_argument(
        "--check",
        type=int,
        metavar="N",
        help="unseen commands for the final figures; default: 50 at each thrust, dissertation 1000",
    )
    parser.add_argument(
        "--max-change",
        type=float,
        metavar="DU",
        help="mean |change| in 1 ms of a motor value, default 0.0045; dissertation: of an output, 0.012",
    )
    parser.add_argument(
        "--max-output", type=float, metavar="U", help="dissertation: mean output, fraction above idle (0.12)"
    )
    parser.add_argument(
        "--max-idle",
        type=float,
        metavar="IDLE",
        help="fraction of idling motors; default: flying 0.055, dissertation where all together lift three "
        "quarters of the weight",
    )
    parser.add_argument(
        "--write",
        type=Path,
        metavar="FILE",
        help="put the settings into a copy of the aircraft's file, FILE.toml; Betaflight's into FILE.txt, "
        "for `betaflight:FILE.txt` and the command line of its app",
    )
    parser.add_argument(
        "--name", metavar="NAME", help="of the [pid.NAME] table that is written; default: flying, or tuned"
    )
    parser.add_argument("--plot", type=Path, metavar="FILE.png", help="draw responses and search")
    parser.add_argument(
        "--build", type=Path, metavar="DIR", help="Betaflight's build; default: build/BETAFLIGHT"
    )
    parser.add_argument("--json", action="store_true", help="print JSON instead of tables")


def run(args: argparse.Namespace) -> int:
    """Tune, fly unseen commands, write and print the results. Returns 0; 1 if a limit is exceeded."""
    _check(args)

    from rich.console import Console

    from neuroflight.sim.aircraft.model import FOLDER, load_aircraft, shipped
    from neuroflight.sim.aircraft.pid_write import write_pid
    from neuroflight.sim.plotting import save_png
    from neuroflight.training.pid_tuning.tuning_plot import draw_tuning

    aircraft = load_aircraft(args.aircraft)
    if args.of == BETAFLIGHT:
        return tune_betaflight_of(args, aircraft)
    if args.of != PID:
        return tune_users_of(args, aircraft)
    limits = _limits(args, aircraft)
    tuning = _tune(args, aircraft, limits)
    if tuning.interrupted:
        print(f"interrupted after {len(tuning.trials)} candidates; the best is kept", file=sys.stderr)
    checked = _fly_unseen(args, aircraft, tuning)
    best = replace(tuning.best.settings, nominal_voltage=aircraft.propulsion.supply_voltage)
    if args.write:
        name = args.aircraft
        source = FOLDER / f"{name}.toml" if name in shipped() else Path(name)
        write_pid(source, args.write, args.name, best, comment(args, checked))
    if args.plot:
        title = f"{aircraft.name}: PID tuning, seed {args.seed}"
        save_png(args.plot, draw_tuning(tuning, aircraft, limits, _throttle(args, aircraft), title))
    if args.json:
        print(json.dumps(document(args, aircraft, limits, tuning, checked), indent=2))
    else:
        print_tables(Console(), args, aircraft, tuning, checked)
    kept = all(_keeps(evaluation, limits) for name, evaluation in checked.items() if name not in tuning.rules)
    if not kept:
        output = f"mean output {limits.output:g}, " if limits.output < 1.0 else ""
        print(
            f"no settings were found that keep the limits ({output}change {limits.change:g}); try a larger "
            f"--budget or wider limits",
            file=sys.stderr,
        )
    return 0 if kept else 1


def _check(args: argparse.Namespace) -> None:
    """Check the arguments and fill in the defaults of the terms. Raises NeuroflightError."""
    from neuroflight.cli.compare.controllers import check_ranges
    from neuroflight.cli.output import check_output
    from neuroflight.sim.aircraft.pid_write import NAME
    from neuroflight.sim.physics.world import COUNT_MAX
    from neuroflight.training.evaluation.users_controller import is_users_controller
    from neuroflight.training.pid_tuning.tuning import IDLE_MAX

    check_ranges(
        ("--seed", args.seed, 0, 2**32 - 1),
        ("--budget", args.budget, 1, BUDGET_MAX),
        ("--max-change", args.max_change, 1e-4, 1.0),
    )
    if args.of not in SUBJECTS and not is_users_controller(args.of):
        raise TrainingError(f"--of {args.of}, expected {', '.join(SUBJECTS)} or FILE.py:CLASS")
    if args.of in SUBJECTS and args.parameters is not None:
        raise TrainingError("--parameters: of a controller of yours; add --of FILE.py:CLASS")
    if args.build is not None and args.of != BETAFLIGHT:
        raise TrainingError("--build: of Betaflight; add --of betaflight")
    if args.of != PID:
        check_thrusts_only(args)
        return
    check_ranges(
        ("--check", args.check, 1, COUNT_MAX),
        ("--max-output", args.max_output, 1e-3, 1.0),
        ("--max-idle", args.max_idle, 0.0, IDLE_MAX),
    )
    if args.terms == FLYING and args.max_output is not None:
        raise TrainingError("--max-output: a limit of --terms dissertation; by flying terms there is none")
    if args.name is None:
        args.name = "flying" if args.terms == FLYING else "tuned"
    if args.check is None:
        args.check = 50 if args.terms == FLYING else 1000
    if not NAME.fullmatch(args.name):
        raise TrainingError(f"--name {args.name!r}, expected 1 to 32 letters, digits, dashes, underscores")
    check_output(args.write, ".toml")
    check_output(args.plot, ".png")


def _limits(args: argparse.Namespace, aircraft: Aircraft) -> Limits:
    """Return the limits by the terms, where the user names none."""
    from neuroflight.training.pid_tuning import dissertation, flying
    from neuroflight.training.pid_tuning.trial import Limits
    from neuroflight.training.pid_tuning.tuning import idle_limit

    def given(value: float | None, usual: float) -> float:
        return usual if value is None else value

    most = idle_limit(aircraft)
    if args.terms == FLYING:
        idle, change = given(args.max_idle, min(flying.IDLE, most)), given(args.max_change, flying.CHANGE)
        return Limits(1.0, change, idle, of_motors=True)
    output = given(args.max_output, dissertation.OUTPUT)
    return Limits(output, given(args.max_change, dissertation.CHANGE), given(args.max_idle, most))


def _tune(args: argparse.Namespace, aircraft: Aircraft, limits: Limits) -> Tuning:
    from neuroflight.training.pid_tuning.dissertation import DissertationTrials
    from neuroflight.training.pid_tuning.flying import FlyingTrials
    from neuroflight.training.pid_tuning.tuning import streams, tune

    draw_tuning, search = streams(args.seed)
    tuner = chosen_tuner(args)
    with search_bar(args.budget, "ultimate gains") as show:
        if args.terms == DISSERTATION:
            trials = DissertationTrials.of(aircraft, limits, args.seed, draw_tuning)
            return tune(trials, budget=args.budget, rng=search, progress=show, tuner=tuner)
        others = [settings for name, settings in aircraft.pids if name != args.name]
        begin = [settings for settings in others if settings.mixer is None]
        flights = FlyingTrials(aircraft, limits, draw_tuning)
        return tune(flights, budget=args.budget, rng=search, progress=show, begin=begin, tuner=tuner)


def _throttle(args: argparse.Namespace, aircraft: Aircraft) -> float:
    """Return the throttle of drawn responses."""
    from neuroflight.training.pid_tuning.flying import IDLE, throttle_for

    return 0.0 if args.terms == DISSERTATION else throttle_for(aircraft, 1.0, IDLE)


def _fly_unseen(args: argparse.Namespace, aircraft: Aircraft, tuning: Tuning) -> dict[str, Evaluation]:
    """Return figures in the twin, on commands of `evaluate --seed` that the search did not fly.

    By the dissertation's terms of the first rule and of the tuned settings, in pulses; by flying terms of
    the tuned settings at each thrust, in flights.
    """
    from neuroflight.training.evaluation.evaluation import figures
    from neuroflight.training.pid_tuning.flying import LEVELS
    from neuroflight.training.tasks.task import PulseTask

    checked = {}
    best = tuning.best.settings
    with flights_bar() as bar:
        if args.terms == DISSERTATION:
            rule, first = next(iter(tuning.rules.items()))
            for name, settings in ((rule, first.settings), ("tuned", best)):
                show = bar(f"{name}: {args.check} unseen commands")
                flown = _flights(args, aircraft, settings, PulseTask(), args.check, 0.0, show)
                checked[name] = figures(flown)
            return checked
        task, levels = final_flights(aircraft, best.idle, args.check)
        show = bar(f"{args.check} unseen commands at each of {len(LEVELS)} thrusts")
        return by_thrust(_flights(args, aircraft, best, task, len(levels), levels, show))


def _flights(
    args: argparse.Namespace,
    aircraft: Aircraft,
    settings: PidSettings,
    task: Task,
    count: int,
    throttle: float | NDArray[np.float32],
    progress: Show,
) -> Flights:
    from neuroflight.sim.control.pid import Pid
    from neuroflight.sim.control.pid_table import mixer
    from neuroflight.training.evaluation.evaluation import record
    from neuroflight.training.pid_tuning.trial import RATE_HZ

    return record(
        Pid(mixer(aircraft), settings, count, RATE_HZ),
        aircraft,
        task,
        episodes=count,
        seed=args.seed,
        control_rate_hz=RATE_HZ,
        throttle=throttle,
        idle=settings.idle,
        mix=settings.mix,
        gyro_mean=settings.gyro_mean,
        progress=progress,
    )


def _keeps(evaluation: Evaluation, limits: Limits) -> bool:
    effort = evaluation.effort
    return effort.output <= limits.output and effort.change <= limits.change
