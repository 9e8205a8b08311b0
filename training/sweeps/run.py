"""Runs a sweep, from its first run to its plot; finished runs are not repeated."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

from neuroflight.sim.plotting import save_png
from neuroflight.toolchain.errors import TrainingError
from neuroflight.toolchain.files import write_text
from neuroflight.training.plugins import Plugin
from neuroflight.training.sweeps import process_workers, ray_workers
from neuroflight.training.sweeps.config import Sweep
from neuroflight.training.sweeps.jobs import STOP, Job, SweepCallback, clear_stop
from neuroflight.training.sweeps.plot import draw_sweep
from neuroflight.training.sweeps.power_plot import draw_power
from neuroflight.training.sweeps.summary import Run, configurations, document
from neuroflight.training.sweeps.trial import read_outcome

RECORD = "sweep.json"
PLOT = "sweep.png"
POWER = "power.png"
TRIALS = "trials"


def run_sweep(
    sweep: Sweep,
    out: Path,
    *,
    cpus: int,
    address: str | None = None,
    resume: bool = False,
    force: bool = False,
    command: str = "",
    callback: SweepCallback | None = None,
    plugins: tuple[Plugin, ...] = (),
) -> tuple[Run, ...]:
    """Do the unfinished runs; `out`/sweep.json is written after each, sweep.png at the end.

    cpus: runs at a time. address: of a Ray cluster, whose nodes all see `out`, or `ray_workers.LOCAL` for a
    Ray session of this machine; None: processes of this machine, without Ray. force: remove the runs that
    `out` holds. plugins: the users' files that the sweep was read with.
    Raises TrainingError if `out` holds a sweep already and neither `resume` nor `force` is given, or
    holds another; KeyboardInterrupt if it was stopped, see `jobs.request_stop`.
    """
    if address is not None:
        ray_workers.check_ray()
    keeper = Keeper(sweep, out, command, callback or SweepCallback())
    if force and (out / TRIALS).exists():
        shutil.rmtree(out / TRIALS)
    if not resume and (out / TRIALS).exists():
        raise TrainingError(
            f"{out} already holds a sweep; add --resume to go on with it, --force to replace it, or choose "
            f"another"
        )
    if resume:
        keeper.read()
    jobs = [
        Job(run.trial, sweep.aircraft, sweep.validation, keeper.folder(run).resolve(), plugins)
        for run in keeper.runs
        if run.outcome is None
    ]
    keeper.write()
    if not jobs:
        keeper.draw()
        return tuple(keeper.runs)
    clear_stop(out)
    try:
        if address is None:
            process_workers.run_jobs(jobs, out.resolve(), cpus, keeper)
        else:
            with ray_workers.ray_session(address, cpus):
                ray_workers.run_jobs(jobs, out.resolve(), cpus, keeper)
        stopped = (out / STOP).exists()
    finally:
        clear_stop(out)
        keeper.read()
        keeper.write()
        keeper.draw()
    if stopped:
        raise KeyboardInterrupt
    return tuple(keeper.runs)


class Keeper(SweepCallback):
    """A callback that keeps the record of a sweep, and passes calls on to another callback."""

    def __init__(self, sweep: Sweep, out: Path, command: str, callback: SweepCallback) -> None:
        self.runs = [Run(trial) for trial in sweep.trials]
        self._sweep, self._out, self._command, self._callback = sweep, out, command, callback

    def folder(self, run: Run) -> Path:
        """Return the folder of a run's results."""
        return self._out / TRIALS / run.trial.folder

    def read(self) -> None:
        """Read the existing results. Raises TrainingError if one is of another sweep."""
        for index in range(len(self.runs)):
            self._read(index)

    def write(self) -> None:
        """Write sweep.json."""
        content = document(self._sweep, self.runs, self._command)
        write_text(self._out / RECORD, json.dumps(content, indent=2) + "\n")

    def draw(self) -> None:
        """Write sweep.png, if a run is finished, and power.png, if one was flown at equal thrust."""
        if found := configurations(self.runs):
            title = f"Sweep {self._sweep.name} on {self._sweep.aircraft.name}"
            save_png(self._out / PLOT, draw_sweep(found, title, self._sweep.validation))
            if power := draw_power(self.runs, title, self._sweep.validation):
                save_png(self._out / POWER, power)

    def progressed(self, number: int, steps: int, reward: float, pid: int) -> None:
        self._callback.progressed(number, steps, reward, pid)

    def finished(self, number: int) -> None:
        self._read(number - 1)
        self.write()
        self._callback.finished(number)

    def restarted(self, number: int) -> None:
        self._callback.restarted(number)

    def failed(self, number: int, reason: str) -> None:
        self.runs[number - 1] = replace(self.runs[number - 1], reason=reason)
        self.write()
        self._callback.failed(number, reason)

    def _read(self, index: int) -> None:
        run, sweep = self.runs[index], self._sweep
        outcome = read_outcome(self.folder(run), run.trial, sweep.aircraft, sweep.validation)
        self.runs[index] = replace(run, outcome=outcome)
