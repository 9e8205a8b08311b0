"""Controllers through a change in flight: a motor loses thrust, a payload is attached, dropped or shifted.

Every episode holds one random command from rest, long enough that it is reached before the change. All
controllers fly the same commands and noise. A controller is told nothing of the change.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.aircraft.payload import Payload, loaded
from neuroflight.sim.arrays import Array
from neuroflight.sim.physics.twin import Twin
from neuroflight.toolchain.contract import AXES, GYRO_FULL_SCALE_DEG_S
from neuroflight.training.evaluation.controllers import AnyController, Conditions
from neuroflight.training.evaluation.evaluation import Event, Flights
from neuroflight.training.tasks.task import EpisodicTask

WINDOW_S = 0.5  # before the change, and at the end
SMOOTH_S = 0.02  # rates are averaged over this before they are compared with the band
BAND_DEG_S, BAND_SHARE = 5.0, 0.1  # recovered: this close to the command, or this share of it
DIVERGED_DEG_S = float(GYRO_FULL_SCALE_DEG_S)
DIVERGENCE = f"a rate beyond {DIVERGED_DEG_S:g} deg/s, which the gyro cannot measure"
RECOVERY = (
    f"a rate, averaged over {1e3 * SMOOTH_S:g} ms, that comes within {BAND_DEG_S:g} deg/s or "
    f"{100 * BAND_SHARE:g} % of its command and stays there to the end"
)


@dataclass(frozen=True)
class Case:
    """A change in flight."""

    name: str
    kind: str  # "none", "motor", "attach", "drop", "shift"
    before: Aircraft
    change: Callable[[Twin], None]


@dataclass(frozen=True)
class FailurePlan:
    """The flights of every controller and case."""

    cases: tuple[Case, ...]
    episodes: int
    seed: int
    at_s: float  # of the change
    after_s: float  # that is flown afterwards
    throttle: float
    limit_deg_s: float  # commands are drawn uniformly from +-this
    noise: bool = True
    yaw_given_up: bool = False


@dataclass(frozen=True, eq=False)
class CaseResult:
    """Results of a controller in a case. Arrays (3,) are of roll, pitch, yaw; means over episodes."""

    case: Case
    before: Array  # [deg/s] MAE of the last WINDOW_S before the change
    after: Array  # [deg/s] MAE from the change to the end
    settled: Array  # [deg/s] MAE of the last WINDOW_S
    peak: Array  # [deg/s] largest error after the change
    recovered: Array  # share of episodes whose axis recovered
    recovery_s: Array  # [s] median of those; NaN: none
    diverged: float  # share of episodes
    traces: Array  # (T, 3) [deg/s] mean |error| over episodes, averaged over SMOOTH_S
    step_s: float

    @property
    def lost(self) -> tuple[str, ...]:
        """The axes that fewer than half of the episodes recover."""
        return tuple(axis for axis, share in zip(AXES, self.recovered, strict=True) if share < 0.5)


@dataclass(frozen=True, eq=False)
class Failure:
    """All cases of one controller."""

    controller: AnyController
    cases: tuple[CaseResult, ...]


def nothing_happens(aircraft: Aircraft) -> Case:
    """Return the case without a change, with which the others are compared."""
    return Case("nothing", "none", aircraft, lambda twin: None)


def motor_loses(aircraft: Aircraft, motor: int, share: float) -> Case:
    """Return the case of `motor`, from 1, that loses `share` of its thrust."""
    shares = np.ones(aircraft.motor_count)
    shares[motor - 1] = 1.0 - share
    return Case(f"motor {motor} loses {100 * share:g} %", "motor", aircraft, lambda twin: twin.weaken(shares))


def payload_attached(aircraft: Aircraft, payload: Payload) -> Case:
    """Return the case of a payload that comes on."""
    after = loaded(aircraft, payload)
    return Case(f"{payload.words} comes on", "attach", aircraft, lambda twin: twin.load(after))


def payload_dropped(aircraft: Aircraft, payload: Payload) -> Case:
    """Return the case of a payload that was on from the start, and goes."""
    return Case(f"{payload.words} goes", "drop", loaded(aircraft, payload), lambda twin: twin.load(aircraft))


def payload_shifted(aircraft: Aircraft, payload: Payload, to: Payload) -> Case:
    """Return the case of a payload that was on from the start, and moves."""
    before, after = loaded(aircraft, payload), loaded(aircraft, to)
    x, y, z = (f"{1e3 * value:g}" for value in to.position)
    return Case(f"{payload.words} moves to {x}, {y}, {z}", "shift", before, lambda twin: twin.load(after))


def examine(
    controller: AnyController, plan: FailurePlan, progress: Callable[[int, int], None] | None = None
) -> Failure:
    """Fly all cases; progress: called with steps done and to do, of all flights together."""
    results = []
    task = EpisodicTask(limit_deg_s=plan.limit_deg_s, hold_s=plan.at_s + plan.after_s)
    for number, case in enumerate(plan.cases):

        def show(done: int, total: int, number: int = number) -> None:
            if progress is not None:
                progress(number * total + done, len(plan.cases) * total)

        flown = Conditions(case.before, task, plan.episodes, plan.seed, noise=plan.noise)
        event = Event(plan.at_s, case.change, plan.yaw_given_up)
        flights = flown.fly(controller, plan.throttle, show, event=event)
        results.append(case_result(case, flights, plan.at_s))
    return Failure(controller, tuple(results))


def case_result(case: Case, flights: Flights, at_s: float) -> CaseResult:
    """Return the figures of recorded flights whose command is held from the start."""
    step_s = flights.step_s
    error = np.rad2deg(flights.rate - flights.setpoint, dtype=np.float64)  # (E, T, 3)
    at, window = round(at_s / step_s), max(1, round(WINDOW_S / step_s))
    size = np.abs(error)
    smooth = np.abs(_averaged(error, max(1, round(SMOOTH_S / step_s))))
    band = np.maximum(BAND_DEG_S, BAND_SHARE * np.abs(np.rad2deg(flights.setpoint[:, -1], dtype=np.float64)))
    outside = smooth[:, at:] > band[:, None]
    count = outside.shape[1]
    # Steps to the end of the last one outside; all of them: never back.
    back = np.where(outside.any(axis=1), count - np.argmax(outside[:, ::-1], axis=1), 0)
    recovered = back < count
    recovery = np.full(3, np.nan)
    for axis in range(3):
        if recovered[:, axis].any():
            recovery[axis] = np.median(back[recovered[:, axis], axis]) * step_s
    spun = ~(np.abs(flights.rate).max(axis=(1, 2)) <= math.radians(DIVERGED_DEG_S))  # NaN included
    return CaseResult(
        case=case,
        before=size[:, max(0, at - window) : at].mean(axis=(0, 1)),
        after=size[:, at:].mean(axis=(0, 1)),
        settled=size[:, -window:].mean(axis=(0, 1)),
        peak=smooth[:, at:].max(axis=1).mean(axis=0),
        recovered=recovered.mean(axis=0),
        recovery_s=recovery,
        diverged=float(spun.mean()),
        traces=smooth.mean(axis=0),
        step_s=step_s,
    )


def _averaged(values: Array, length: int) -> Array:
    """Return the mean over `length` samples up to each, of (E, T, 3); over fewer at the start."""
    sums = np.cumsum(values, axis=1)
    means = sums.copy()
    means[:, length:] -= sums[:, :-length]
    counts = np.minimum(np.arange(1, values.shape[1] + 1), length)
    found: Array = means / counts[None, :, None]
    return found
