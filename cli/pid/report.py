"""The report of `pid tune`: the aircraft file's comment, tables and JSON."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from neuroflight.cli.pid.options import DISSERTATION, TuneOptions
from neuroflight.cli.report import print_json, print_table

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from neuroflight.sim.aircraft.model import Aircraft, PidSettings
    from neuroflight.training.evaluation.evaluation import Evaluation
    from neuroflight.training.pid_tuning.trial import Limits, Tuning
    from neuroflight.training.pid_tuning.tuning import PidTuning

Checked = dict[str, dict[str, "Evaluation"]]  # by settings, then by thrust
CHANGE, MOTOR_CHANGE = "mean |Δu| in 1 ms", "mean |Δu| of the motor values in 1 ms"  # rows of figures
DEFAULTS, TUNED = "defaults", "tuned"  # names of settings that are not a PID's


def comment(args: TuneOptions, checked: dict[str, Evaluation]) -> str:
    """Return the comment above the settings in the aircraft file."""
    found = f"Found by `{args.command}`.\n"
    if args.terms == DISSERTATION:
        evaluation = checked["tuned"]
        effort = evaluation.effort
        return (
            f"{found}{args.unseen:,} unseen pulses: MAE {evaluation.tracking.mae.mean():.2f} deg/s, MSE "
            f"{evaluation.tracking.mse.mean():.0f}, mean output {effort.output:.3f}, mean change in 1 ms "
            f"{effort.change:.4f}."
        )
    return f"{found}{flights_told(args, checked)}\n{figures_told(checked)}"


def flights_told(args: TuneOptions, checked: dict[str, Evaluation]) -> str:
    """Return the flights behind the figures at several thrusts, in words."""
    thrusts = ", ".join(name.removeprefix("thrust ") for name in checked)
    what = f"{args.unseen:,} unseen commands each, five in a flight and then a hover"
    return f"{what}, at {thrusts} times the weight:"


def figures_told(checked: dict[str, Evaluation]) -> str:
    """Return the figures at several thrusts, in a sentence."""
    mae, mse = (
        ", ".join(f"{getattr(item.tracking, name).mean():.{digits}f}" for item in checked.values())
        for name, digits in (("mae", 2), ("mse", 0))
    )
    change = max(item.effort.change for item in checked.values())
    return f"MAE {mae} deg/s, MSE {mse}; mean change of the motor values in 1 ms at most {change:.4f}."


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
    args: TuneOptions, aircraft: Aircraft, limits: Limits, tuning: PidTuning, checked: dict[str, Evaluation]
) -> dict[str, Any]:
    """Return the whole result as JSON data."""
    from neuroflight.toolchain.contract import AXES

    found = zip(AXES, tuning.ultimate_gains, strict=True)
    return {
        "command": args.command,
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
        "unseen": args.unseen,
        "figures": {name: figures_document(evaluation) for name, evaluation in checked.items()},
    }


def print_tables(
    args: TuneOptions, aircraft: Aircraft, tuning: PidTuning, checked: dict[str, Evaluation]
) -> None:
    """Print gains and figures as tables."""
    from neuroflight.toolchain.contract import AXES

    ultimate = (f"{u.gain:.3g}, {1e3 * u.period:.0f} ms" for u in tuning.ultimate_gains)
    gains: list[tuple[str, ...]] = [("", *AXES), ("K_u, T_u", *ultimate)]
    for name, trial in (*tuning.rules.items(), ("tuned", tuning.best)):
        sets = (", ".join(f"{value:.3g}" for value in axis) for axis in trial.settings.gains)
        gains.append((name, *sets))
    best = tuning.best.settings
    note = f"derivative low-pass {best.derivative_cutoff_hz:g} Hz, idle {best.idle:g}\n"
    print_table(f"PID of {aircraft.name}: K_P, K_I, K_D", gains, note)

    old = args.terms == DISSERTATION
    what = "pulses" if old else "commands each, five in a flight"
    rows = _error_rows(checked)
    efforts = [evaluation.effort for evaluation in checked.values()]
    if old:
        rows.append(("mean output ū", *(f"{item.output:.3f}" for item in efforts)))
    rows.append((CHANGE if old else MOTOR_CHANGE, *(f"{item.change:.4f}" for item in efforts)))
    print_table(f"{args.unseen:,} unseen {what}, seed {args.seed}", rows)
    if args.write:
        print(f"[pid.{args.table}] is in {args.write}")


def _error_rows(checked: dict[str, Evaluation]) -> list[tuple[str, ...]]:
    """Return the rows of errors below their heading, a column for each evaluation."""
    errors = [evaluation.tracking for evaluation in checked.values()]
    return [
        ("", *checked),
        ("MAE, deg/s", *(_each(item.mae, 2) for item in errors)),
        ("  average", *(f"{item.mae.mean():.2f}" for item in errors)),
        ("MSE, (deg/s)²", *(_each(item.mse, 0) for item in errors)),
        ("  average", *(f"{item.mse.mean():,.0f}" for item in errors)),
    ]


def searched_told(args: TuneOptions, tuning: Tuning[Any], checked: Checked) -> list[str]:
    """Return the comment above what was found for another controller than a PID."""
    told = [f"Found by `{args.command}`."]
    if tuning.interrupted:
        told.append(f"Interrupted after {len(tuning.trials)} candidates.")
    told.append(flights_told(args, checked[DEFAULTS]))
    return [*told, *(f"{name}: {figures_told(each)}" for name, each in checked.items())]


def print_searched(
    args: TuneOptions,
    aircraft: Aircraft,
    label: str,
    tuning: Tuning[Any],
    checked: Checked,
    facts: dict[str, Any],
    lines: Sequence[str],
) -> None:
    """Print what was found for another controller than a PID: facts as JSON, or lines below the tables."""
    if args.json:
        print_json(
            {
                "command": args.command,
                **facts,
                "aircraft": aircraft.name,
                "aircraft_sha256": aircraft.sha256,
                "seed": args.seed,
                "candidates": len(tuning.trials),
                "interrupted": tuning.interrupted,
                "limits": {"change": args.limit, "change_of": "motors"},
                "unseen": args.unseen,
                "figures": {
                    name: {thrust: figures_document(each) for thrust, each in of_thrusts.items()}
                    for name, of_thrusts in checked.items()
                },
            }
        )
        return
    what = f"{args.unseen:,} unseen commands each, five in a flight, seed {args.seed}"
    for name, of_thrusts in checked.items():
        changes = (f"{each.effort.change:.4f}" for each in of_thrusts.values())
        rows = [*_error_rows(of_thrusts), (MOTOR_CHANGE, *changes)]
        print_table(f"{label}, {name}: {what}", rows)
    print(*lines, sep="\n")


def keeps_limit(args: TuneOptions, of_thrusts: dict[str, Evaluation]) -> int:
    """Return 0; 1, said on stderr, where the motors change by more than the limit."""
    change = max(each.effort.change for each in of_thrusts.values())
    if change <= args.limit:
        return 0
    print(
        f"the motors change by {change:.4f} in 1 ms, more than {args.limit:g}; try a larger --candidates or "
        "a wider limit",
        file=sys.stderr,
    )
    return 1


def _each(values: NDArray[np.float64], digits: int) -> str:
    return " / ".join(f"{value:,.{digits}f}" for value in values)
