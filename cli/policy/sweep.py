"""neuroflight policy sweep: many training runs from one file, and their Pareto front."""

from __future__ import annotations

import argparse
import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from neuroflight.cli.plugins import add_plugin_argument, load_named, words

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.console import Console
    from rich.table import Table

    from neuroflight.training.sweeps.axes import Varied
    from neuroflight.training.sweeps.config import Sweep
    from neuroflight.training.sweeps.jobs import SweepCallback
    from neuroflight.training.sweeps.summary import Configuration, Run
    from neuroflight.training.sweeps.trial import AtThrust, Figure

CPUS_MAX = 4096
WIDTH = 160  # characters of a table printed to a file


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "file", type=Path, metavar="FILE.toml", help="what is varied; see docs/guides/sweeps.md"
    )
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for the results")
    add_plugin_argument(parser)
    again = parser.add_mutually_exclusive_group()
    again.add_argument("--resume", action="store_true", help="continue the sweep in --out")
    again.add_argument("--force", action="store_true", help="replace the sweep in --out")
    parser.add_argument(
        "--address",
        metavar="ADDRESS",
        help="of a Ray cluster whose nodes all have --out, or local: a Ray session of this machine; "
        "default: processes of this machine, without Ray",
    )
    parser.add_argument("--cpus", type=int, metavar="N", help="runs at a time; default: this machine's cores")
    parser.add_argument("--json", action="store_true", help="print JSON instead of tables")


def run(args: argparse.Namespace) -> int:
    """Do the runs with a progress bar, print the tables. Returns 0; 1 if a run failed."""
    from rich.console import Console

    from neuroflight.cli.output import check_folder, command_line
    from neuroflight.toolchain.errors import TrainingError
    from neuroflight.toolchain.files import claimed
    from neuroflight.training.sweeps.config import load_sweep
    from neuroflight.training.sweeps.run import RECORD, run_sweep
    from neuroflight.training.sweeps.summary import configurations

    cpus = args.cpus if args.cpus is not None else len(os.sched_getaffinity(0))
    if not 1 <= cpus <= CPUS_MAX:
        raise TrainingError(f"--cpus {cpus}, expected 1 to {CPUS_MAX}")
    check_folder(args.out, "--out")
    plugins = load_named(args)
    sweep = load_sweep(args.file)
    command = command_line(
        "policy sweep", str(args.file), *words(args), out=str(args.out), cpus=args.cpus, force=args.force
    )
    with claimed(args.out, "sweep"), _progress_bars(sweep, args.out) as callback:
        runs = run_sweep(
            sweep,
            args.out,
            cpus=cpus,
            address=args.address,
            resume=args.resume,
            force=args.force,
            command=command,
            callback=callback,
            plugins=plugins,
        )
    if args.json:
        print((args.out / RECORD).read_text(), end="")
    else:
        console = Console(width=None if sys.stdout.isatty() else WIDTH)
        _print(console, args.out, sweep, runs, configurations(runs))
    failed = [run for run in runs if run.outcome is None]
    for item in failed:
        print(f"run {item.trial.number} ({item.trial.folder}) failed: {item.reason}", file=sys.stderr)
    return 1 if failed else 0


