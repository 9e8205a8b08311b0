"""The work of any kind of worker: a run in its folder, progress to the callback, a stop on request."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.toolchain.errors import NeuroflightError
from neuroflight.training.plugins import Plugin, load_plugins
from neuroflight.training.runs.checkpoint import Policy
from neuroflight.training.runs.train import Callback, Progress
from neuroflight.training.sweeps.config import Trial, Validation
from neuroflight.training.sweeps.trial import run_trial

FAILURES_MAX = 3  # restarts of a run after its worker died
REPORT_S = 1.0  # between two reports of a run
STOP = "stop"  # a file of this name in the sweep's folder makes runs save their last segment and end

Report = Callable[[int, float], None]  # steps trained, reward


class SweepCallback:
    """Called while a sweep goes on; a subclass overrides what it needs."""

    def progressed(self, number: int, steps: int, reward: float, pid: int) -> None:
        """Take the steps that run `number` has trained in the process `pid`; about once in REPORT_S."""

    def finished(self, number: int) -> None:
        """Take the result of run `number`."""

    def restarted(self, number: int) -> None:
        """Note that the worker of run `number` died; another worker resumes it from its last checkpoint."""

    def failed(self, number: int, reason: str) -> None:
        """Note that run `number` was given up."""


@dataclass(frozen=True)
class Job:
    """The task of a worker: a run and the folder of its results."""

    trial: Trial
    aircraft: Aircraft
    validation: Validation
    folder: Path
    plugins: tuple[Plugin, ...] = ()  # whose rewards and tasks the run may name


@dataclass(frozen=True)
class End:
    """The end of a worker's run."""

    finished: bool = False
    reason: str = ""  # why it failed; empty if it was stopped


def request_stop(out: Path) -> None:
    """Make the runs of a sweep save their state and end."""
    (out / STOP).touch()


def clear_stop(out: Path) -> None:
    """Take back `request_stop`."""
    (out / STOP).unlink(missing_ok=True)


def do(job: Job, out: Path, report: Report) -> End:
    """Do a run, or the rest of it, unless the sweep in `out` is to stop.

    NeuroflightErrors are returned in the run's End; any other exception is raised.
    """
    if (out / STOP).exists():
        return End()
    try:
        load_plugins([plugin.path for plugin in job.plugins])
        run_trial(job.trial, job.aircraft, job.validation, job.folder, _Reporter(out / STOP, report))
    except KeyboardInterrupt:
        return End()
    except NeuroflightError as error:
        return End(reason=str(error))
    return End(finished=True)


class _Reporter(Callback):
    """A callback that reports progress, checkpoints without delay, and ends the run on request."""

    def __init__(self, stop: Path, report: Report) -> None:
        self._stop, self._report = stop, report
        self._next = time.monotonic()

    def progressed(self, progress: Progress) -> None:
        """See Callback. Raises KeyboardInterrupt if the sweep is to stop."""
        if self._stop.exists():
            raise KeyboardInterrupt
        if time.monotonic() >= self._next:
            self._tell(progress)

    def checkpointed(self, progress: Progress, policy: Policy) -> None:
        self._tell(progress)

    def _tell(self, progress: Progress) -> None:
        self._report(progress.steps, progress.reward)
        self._next = time.monotonic() + REPORT_S
