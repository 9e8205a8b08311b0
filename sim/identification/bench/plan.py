"""The plan of a bench: steps and ramps of throttle, repeats, and the runs present or missing in a folder."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from neuroflight.sim.arrays import Array
from neuroflight.sim.identification.bench.drive import Log
from neuroflight.sim.identification.bench.sensor import Layout
from neuroflight.sim.identification.dyno.bench import Phase, duration, ramp, steps_held
from neuroflight.sim.identification.dyno.recording import (
    ROWS_MAX,
    Recording,
    read_recordings,
    write_recording,
)
from neuroflight.toolchain.errors import DynoError
from neuroflight.toolchain.files import file_size, write_text

REPEATS = 20  # Koch 2019, chapter 5, of the ramp
HOLD_S, RAMP_S = 1.0, 40.0  # [s], each level and the rest after it; up and down; Koch 2019, chapter 5

APART_S = 2.0  # [s] between two runs in one file; `dyno fit` takes 0.5 s for the beginning of another
PLAN_FILE = "plan.json"
PLAN_BYTES_MAX = 64 << 10


@dataclass(frozen=True)
class Run:
    """One repeat of one experiment."""

    kind: str  # of KINDS
    number: int  # from 1

    @property
    def name(self) -> str:
        """Name of its files."""
        return f"{self.kind}-{self.number:02d}"


@dataclass(frozen=True)
class BenchPlan:
    """The plan: everything that repeats must have in common."""

    kinds: tuple[str, ...]
    repeats: int
    limit: float  # throttle that the largest level and the top of the ramp are, 0..1
    hold_s: float
    ramp_s: float
    motor: int  # from 1
    blades: int
    window_s: float
    columns: tuple[str, ...]  # of the sensor
    cells: dict[str, dict[str, float | str]]  # load cells, by column

    def runs(self) -> tuple[Run, ...]:
        """Return the runs in order: the experiments alternate, so that a battery ages alike in all."""
        return tuple(Run(kind, number + 1) for number in range(self.repeats) for kind in self.kinds)

    def experiment(self, kind: str) -> tuple[Phase, ...]:
        """Return the phases of one run; the rest before takes the zeros of load cells."""
        return steps_held(self.hold_s, self.limit) if kind == "steps" else ramp(self.ramp_s, self.limit)

    def seconds(self, runs: Sequence[Run]) -> float:
        """Return the duration of these runs [s]."""
        return sum(duration(self.experiment(run.kind)) for run in runs)


def recording_file(folder: Path, run: Run) -> Path:
    """Return the file of a finished run, as `dyno fit` reads it."""
    return folder / f"{run.name}.csv"


def missing_runs(plan: BenchPlan, folder: Path) -> tuple[Run, ...]:
    """Return the runs that are not in `folder`."""
    return tuple(run for run in plan.runs() if not recording_file(folder, run).is_file())


def check_folder(plan: BenchPlan, folder: Path, resume: bool) -> None:
    """Raise DynoError if runs of `folder` would be lost, or belong to another plan."""
    path = folder / PLAN_FILE
    if not path.is_file():
        if resume:
            raise DynoError(f"{folder}: no run to resume stands there; leave --resume out")
        return
    if not resume:
        raise DynoError(
            f"{folder} holds {len(plan.runs()) - len(missing_runs(plan, folder))} finished runs; go on with "
            f"--resume, remove it, or choose another --out"
        )
    before = _read_plan(path)
    now = json.loads(_plan_text(plan))
    different = [name for name in now if before.get(name) != now[name] and name not in ("repeats", "kinds")]
    if different:
        name = different[0]
        raise DynoError(
            f"{path}: {name} was {str(before.get(name))[:200]}, is {str(now[name])[:200]}, expected the same "
            f"for all repeats; give what was given then, or choose another --out"
        )


def begin_folder(plan: BenchPlan, folder: Path) -> None:
    """Create the folder and write the plan into it."""
    write_text(folder / PLAN_FILE, _plan_text(plan))


def keep_run(folder: Path, run: Run, recording: Recording, log: Log, layout: Layout) -> None:
    """Write what came and what was sent, and last, as it says that the run is finished, the recording."""
    _write_rows(folder / f"{run.name}.sensor.csv", ("arrival_s", *layout.names), log.arrival, log.values)
    _write_rows(
        folder / f"{run.name}.commands.csv", ("time_s", "throttle"), log.command_time, log.throttle[:, None]
    )
    write_recording(recording_file(folder, run), recording)


def read_runs(folder: Path, runs: Sequence[Run]) -> list[Recording]:
    """Read the recordings of finished runs."""
    return [read_recordings([recording_file(folder, run)]) for run in runs]


def joined(recordings: Sequence[Recording]) -> Recording:
    """Join recordings, each a run of its own. Raises DynoError if `dyno fit` could not read the result."""
    times, starts, end, rows = [], [], 0.0, 0
    for recording in recordings:
        times.append(recording.time - recording.time[0] + end)
        end = float(times[-1][-1]) + APART_S
        starts.append(rows)
        rows += len(recording.time)
    if rows > ROWS_MAX:
        raise DynoError(f"{rows} rows in all, expected at most {ROWS_MAX}; fit fewer of the single runs")
    throttle, speed, thrust, torque = (
        np.concatenate([getattr(recording, name) for recording in recordings])
        for name in ("throttle", "speed", "thrust", "torque")
    )
    return Recording(np.concatenate(times), throttle, speed, thrust, torque, tuple(starts))


def _plan_text(plan: BenchPlan) -> str:
    return json.dumps(asdict(plan), indent=2) + "\n"


def _read_plan(path: Path) -> dict[str, object]:
    try:
        if file_size(path) > PLAN_BYTES_MAX:
            raise ValueError("too large")
        document = json.loads(path.read_text("utf-8"))
        if not isinstance(document, dict):
            raise ValueError("not a table")
    except ValueError as error:  # JSON's and UTF-8's errors are some
        raise DynoError(f"{path}: damaged ({' '.join(str(error).split())}); choose another --out") from error
    return document


def _write_rows(path: Path, names: Sequence[str], time: Array, values: Array) -> None:
    """Write times, (N,), beside values, (N, C)."""
    lines = [",".join(names)]
    lines += [
        ",".join([f"{t:.6f}", *(f"{value:.10g}" for value in row)])
        for t, row in zip(time.tolist(), values.tolist(), strict=True)
    ]
    write_text(path, "\n".join(lines) + "\n")