@contextmanager
def _progress_bars(sweep: Sweep, out: Path) -> Iterator[SweepCallback]:
    """Show progress on stderr; the first Ctrl-C lets runs save their state, the second ends them at once."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    from neuroflight.training.sweeps.jobs import SweepCallback, request_stop

    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[figures]}"))
    with Progress(*columns, TimeElapsedColumn(), TimeRemainingColumn(), console=console) as bar:
        total = sum(trial.config.steps for trial in sweep.trials)
        whole = bar.add_task(f"{len(sweep.trials)} runs", total=total, figures="")
        own: dict[int, TaskID] = {}
        steps: dict[int, int] = {}

        class Bars(SweepCallback):
            """One bar for all runs and one for each active run."""

            def progressed(self, number: int, done: int, reward: float, pid: int) -> None:
                trial = sweep.trials[number - 1]
                if number not in own:
                    own[number] = bar.add_task(f"  {trial.folder}", total=trial.config.steps, figures="")
                bar.update(own[number], completed=done, figures=f"{done:,} steps · reward {reward:.3f}")
                self._add(number, done)

            def finished(self, number: int) -> None:
                self._end(number)
                self._add(number, sweep.trials[number - 1].config.steps)

            def restarted(self, number: int) -> None:
                folder = sweep.trials[number - 1].folder
                bar.console.print(f"{folder}: its worker died; it goes on from its last checkpoint")

            def failed(self, number: int, reason: str) -> None:
                self._end(number)
                bar.console.print(f"{sweep.trials[number - 1].folder}: {reason}", markup=False)

            def _end(self, number: int) -> None:
                if number in own:
                    bar.remove_task(own.pop(number))

            def _add(self, number: int, done: int) -> None:
                steps[number] = done
                bar.update(whole, completed=sum(steps.values()))

        def stop(*_: object) -> None:
            request_stop(out)
            signal.signal(signal.SIGINT, before)
            bar.update(whole, description="stopping; again Ctrl-C: at once")

        before = signal.signal(signal.SIGINT, stop)
        try:
            yield Bars()
        finally:
            signal.signal(signal.SIGINT, before)


def _print(
    console: Console, out: Path, sweep: Sweep, runs: Sequence[Run], found: Sequence[Configuration]
) -> None:
    from neuroflight.training.sweeps.run import PLOT, RECORD, TRIALS
    from neuroflight.training.sweeps.summary import unfit

    console.print(_runs(runs))
    if sweep.validation.thrust:
        console.print()
        console.print(_at_thrusts(runs))
        if any(each.current for run in runs if run.outcome for each in run.outcome.thrusts):
            console.print()
            console.print(_draws(runs))
    if any(len(item.runs) > 1 for item in found):
        console.print()
        console.print(_configurations(found))
    note = "± is 95 % confidence of the mean: of a run over the commands, of a configuration over its seeds."
    if any(item.front for item in found):
        priced = all(item.predicted_cycles is not None for item in found)
        note += f" *: nothing beats it in MAE, |Δu|{' and cycles' if priced else ''}."
    if reason := next((run.outcome.no_cycles_reason for run in runs if run.outcome), None):
        note += f" Cycles or instructions are not known: {reason}"
    for run in runs:
        if run.outcome and (reason := unfit(run.outcome, sweep.board)):
            console.print(f"{run.trial.folder}: too large for the board: {reason}", highlight=False)
    console.print(note, style="dim", markup=False, highlight=False)
    console.print(f"{out}: {RECORD}, {PLOT}, {TRIALS}/", style="dim", markup=False, highlight=False)


def _runs(runs: Sequence[Run]) -> Table:
    keys = list(runs[0].trial.varied)
    table = _table("Runs", ("run", *keys, "drift, °"))
    for run in runs:
        head = [f"{run.trial.number}", *_cells(run.trial.varied, keys)]
        done = run.outcome
        if done is None:
            table.add_row(*head, run.state)
            continue
        table.add_row(
            *head,
            f"{done.drift.mean:.1f}" if done.drift else "-",
            *_figures(done.mae, done.mse, done.output, done.change),
            _count(done.instructions),
            _count(done.predicted_cycles),
            f"{done.training_seconds:,.0f}",
        )
    return table


def _at_thrusts(runs: Sequence[Run]) -> Table:
    """Return a table of MAE and |Δu| of the motors at each thrust at rest."""
    title = "MAE, deg/s, and |Δu| of the motors in 1 ms, by thrust at rest over the weight"
    return _by_thrust(
        runs, title, lambda each: f"{each.mae.mean:.2f} {each.change.mean:.4f} ({each.thrust:.2f})"
    )


def _draws(runs: Sequence[Run]) -> Table:
    """Return a table of electric current and power at each thrust at rest."""

    def shown(each: AtThrust) -> str:
        if each.current is None or each.power is None:
            return "-"
        return f"{each.current.mean:.2f} A {each.power.mean:,.1f} W"

    return _by_thrust(runs, "Mean current and electric power, by thrust at rest over the weight", shown)


def _by_thrust(runs: Sequence[Run], title: str, shown: Callable[[AtThrust], str]) -> Table:
    """Return a table with a column for each thrust at rest."""
    from rich.table import Table

    keys = list(runs[0].trial.varied)
    done = [(run, run.outcome) for run in runs if run.outcome]
    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    for heading in ("run", *keys):
        table.add_column(heading, overflow="fold")
    for each in done[0][1].thrusts if done else ():
        table.add_column("closed" if each.asked is None else f"{each.asked:g}", justify="right")
    for run, outcome in done:
        figures = map(shown, outcome.thrusts)
        table.add_row(f"{run.trial.number}", *_cells(run.trial.varied, keys), *figures)
    return table


def _configurations(found: Sequence[Configuration]) -> Table:
    keys = list(found[0].varied)
    table = _table("Configurations", ("", *keys, "seeds"))
    for place, item in enumerate(found, 1):
        table.add_row(
            f"{place}{'*' if item.front else ' '}",
            *_cells(item.varied, keys),
            f"{len(item.runs)}",
            *_figures(item.mae, item.mse, item.output, item.change),
            _count(item.instructions),
            _count(item.predicted_cycles),
            f"{item.training_seconds:,.0f}",
        )
    return table


def _table(title: str, heads: Sequence[str]) -> Table:
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    for heading in heads:
        table.add_column(heading, overflow="fold")
    for heading in ("MAE, deg/s", "MSE", "ū", "|Δu| in 1 ms", "instr.", "cycles", "train, s"):
        table.add_column(heading, justify="right")
    return table


def _cells(varied: Varied, keys: Sequence[str]) -> list[str]:
    from rich.markup import escape

    from neuroflight.training.sweeps.config import shown

    return [escape(shown(varied[key])) for key in keys]


def _figures(mae: Figure, mse: Figure, output: Figure, change: Figure) -> list[str]:
    return [
        f"{figure.mean:,.{digits}f} ± {figure.margin:,.{digits}f}"
        for figure, digits in ((mae, 2), (mse, 0), (output, 3), (change, 4))
    ]


def _count(value: float | None) -> str:
    return "-" if value is None else f"{value:,.0f}"
