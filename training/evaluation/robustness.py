"""Robustness of a controller: its errors on aircraft whose parameters differ from their file.

One parameter at a time is at an extreme, or all are drawn at once. Every case flies the same commands,
throttles and noise as the nominal aircraft, so that a ratio of errors depends on the aircraft alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.analysis.confidence import NORMAL, Mean, mean_of, share_of
from neuroflight.sim.analysis.holding import DRIFT_S
from neuroflight.sim.analysis.metrics import CHANGE_S
from neuroflight.sim.arrays import Array
from neuroflight.sim.physics.variation import Variation
from neuroflight.sim.physics.world import Mount
from neuroflight.toolchain.contract import GYRO_FULL_SCALE_DEG_S
from neuroflight.training.config.randomization import Randomization, Range
from neuroflight.training.config.training_config import WorldConfig
from neuroflight.training.evaluation.controllers import AnyController, Conditions
from neuroflight.training.evaluation.evaluation import Flights
from neuroflight.training.tasks.flight import FlightTask
from neuroflight.training.tasks.task import Task

Progress = Callable[[int, int], None]

# Ranges of an aircraft built to the file; none is measured. Mass, inertia, lag, delay and battery are the
# requirements of this project; thrust and torque are assumed: a worn propeller, or one of another maker.
EXTREMES = Randomization(
    mass=(0.8, 1.2),
    inertia=(0.7, 1.3),
    thrust=(0.8, 1.2),
    torque=(0.8, 1.2),
    lag=(0.5, 2.0),
    noise=(1.0, 3.0),
    delay_s=(0.0, 0.006),
    charge=(0.0, 1.0),
)
SHAKEN_DEG_S = 25.0  # one rotor at full speed; see docs/reference/aircraft.md
CASE_RATIO_MAX = 2.0  # of the nominal error, each parameter at an extreme
MEDIAN_RATIO_MAX = 1.5  # of draws of all parameters at once
HIGH_RATIO_MAX = 2.5
HIGH = 0.95  # quantile of the draws that this bar is for
COMMANDS_PER_DRAW = 5
# An episode diverges if the aircraft turns faster than its gyro can measure, or tracks worse than an aircraft
# that never turns; errors below the floor are no divergence, however small the command.
DIVERGED_RATE = math.radians(GYRO_FULL_SCALE_DEG_S)  # [rad/s]
DIVERGED_FLOOR = 10.0  # [deg/s]
DIVERGED_DRIFT = 90.0  # [deg] in DRIFT_S of centred sticks: the aircraft then lies on its side
DIVERGENCE = (
    "a rate beyond 2000 deg/s on any axis, or an episode's MAE above both 10 deg/s and that of an aircraft "
    "that never turns"
)
FLIGHT_DIVERGENCE = f"{DIVERGENCE}, or a drift of more than {DIVERGED_DRIFT:g} deg in {DRIFT_S:g} s of hover"
FLIGHT = FlightTask(pulses=COMMANDS_PER_DRAW, hover_s=DRIFT_S)  # a draw is one of these


@dataclass(frozen=True)
class Case:
    """An aircraft with one parameter changed; `parameter` is None for the nominal one."""

    parameter: str | None = None
    value: float = 1.0

    @property
    def name(self) -> str:
        """Parameter and value, for tables."""
        if self.parameter is None:
            return "nominal"
        if self.parameter == "delay_s":
            return f"delay {1e3 * self.value:g} ms"
        if self.parameter == "charge":
            named = {0.0: "empty", 1.0: "full"}
            return f"battery {named.get(self.value, f'{100 * self.value:g} %')}"
        if self.parameter == "vibration":
            return f"vibration {math.degrees(self.value):g} deg/s"
        return f"{self.parameter} x {self.value:g}"

    def variation(self, count: int, delay_s: float) -> Variation | None:
        """Return `count` such aircraft; delay_s: the file's."""
        if self.parameter is None:
            return None
        nominal = Variation.nominal(count, delay_s)
        return replace(nominal, **{self.parameter: np.full(count, self.value)})


