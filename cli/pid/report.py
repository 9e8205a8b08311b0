"""The report of `pid tune`: the aircraft file's comment, tables and JSON."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from neuroflight.cli.output import command_line

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from rich.console import Console
    from rich.table import Table

    from neuroflight.sim.aircraft.model import Aircraft, PidSettings
    from neuroflight.training.evaluation.evaluation import Evaluation
    from neuroflight.training.pid_tuning.trial import Limits
    from neuroflight.training.pid_tuning.tuning import Tuning

PID, BETAFLIGHT = SUBJECTS = ("pid", "betaflight")
FLYING, DISSERTATION = TERMS = ("flying", "dissertation")
DEFAULTS, TUNED = "defaults", "tuned"  # names of settings that are not a PID's
# Defaults that decide what is found; a command is told without them.
USUAL: dict[str, object] = {"terms": FLYING, "budget": 720}


def comment(args: argparse.Namespace, checked: dict[str, Evaluation]) -> str:
    """Return the comment above the settings in the aircraft file."""
    found = f"Found by `{command(args)}`.\n"
    if args.terms == DISSERTATION:
        evaluation = checked["tuned"]
        effort = evaluation.effort
        return (
            f"{found}{args.check:,} unseen pulses: MAE {evaluation.tracking.mae.mean():.2f} deg/s, MSE "
            f"{evaluation.tracking.mse.mean():.0f}, mean output {effort.output:.3f}, mean change in 1 ms "
            f"{effort.change:.4f}."
        )
    return f"{found}{flights_told(args, checked)}\n{figures_told(checked)}"


def flights_told(args: argparse.Namespace, checked: dict[str, Evaluation]) -> str:
    """Return the flights behind the figures at several thrusts, in words."""
    thrusts = ", ".join(name.removeprefix("thrust ") for name in checked)
    what = f"{args.check:,} unseen commands each, five in a flight and then a hover"
    return f"{what}, at {thrusts} times the weight:"


def figures_told(checked: dict[str, Evaluation]) -> str:
    """Return the figures at several thrusts, in a sentence."""
    mae, mse = (
        ", ".join(f"{getattr(item.tracking, name).mean():.{digits}f}" for item in checked.values())
        for name, digits in (("mae", 2), ("mse", 0))
    )
    change = max(item.effort.change for item in checked.values())
    return f"MAE {mae} deg/s, MSE {mse}; mean change of the motor values in 1 ms at most {change:.4f}."


def command(args: argparse.Namespace) -> str:
    """Return the command that finds the same settings: options that decide them, if not the default."""
    given = {name: getattr(args, name) for name, usual in USUAL.items() if getattr(args, name) != usual}
    usual_name = "flying" if args.terms == FLYING else "tuned"
    return command_line(
        "pid tune",
        of=None if args.of == PID else args.of,
        aircraft=Path(args.aircraft).name,
        seed=args.seed,
        **given,
        max_output=args.max_output,
        max_change=args.max_change,
        max_idle=args.max_idle,
        parameters=args.parameters,
        tuner=args.tuner,
        name=None if args.name == usual_name else args.name,
    )


def _settings(settings: PidSettings) -> dict[str, Any]:
    from neuroflight.toolchain.contract import AXES

    gains = {axis: list(values) for axis, values in zip(AXES, settings.gains, strict=True)}
    return {"idle": settings.idle, "derivative_cutoff_hz": settings.derivative_cutoff_hz, **gains}


def figures_document(evaluation: Evaluation) -> dict[str, Any]:
    """Return the figures as JSON data."""
    return {
        "mae": list(evaluation.tracking.mae),
        "mse": list(evaluation.tracking.mse),
        "output": evaluation.effort.output,
        "change": evaluation.effort.change,
    }


def document(
    args: argparse.Namespace,
    aircraft: Aircraft,
    limits: Limits,
    tuning: Tuning,
    checked: dict[str, Evaluation],
) -> dict[str, Any]:
    """Return the whole result as JSON data."""
    from neuroflight.toolchain.contract import AXES

    found = zip(AXES, tuning.ultimate_gains, strict=True)
    return {
        "command": command(args),
        "aircraft": aircraft.name,
        "aircraft_sha256": aircraft.sha256,
        "seed": args.seed,
        "terms": args.terms,
        "candidates": len(tuning.trials),
        "interrupted": tuning.interrupted,
        "limits": {
            "output": limits.output,
            "change": limits.change,
            "change_of": "motors" if limits.of_motors else "outputs",
            "idle": limits.idle,
        },
        "ultimate": {axis: {"gain": item.gain, "period_s": item.period} for axis, item in found},
        "rules": {rule: _settings(trial.settings) for rule, trial in tuning.rules.items()},
        "settings": _settings(tuning.best.settings),
        "unseen": args.check,
        "figures": {name: figures_document(evaluation) for name, evaluation in checked.items()},
    }


def print_tables(
    console: Console,
    args: argparse.Namespace,
    aircraft: Aircraft,
    tuning: Tuning,
    checked: dict[str, Evaluation],
) -> None:
    """Print gains and figures as tables."""
    from rich.table import Table

    from neuroflight.toolchain.contract import AXES

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

    what = "pulses" if args.terms == DISSERTATION else "commands each, five in a flight"
    table = Table(title=f"{args.check:,} unseen {what}, seed {args.seed}", title_justify="left")
    for heading in ("", *checked):
        table.add_column(heading, justify="right" if heading else "left")
    add_errors(table, checked)
    efforts = [evaluation.effort for evaluation in checked.values()]
    if args.terms == DISSERTATION:
        table.add_row("mean output ū", *(f"{item.output:.3f}" for item in efforts))
    of = "" if args.terms == DISSERTATION else " of the motor values"
    table.add_row(f"mean |Δu|{of} in 1 ms", *(f"{item.change:.4f}" for item in efforts))
    console.print(table)
    if args.write:
        console.print(f"[pid.{args.name}] is in {args.write}", markup=False, highlight=False)


def add_errors(table: Table, checked: dict[str, Evaluation]) -> None:
    """Add the rows of errors, a column for each evaluation."""
    errors = [evaluation.tracking for evaluation in checked.values()]
    table.add_row("MAE, deg/s", *(_each(item.mae, 2) for item in errors))
    table.add_row("  average", *(f"{item.mae.mean():.2f}" for item in errors))
    table.add_row("MSE, (deg/s)²", *(_each(item.mse, 0) for item in errors))
    table.add_row("  average", *(f"{item.mse.mean():,.0f}" for item in errors))


def print_thrusts(
    console: Console, title: str, args: argparse.Namespace, of_thrusts: dict[str, Evaluation]
) -> None:
    """Print figures at several thrusts as a table."""
    from rich.table import Table

    what = f"{args.check:,} unseen commands each, five in a flight, seed {args.seed}"
    table = Table(title=f"{title}: {what}", title_justify="left")
    for heading in ("", *of_thrusts):
        table.add_column(heading, justify="right" if heading else "left")
    add_errors(table, of_thrusts)
    changes = (f"{each.effort.change:.4f}" for each in of_thrusts.values())
    table.add_row("mean |Δu| of the motor values in 1 ms", *changes)
    console.print(table)


def keeps_limit(args: argparse.Namespace, of_thrusts: dict[str, Evaluation]) -> int:
    """Return 0; 1, said on stderr, where the motors change by more than the limit."""
    change = max(each.effort.change for each in of_thrusts.values())
    if change <= args.limit:
        return 0
    print(
        f"the motors change by {change:.4f} in 1 ms, more than {args.limit:g}; try a larger --budget or "
        "a wider limit",
        file=sys.stderr,
    )
    return 1


def _each(values: NDArray[np.float64], digits: int) -> str:
    return " / ".join(f"{value:,.{digits}f}" for value in values)
