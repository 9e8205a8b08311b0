"""neuroflight policy sweep: many training runs from one file, and their Pareto front."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from neuroflight.cli.options import Json
from neuroflight.cli.plugins import WithPlugins
from neuroflight.cli.report import print_table
from neuroflight.cli.requests import Argument, Either, Option

if TYPE_CHECKING:
    from collections.abc import Sequence

    from neuroflight.training.sweeps.axes import Varied
    from neuroflight.training.sweeps.config import Sweep
    from neuroflight.training.sweeps.jobs import SweepCallback
    from neuroflight.training.sweeps.summary import Configuration, Run
    from neuroflight.training.sweeps.trial import AtThrust, Outcome

AGAIN = Either()
FIGURES = ("MAE, deg/s", "MSE", "ū", "|Δu| in 1 ms", "instr.", "cycles", "train, s")


@dataclass(frozen=True, kw_only=True)
class MakeSweep(WithPlugins):
    """A request for many trainings."""

    file: Annotated[Path, Argument("FILE.toml", "what is varied; see docs/guides/sweeps.md")]
    out: Annotated[Path, Option("DIR", "folder for the results")]
    resume: Annotated[bool, Option(None, "continue the sweep in --out", either=AGAIN, recorded=False)] = False
    force: Annotated[bool, Option(None, "replace the sweep in --out", either=AGAIN)] = False
    address: Annotated[
        str | None,
        Option(
            "ADDRESS",
            "of a Ray cluster whose nodes all have --out, or local: a Ray session of this machine; "
            "default: processes of this machine, without Ray",
            recorded=False,
        ),
    ] = None
    cpus: Annotated[
        int | None, Option("N", "runs at a time; default: this machine's cores", low=1, high=4096)
    ] = None
    json: Json = False

    def run(self) -> int:
        """Do the runs with a progress bar, print the tables. Returns 0; 1 if a run failed."""
        from neuroflight.cli.output import check_folder
        from neuroflight.toolchain.files import claimed
        from neuroflight.training.sweeps.config import load_sweep
        from neuroflight.training.sweeps.run import RECORD, run_sweep
        from neuroflight.training.sweeps.summary import configurations

        cpus = self.cpus if self.cpus is not None else len(os.sched_getaffinity(0))
        check_folder(self.out, "--out")
        plugins = self.load_named()
        sweep = load_sweep(self.file)
        with claimed(self.out, "sweep"), _progress_bars(sweep, self.out) as callback:
            runs = run_sweep(
                sweep,
                self.out,
                cpus=cpus,
                address=self.address,
                resume=self.resume,
                force=self.force,
                command=self.command,
                callback=callback,
                plugins=plugins,
            )
        if self.json:
            print((self.out / RECORD).read_text(), end="")
        else:
            _print(self.out, sweep, runs, configurations(runs))
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


def _print(out: Path, sweep: Sweep, runs: Sequence[Run], found: Sequence[Configuration]) -> None:
    from neuroflight.training.sweeps.run import PLOT, RECORD, TRIALS
    from neuroflight.training.sweeps.summary import unfit

    _print_runs(runs)
    if sweep.validation.thrust:
        title = "MAE, deg/s, and |Δu| of the motors in 1 ms, by thrust at rest over the weight"
        _print_by_thrust(title, runs, _tracking)
        if any(each.current for run in runs if run.outcome for each in run.outcome.thrusts):
            _print_by_thrust(
                "Mean current and electric power, by thrust at rest over the weight", runs, _power
            )
    if any(len(item.runs) > 1 for item in found):
        _print_configurations(found)
    note = "± is 95 % confidence of the mean: of a run over the commands, of a configuration over its seeds."
    if any(item.front for item in found):
        priced = all(item.predicted_cycles is not None for item in found)
        note += f" *: nothing beats it in MAE, |Δu|{' and cycles' if priced else ''}."
    if reason := next((run.outcome.no_cycles_reason for run in runs if run.outcome), None):
        note += f" Cycles or instructions are not known: {reason}"
    for run in runs:
        if run.outcome and (reason := unfit(run.outcome, sweep.board)):
            print(f"{run.trial.folder}: too large for the board: {reason}")
    print(note, f"{out}: {RECORD}, {PLOT}, {TRIALS}/", sep="\n")


def _print_runs(runs: Sequence[Run]) -> None:
    keys = list(runs[0].trial.varied)
    rows: list[tuple[str, ...]] = [("run", *keys, "drift, °", *FIGURES)]
    for run in runs:
        head = (f"{run.trial.number}", *_cells(run.trial.varied, keys))
        done = run.outcome
        if done is None:
            rows.append((*head, run.state, *[""] * len(FIGURES)))
        else:
            rows.append((*head, f"{done.drift.mean:.1f}" if done.drift else "-", *_figures(done)))
    print_table("Runs", rows, numbers=FIGURES)


def _tracking(each: AtThrust) -> str:
    """Return MAE and |Δu| of the motors at a thrust."""
    return f"{each.mae.mean:.2f} {each.change.mean:.4f} ({each.thrust:.2f})"


def _power(each: AtThrust) -> str:
    """Return electric current and power at a thrust."""
    if each.current is None or each.power is None:
        return "-"
    return f"{each.current.mean:.2f} A {each.power.mean:,.1f} W"


def _print_by_thrust(title: str, runs: Sequence[Run], shown: Callable[[AtThrust], str]) -> None:
    """Print a table with a column for each thrust at rest."""
    keys = list(runs[0].trial.varied)
    done = [(run, run.outcome) for run in runs if run.outcome]
    thrusts = done[0][1].thrusts if done else ()
    heads = ["closed" if each.asked is None else f"{each.asked:g}" for each in thrusts]
    rows: list[tuple[str, ...]] = [("run", *keys, *heads)]
    for run, outcome in done:
        rows.append((f"{run.trial.number}", *_cells(run.trial.varied, keys), *map(shown, outcome.thrusts)))
    print_table(f"\n{title}", rows, numbers=heads)


def _print_configurations(found: Sequence[Configuration]) -> None:
    keys = list(found[0].varied)
    rows: list[tuple[str, ...]] = [("", *keys, "seeds", *FIGURES)]
    for place, item in enumerate(found, 1):
        name = f"{place}{'*' if item.front else ' '}"
        rows.append((name, *_cells(item.varied, keys), f"{len(item.runs)}", *_figures(item)))
    print_table("\nConfigurations", rows, numbers=FIGURES)


def _cells(varied: Varied, keys: Sequence[str]) -> list[str]:
    from neuroflight.training.sweeps.config import shown

    return [shown(varied[key]) for key in keys]


def _figures(of: Outcome | Configuration) -> list[str]:
    """Return the cells under FIGURES."""
    means = ((of.mae, 2), (of.mse, 0), (of.output, 3), (of.change, 4))
    return [
        *(f"{each.mean:,.{digits}f} ± {each.margin:,.{digits}f}" for each, digits in means),
        *("-" if count is None else f"{count:,.0f}" for count in (of.instructions, of.predicted_cycles)),
        f"{of.training_seconds:,.0f}",
    ]