@dataclass(frozen=True)
class RobustnessPlan:
    """The flights of every controller."""

    aircraft: Aircraft
    task: Task
    episodes: int  # of each case; flights of FLIGHT, or single commands
    draws: int  # of all parameters at once, COMMANDS_PER_DRAW commands each
    seed: int
    throttle_max: float  # the pilot's thrust is drawn uniformly from 0 to this, for each episode
    mount: Mount = Mount.CENTRE
    noise: bool = True

    @property
    def commands(self) -> int:
        """The number of commands of an episode."""
        return self.task.pulses if isinstance(self.task, FlightTask) else 1

    @property
    def divergence(self) -> str:
        """The time at which an episode diverges, in words."""
        return FLIGHT_DIVERGENCE if isinstance(self.task, FlightTask) else DIVERGENCE

    def extremes(self) -> Randomization:
        """Return the varied parameters: the battery only if the aircraft has one that affects its thrust."""
        known = self.aircraft.battery is not None and self.aircraft.propulsion.supply_voltage is not None
        return EXTREMES if known else replace(EXTREMES, charge=None)

    def cases(self) -> list[Case]:
        """Return the nominal case, each parameter at both of its extremes, and an aircraft that shakes."""
        extremes = self.extremes()
        found = [Case()]
        for field in fields(extremes):
            bounds: Range | None = getattr(extremes, field.name)
            for value in bounds or ():
                if value != 1.0 or field.name == "charge":
                    found.append(Case(field.name, value))
        return [*found, Case("vibration", math.radians(SHAKEN_DEG_S))]


@dataclass(frozen=True, eq=False)
class EpisodeFigures:
    """Figures of each episode, (E,)."""

    mae: Array  # [deg/s], mean of the axes
    output: Array  # mean of the controller's
    change: Array  # mean |delta u| in 1 ms
    diverged: NDArray[np.bool_]
    drift: Array | None = None  # [deg] in the hover about the worst axis; None of single commands


@dataclass(frozen=True, eq=False)
class CaseResult:
    """The result of a case."""

    case: Case
    mae: Mean  # [deg/s]
    ratio: Mean  # of it to the nominal aircraft's on the same commands
    output: float
    change: float
    diverged: int  # episodes
    drift: float | None = None  # [deg], mean of the flights' worst axes; None of single commands

    @property
    def met(self) -> bool:
        """True if the ratio is within its bar; the nominal case has no bar."""
        return self.case.parameter is None or bool(self.ratio.value <= CASE_RATIO_MAX)


@dataclass(frozen=True, eq=False)
class JointResult:
    """The result of the draws of all parameters."""

    ratios: Array  # (D,), of each draw's MAE to the nominal aircraft's on the same commands
    median: Mean
    high: Mean  # their HIGH quantile
    change: float
    diverged: int  # draws with an episode that diverged
    diverged_share: Mean
    drift: float | None = None  # as of a case

    @property
    def met(self) -> bool:
        """True if all three bars are met."""
        usual, high = float(self.median.value), float(self.high.value)
        return usual <= MEDIAN_RATIO_MAX and high <= HIGH_RATIO_MAX and self.diverged == 0


@dataclass(frozen=True, eq=False)
class Robustness:
    """All results of one controller."""

    controller: AnyController
    cases: tuple[CaseResult, ...]  # the nominal one first
    joint: JointResult | None  # None without draws


def examine(controller: AnyController, plan: RobustnessPlan, progress: Progress | None = None) -> Robustness:
    """Fly every case and every draw; progress: called with steps done and to do, of all flights together."""
    cases = plan.cases()
    flights = len(cases) + (2 if plan.draws else 0)
    flown = 0

    def fly(seed: int, count: int, variation: Variation | None) -> EpisodeFigures:
        nonlocal flown

        def show(done: int, total: int) -> None:
            if progress is not None:
                progress(flown * total + done, flights * total)

        figures = _fly(controller, plan, seed, count, variation, show)
        flown += 1
        return figures

    delay = plan.aircraft.propulsion.delay
    commands, drawn = (int(part.generate_state(1)[0]) for part in np.random.SeedSequence(plan.seed).spawn(2))
    nominal = fly(commands, plan.episodes, None)
    results = [_case(cases[0], nominal, nominal)]
    for case in cases[1:]:
        varied = fly(commands, plan.episodes, case.variation(plan.episodes, delay))
        results.append(_case(case, varied, nominal))
    joint = None
    if plan.draws:
        flown_by_each = COMMANDS_PER_DRAW // plan.commands
        count = plan.draws * flown_by_each
        draws = plan.extremes().draw(plan.draws, np.random.default_rng(drawn), delay)
        each = draws.at(np.repeat(np.arange(plan.draws), flown_by_each))
        joint = _joint(fly(drawn, count, each), fly(drawn, count, None), plan.draws)
    return Robustness(controller, tuple(results), joint)


