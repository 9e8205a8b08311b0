"""A session at the bench: the runs that a plan still lacks, each kept as soon as it is finished."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

from neuroflight.sim.identification.bench.drive import Clock, Motor, Sensor, drive
from neuroflight.sim.identification.bench.guard import Guard, Limits
from neuroflight.sim.identification.bench.plan import BenchPlan, Run, begin_folder, keep_run, missing_runs
from neuroflight.sim.identification.bench.quantities import Rig
from neuroflight.sim.identification.bench.reduction import reduce_log

Told = Callable[[Run, float, float, float], None]  # run, its elapsed time [s], throttle, rpm


def run_session(
    plan: BenchPlan,
    folder: Path,
    rig: Rig,
    limits: Limits,
    motor: Callable[[], AbstractContextManager[Motor]],
    sensor: Sensor,
    clock: Clock,
    deadline: float = math.inf,
    told: Told = lambda run, elapsed, throttle, rpm: None,
) -> None:
    """Make the runs that `folder` lacks. The motor is stopped after each, also after an error.

    motor: opens it; leaving it stops it. deadline: [s] of `clock`. Raises what stopped a run, which is then
    not kept; those before it are.
    """
    begin_folder(plan, folder)
    for run in missing_runs(plan, folder):
        sensor.settle()
        guard = Guard(rig, limits, clock())

        def tell(elapsed: float, throttle: float, rpm: float, run: Run = run) -> None:
            told(run, elapsed, throttle, rpm)

        with motor() as turning:
            log = drive(turning, sensor, guard, plan.experiment(run.kind), clock, deadline, tell)
        recording, _ = reduce_log(log, rig)
        keep_run(folder, run, recording, log, rig.layout)
