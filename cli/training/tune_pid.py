"""neuroflight tune-pid: PID gains for an aircraft, by Ziegler and Nichols' rules, then by CMA-ES."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from toolchain.errors import TrainingError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from rich.console import Console

    from sim.aircraft.model import Aircraft, PidSettings
    from training.evaluation.evaluation import Evaluation
    from training.pid_tuning.tuning import Limits, Trial, Tuning

RATE_HZ = 1000  # of the control loop
BUDGET, COMMANDS, CHECKED = 720, 12, 1000
BUDGET_MAX = 100_000
OUTPUT, CHANGE = 0.12, 0.012  # limits


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("--aircraft", default="nf1", metavar="NAME|FILE", help="shipped name or a .toml file")
    parser.add_argument("--seed", type=int, default=1, metavar="S", help="of commands, noise and search")
    parser.add_argument(
        "--commands", type=int, default=COMMANDS, metavar="N", help="pulses that each candidate flies"
    )
    parser.add_argument("--budget", type=int, default=BUDGET, metavar="N", help="candidates to try, about")
    parser.add_argument(
        "--check", type=int, default=CHECKED, metavar="N", help="unseen pulses for the final figures"
    )
    parser.add_argument(
        "--max-output", type=float, default=OUTPUT, metavar="U", help="mean output, fraction above idle"
    )
    parser.add_argument(
        "--max-change", type=float, default=CHANGE, metavar="DU", help="mean |change| of an output in 1 ms"
    )
    parser.add_argument(
        "--max-idle",
        type=float,
        metavar="IDLE",
        help="fraction of idling motors; default: where all together lift three quarters of the weight",
    )
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

    from sim.aircraft.model import FOLDER, load_aircraft, shipped
    from sim.aircraft.pid_write import write_pid
    from sim.plotting import save_png
    from training.pid_tuning.tuning import Limits, idle_limit
    from training.pid_tuning.tuning_plot import draw

    aircraft = load_aircraft(args.aircraft)
    idle_max = idle_limit(aircraft) if args.max_idle is None else args.max_idle
    limits = Limits(args.max_output, args.max_change, idle_max)
    tuning = _tune(args, aircraft, limits)
    if tuning.interrupted:
        print(f"interrupted after {len(tuning.trials)} candidates; the best is kept", file=sys.stderr)
    checked = _fly_unseen(args, aircraft, tuning)
    best = replace(tuning.best.settings, nominal_voltage=aircraft.propulsion.supply_voltage)
    if args.write:
        name = args.aircraft
        source = FOLDER / f"{name}.toml" if name in shipped() else Path(name)
        write_pid(source, args.write, args.name, best, _comment(args, checked["tuned"]))
    if args.plot:
        title = f"{aircraft.name}: PID tuning, seed {args.seed}"
        save_png(args.plot, draw(tuning, aircraft, limits, RATE_HZ, title))
    if args.json:
        print(json.dumps(_document(args, aircraft, limits, tuning, checked), indent=2))
    else:
        _print(Console(), args, aircraft, tuning, checked)
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
    from cli.training.conditions import check_ranges
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
        ("--max-idle", args.max_idle, 0.0, IDLE_MAX),
    )
    if not NAME.fullmatch(args.name):
        raise TrainingError(f"--name {args.name!r}, expected 1 to 32 letters, digits, dashes, underscores")
    check_output(args.write, ".toml")
    check_output(args.plot, ".png")


def _tune(args: argparse.Namespace, aircraft: Aircraft, limits: Limits) -> Tuning:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    from training.pid_tuning.tuning import tune

    columns = (TextColumn("{task.description:<44}"), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("ultimate gains", total=args.budget)

        def show(flown: int, best: Trial) -> None:
            figures = f"MAE {best.mae:.2f}  ū {best.output:.3f}  |Δu| {best.change:.4f}"
            bar.update(task, completed=min(flown, args.budget), description=f"search  {figures}")

        return tune(
            aircraft,
            limits,
            seed=args.seed,
            commands=args.commands,
            budget=args.budget,
            control_rate_hz=RATE_HZ,
            progress=show,
        )


def _fly_unseen(args: argparse.Namespace, aircraft: Aircraft, tuning: Tuning) -> dict[str, Evaluation]:
    """Figures of the first rule and of the tuned settings on the commands of `evaluate --seed`."""
    from rich.console import Console
    from rich.progress import Progress, TaskID

    from sim.control.pid import Pid, mixer
    from training.evaluation.evaluation import figures, record
    from training.tasks.task import PulseTask

    rule, first = next(iter(tuning.rules.items()))
    checked = {}
    with Progress(console=Console(stderr=True), transient=True) as bar:
        for name, trial in ((rule, first), ("tuned", tuning.best)):
            task = bar.add_task(f"{name}: {args.check} unseen commands")

            def show(done: int, total: int, task: TaskID = task) -> None:
                bar.update(task, completed=done, total=total)

            checked[name] = figures(
                record(
                    Pid(mixer(aircraft), trial.settings, args.check, RATE_HZ),
                    aircraft,
                    PulseTask(),
                    episodes=args.check,
                    seed=args.seed,
                    control_rate_hz=RATE_HZ,
                    idle=trial.settings.idle,
                    progress=show,
                )
            )
    return checked


def _keeps(evaluation: Evaluation, limits: Limits) -> bool:
    effort = evaluation.effort
    return effort.output <= limits.output and effort.change <= limits.change


def _comment(args: argparse.Namespace, evaluation: Evaluation) -> str:
    effort = evaluation.effort
    return (
        f"Found by `{_command(args)}`.\n"
        f"{args.check:,} unseen pulses: MAE {evaluation.tracking.mae.mean():.2f} deg/s, MSE "
        f"{evaluation.tracking.mse.mean():.0f}, mean output {effort.output:.3f}, mean change in 1 ms "
        f"{effort.change:.4f}."
    )


def _command(args: argparse.Namespace) -> str:
    """The command that finds the same settings: options that decide them, if not the default."""
    from cli.output import command_line

    usual = {"commands": COMMANDS, "budget": BUDGET, "max_output": OUTPUT, "max_change": CHANGE}
    given = {name: getattr(args, name) for name in usual if getattr(args, name) != usual[name]}
    aircraft = Path(args.aircraft).name
    return command_line("tune-pid", aircraft=aircraft, seed=args.seed, **given, max_idle=args.max_idle)


def _settings(settings: PidSettings) -> dict[str, Any]:
    from toolchain.contract import AXES

    gains = {axis: list(values) for axis, values in zip(AXES, settings.gains, strict=True)}
    return {"idle": settings.idle, "derivative_cutoff_hz": settings.derivative_cutoff_hz, **gains}


def _figures(evaluation: Evaluation) -> dict[str, Any]:
    return {
        "mae": list(evaluation.tracking.mae),
        "mse": list(evaluation.tracking.mse),
        "output": evaluation.effort.output,
        "change": evaluation.effort.change,
    }


def _document(
    args: argparse.Namespace,
    aircraft: Aircraft,
    limits: Limits,
    tuning: Tuning,
    checked: dict[str, Evaluation],
) -> dict[str, Any]:
    from toolchain.contract import AXES

    found = zip(AXES, tuning.ultimate_gains, strict=True)
    return {
        "command": _command(args),
        "aircraft": aircraft.name,
        "aircraft_sha256": aircraft.sha256,
        "seed": args.seed,
        "commands": args.commands,
        "candidates": len(tuning.trials),
        "interrupted": tuning.interrupted,
        "limits": {"output": limits.output, "change": limits.change, "idle": limits.idle},
        "ultimate": {axis: {"gain": item.gain, "period_s": item.period} for axis, item in found},
        "rules": {rule: _settings(trial.settings) for rule, trial in tuning.rules.items()},
        "settings": _settings(tuning.best.settings),
        "unseen": args.check,
        "figures": {name: _figures(evaluation) for name, evaluation in checked.items()},
    }


def _print(
    console: Console,
    args: argparse.Namespace,
    aircraft: Aircraft,
    tuning: Tuning,
    checked: dict[str, Evaluation],
) -> None:
    from rich.table import Table

    from toolchain.contract import AXES

    gains = Table(title=f"PID of {aircraft.name}: K_P, K_I, K_D", title_justify="left")
    for heading in ("", *AXES):
        gains.add_column(heading, justify="right" if heading else "left")
    gains.add_row("K_u, T_u", *(f"{u.gain:.3g}, {1e3 * u.period:.0f} ms" for u in tuning.ultimate_gains))
    for name, trial in (*tuning.rules.items(), ("tuned", tuning.best)):
        sets = (", ".join(f"{value:.3g}" for value in axis) for axis in trial.settings.gains)
        gains.add_row(name, *sets)
    console.print(gains)
    best = tuning.best.settings
    console.print(f"derivative low-pass {best.derivative_cutoff_hz:g} Hz, idle {best.idle:g}\n")

    table = Table(title=f"{args.check:,} unseen pulses, seed {args.seed}", title_justify="left")
    for heading in ("", *checked):
        table.add_column(heading, justify="right" if heading else "left")
    errors = [evaluation.tracking for evaluation in checked.values()]
    efforts = [evaluation.effort for evaluation in checked.values()]
    table.add_row("MAE, deg/s", *(_each(item.mae, 2) for item in errors))
    table.add_row("  average", *(f"{item.mae.mean():.2f}" for item in errors))
    table.add_row("MSE, (deg/s)²", *(_each(item.mse, 0) for item in errors))
    table.add_row("  average", *(f"{item.mse.mean():,.0f}" for item in errors))
    table.add_row("mean output ū", *(f"{item.output:.3f}" for item in efforts))
    table.add_row("mean |Δu| in 1 ms", *(f"{item.change:.4f}" for item in efforts))
    console.print(table)
    if args.write:
        console.print(f"[pid.{args.name}] is in {args.write}", markup=False, highlight=False)


def _each(values: NDArray[np.float64], digits: int) -> str:
    return " / ".join(f"{value:,.{digits}f}" for value in values)