def ratio_of(part: Array, whole: Array) -> Mean:
    """Return the ratio of the means of two figures (E,), linearised for its 95 % confidence."""
    ratio = float(part.mean() / whole.mean())
    away = ratio + (part - ratio * whole) / whole.mean()
    return mean_of(away)


def quantile_of(values: Array, q: float) -> Mean:
    """Return the q-quantile of values (D,), 0 < q < 1, its 95 % confidence by order statistics.

    It holds for any distribution: the number of values below the quantile is binomial, here approximated by
    a normal one. With too few values for a bound, the bound is the least or greatest value.
    """
    count = len(values)
    half = NORMAL * math.sqrt(count * q * (1.0 - q))
    places = [math.ceil(count * q) - 1, math.floor(count * q - half) - 1, math.ceil(count * q + half)]
    value, low, high = map(np.array, np.sort(values)[np.clip(places, 0, count - 1)])
    return Mean(value, low, high, np.array(count))


def episode_figures(flights: Flights) -> EpisodeFigures:
    """Return the figures of each episode; of a flight, those of its commands, and the drift in its hover."""
    stride = max(1, round(CHANGE_S / flights.step_s))
    holding, rows = flights.holding(), flights.commanded
    drift = None if holding is None else np.abs(holding.drift).max(axis=1)
    mae, output, change, diverged = [], [], [], []
    for number, (setpoint, turned, y) in enumerate(
        zip(flights.setpoint, flights.rate, flights.output, strict=True)
    ):
        wanted, rate = setpoint[rows], turned[rows]
        error = np.rad2deg(np.abs(wanted - rate, dtype=np.float64)).mean()
        still = np.rad2deg(np.abs(wanted, dtype=np.float64)).mean()
        mae.append(error)
        output.append(y[rows].mean(dtype=np.float64))
        change.append(np.abs(np.diff(y[rows][::stride], axis=0)).mean(dtype=np.float64))
        spun = not np.abs(turned).max() <= DIVERGED_RATE  # NaN included
        drifted = drift is not None and not drift[number] <= DIVERGED_DRIFT
        diverged.append(spun or drifted or error > max(still, DIVERGED_FLOOR))
    return EpisodeFigures(np.array(mae), np.array(output), np.array(change), np.array(diverged), drift)


def _fly(
    controller: AnyController,
    plan: RobustnessPlan,
    seed: int,
    count: int,
    variation: Variation | None,
    progress: Progress,
) -> EpisodeFigures:
    conditions = Conditions(plan.aircraft, plan.task, count, seed, mount=plan.mount, noise=plan.noise)
    throttle = WorldConfig(throttle_max=plan.throttle_max).draw_throttle(count, np.random.default_rng(seed))
    return episode_figures(conditions.fly(controller, throttle, progress, variation))


def _case(case: Case, varied: EpisodeFigures, nominal: EpisodeFigures) -> CaseResult:
    return CaseResult(
        case=case,
        mae=mean_of(varied.mae),
        ratio=ratio_of(varied.mae, nominal.mae),
        output=float(varied.output.mean()),
        change=float(varied.change.mean()),
        diverged=int(varied.diverged.sum()),
        drift=None if varied.drift is None else float(varied.drift.mean()),
    )


def _joint(varied: EpisodeFigures, nominal: EpisodeFigures, draws: int) -> JointResult:
    mae, usual = (figures.mae.reshape(draws, -1).mean(axis=1) for figures in (varied, nominal))
    ratios = mae / usual
    diverged: NDArray[np.bool_] = np.any(varied.diverged.reshape(draws, -1), axis=1)
    return JointResult(
        ratios=ratios,
        median=quantile_of(ratios, 0.5),
        high=quantile_of(ratios, HIGH),
        change=float(varied.change.mean()),
        diverged=int(diverged.sum()),
        diverged_share=share_of(diverged),
        drift=None if varied.drift is None else float(varied.drift.mean()),
    )
