"""neuroflight tune-pid: PID gains for an aircraft, by Ziegler and Nichols' rules, then by CMA-ES."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from cli.training.tune_pid_report import USUAL, comment, document, print_tables
from toolchain.contract import POLICY_FILTER_MEAN, Mix
from toolchain.errors import TrainingError

if TYPE_CHECKING:
    from sim.aircraft.model import Aircraft
    from training.evaluation.evaluation import Evaluation
    from training.pid_tuning.trial import Limits, Loop, Trial
    from training.pid_tuning.tuning import Tuning

RATE_HZ = 1000  # of the control loop
CHECKED = 1000
BUDGET_MAX = 100_000
MIXES = tuple(mix.text for mix in Mix)
FILTERS = (USUAL["gyro_filter"], POLICY_FILTER_MEAN)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("--aircraft", default="nf1", metavar="NAME|FILE", help="shipped name or a .toml file")
    parser.add_argument("--seed", type=int, default=1, metavar="S", help="of commands, noise and search")
    parser.add_argument(
        "--commands",
        type=int,
        default=USUAL["commands"],
        metavar="N",
        help="pulses that each candidate flies",
    )
    parser.add_argument(
        "--budget", type=int, default=USUAL["budget"], metavar="N", help="candidates to try, about"
    )
    parser.add_argument(
        "--check", type=int, default=CHECKED, metavar="N", help="unseen pulses for the final figures"
    )
    parser.add_argument(
        "--max-output",
        type=float,
        default=USUAL["max_output"],
        metavar="U",
        help="mean output, fraction above idle",
    )
    change = parser.add_mutually_exclusive_group()
    change.add_argument(
        "--max-change",
        type=float,
        default=USUAL["max_change"],
        metavar="DU",
        help="mean |change| of an output in 1 ms",
    )
    change.add_argument(
        "--max-motor-change",
        type=float,
        metavar="DU",
        help="instead: of a motor value, after throttle mix and idle",
    )
    parser.add_argument(
        "--max-idle",
        type=float,
        metavar="IDLE",
        help="fraction of idling motors; default: where all together lift three quarters of the weight",
    )
    parser.add_argument(
        "--mix", choices=MIXES, default=USUAL["mix"], help=f"of outputs and throttle; default: {MIXES[0]}"
    )
    parser.add_argument(
        "--gyro-filter",
        choices=FILTERS,
        default=USUAL["gyro_filter"],
        help="mean: of the gyro's samples of a control step",
    )
    parser.add_argument(
        "--throttle-max",
        type=float,
        default=USUAL["throttle_max"],
        metavar="T",
        help="commands are flown at throttles from 0 to T, each at one; default: all at 0",
    )
    parser.add_argument("--start", metavar="NAME", help="a PID of the file that the search may begin with")
    parser.add_argument(
        "--write", type=Path, metavar="FILE.toml", help="put the settings into a copy of the aircraft's file"
    )
    parser.add_argument("--name", default="tuned", help="of the [pid.NAME] table that is written")
    parser.add_argument("--plot", type=Path, metavar="FILE.png", help="draw responses and search")
    parser.add_argument("--json", action="store_true", help="print JSON instead of tables")


def run(args: argparse.Namespace) -> int:
    """Tune, fly unseen commands, write and print the results. Returns 0; 1 if a limit is exceeded."""
    _check(args)

    from rich.console import Console

    from sim.aircraft.model import aircraft_file, load_aircraft
    from sim.aircraft.pid_write import write_pid
    from sim.plotting import save_png
    from training.pid_tuning.trial import Limits, Loop
    from training.pid_tuning.tuning import idle_limit
    from training.pid_tuning.tuning_plot import draw

    aircraft = load_aircraft(args.aircraft)
    idle_max = idle_limit(aircraft) if args.max_idle is None else args.max_idle
    of_motors = args.max_motor_change is not None
    limits = Limits(
        args.max_output, args.max_motor_change if of_motors else args.max_change, idle_max, of_motors
    )
    loop = Loop(RATE_HZ, Mix.of(args.mix), args.gyro_filter == POLICY_FILTER_MEAN, args.throttle_max)
    tuning = _tune(args, aircraft, limits, loop)
    if tuning.interrupted:
        print(f"interrupted after {len(tuning.trials)} candidates; the best is kept", file=sys.stderr)
    checked = _fly_unseen(args, aircraft, tuning, limits, loop)
    best = replace(tuning.best.settings, nominal_voltage=aircraft.propulsion.supply_voltage)
    if args.write:
        write_pid(aircraft_file(args.aircraft), args.write, args.name, best, comment(args, checked["tuned"]))
    if args.plot:
        title = f"{aircraft.name}: PID tuning, seed {args.seed}"
        save_png(args.plot, draw(tuning, aircraft, limits, loop, title))
    if args.json:
        print(json.dumps(document(args, aircraft, limits, tuning, checked), indent=2))
    else:
        print_tables(Console(), args, aircraft, tuning, checked)
    kept = _keeps(checked["tuned"], limits)
    if not kept:
        print(
            f"no settings were found that keep the limits (mean output {limits.output:g}, change "
            f"{limits.change:g}); try a larger --budget or wider limits",
            file=sys.stderr,
        )
    return 0 if kept else 1


def _check(args: argparse.Namespace) -> None:
    """Check the arguments before anything is flown. Raises NeuroflightError."""
    from cli.output import check_output
    from cli.training.evaluation.ranges import check_ranges
    from sim.aircraft.pid_write import NAME
    from sim.physics.world import COUNT_MAX
    from training.pid_tuning.tuning import IDLE_MAX, POPULATION

    check_ranges(
        ("--seed", args.seed, 0, 2**32 - 1),
        ("--commands", args.commands, 2, COUNT_MAX // POPULATION),
        ("--budget", args.budget, 1, BUDGET_MAX),
        ("--check", args.check, 1, COUNT_MAX),
        ("--max-output", args.max_output, 1e-3, 1.0),
        ("--max-change", args.max_change, 1e-4, 1.0),
        ("--max-motor-change", args.max_motor_change, 1e-4, 1.0),
        ("--max-idle", args.max_idle, 0.0, IDLE_MAX),
        ("--throttle-max", args.throttle_max, 0.0, 1.0),
    )
    if not NAME.fullmatch(args.name):
        raise TrainingError(f"--name {args.name!r}, expected 1 to 32 letters, digits, dashes, underscores")
    check_output(args.write, ".toml")
    check_output(args.plot, ".png")


def _tune(args: argparse.Namespace, aircraft: Aircraft, limits: Limits, loop: Loop) -> Tuning:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    from sim.control.pid import pid_settings
    from training.pid_tuning.tuning import tune

    start = None if args.start is None else pid_settings(aircraft, args.start)
    columns = (TextColumn("{task.description:<44}"), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("ultimate gains", total=args.budget)

        def show(flown: int, best: Trial) -> None:
            figures = f"MAE {best.mae:.2f}  ū {best.output:.3f}  |Δu| {best.change:.4f}"
            bar.update(task, completed=min(flown, args.budget), description=f"search  {figures}")

        return tune(
            aircraft,
            limits,
            loop,
            seed=args.seed,
            commands=args.commands,
            budget=args.budget,
            progress=show,
            start=start,
        )


def _fly_unseen(
    args: argparse.Namespace, aircraft: Aircraft, tuning: Tuning, limits: Limits, loop: Loop
) -> dict[str, Evaluation]:
    """Figures of the first rule and of the tuned settings on the commands of `evaluate --seed`.

    The change is of what its limit is of.
    """
    import numpy as np
    from rich.console import Console
    from rich.progress import Progress, TaskID

    from sim.analysis.metrics import effort
    from sim.control.pid import Pid, mixer
    from training.evaluation.evaluation import figures, record
    from training.pid_tuning.trial import motor_values, throttles
    from training.tasks.task import PulseTask

    rule, first = next(iter(tuning.rules.items()))
    thrust = throttles(args.check, loop.throttle_max, np.random.default_rng(args.seed))
    checked = {}
    with Progress(console=Console(stderr=True), transient=True) as bar:
        for name, trial in ((rule, first), ("tuned", tuning.best)):
            task = bar.add_task(f"{name}: {args.check} unseen commands")

            def show(done: int, total: int, task: TaskID = task) -> None:
                bar.update(task, completed=done, total=total)

            flights = record(
                Pid(mixer(aircraft), trial.settings, args.check, RATE_HZ),
                aircraft,
                PulseTask(),
                episodes=args.check,
                seed=args.seed,
                control_rate_hz=RATE_HZ,
                throttle=thrust,
                idle=trial.settings.idle,
                mix=loop.mix,
                gyro_mean=loop.gyro_mean,
                progress=show,
            )
            evaluation = figures(flights)
            if limits.of_motors:
                motors = motor_values(flights.output, thrust, trial.settings.idle, loop.mix)
                change = effort(motors, flights.step_s).change
                evaluation = replace(evaluation, effort=replace(evaluation.effort, change=change))
            checked[name] = evaluation
    return checked


def _keeps(evaluation: Evaluation, limits: Limits) -> bool:
    effort = evaluation.effort
    return effort.output <= limits.output and effort.change <= limits.change
