"""Suite `robustness`: errors of controllers on aircraft whose parameters differ from their file."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any

from neuroflight.cli.compare.controllers import check_ranges
from neuroflight.cli.compare.suite import Bar, Mounted, NoNoise, Suite, SuiteResult
from neuroflight.cli.report import Table, with_margin
from neuroflight.cli.requests import Option

if TYPE_CHECKING:
    from neuroflight.training.evaluation.robustness import CaseResult, JointResult, Robustness, RobustnessPlan

EPISODES = {"flight": 50, "pulse": 200}  # commands of a case by task, the first unless the user says
DRAWS = {"flight": 100, "pulse": 200}
FLIGHTS_MAX = 300  # at once, in memory: a gigabyte


@dataclass(frozen=True, kw_only=True)
class RobustnessSuite(Suite):
    """Errors on aircraft whose parameters differ from their file."""

    names = ("robustness",)

    task: Annotated[
        str,
        Option(
            None, "five commands in a flight and a hover (default), or single ones", choices=tuple(EPISODES)
        ),
    ] = "flight"
    episodes: Annotated[int | None, Option("N", "commands a case; default: 50 in flights, 200 pulses")] = None
    seed: Annotated[int, Option("S", "of commands, throttle, noise, draws", low=0)] = 0
    throttle_max: Annotated[
        float, Option("T", "the thrust is drawn from 0 to this; default: 0.8", low=0.0, high=1.0)
    ] = 0.8
    draws: Annotated[
        int | None,
        Option("N", "aircraft with every parameter drawn at once; default: 100 in flights, 200 of pulses"),
    ] = None
    mount: Mounted = None
    no_noise: NoNoise = False

    def fly(self, bar: Bar, ends: ExitStack) -> SuiteResult:
        """Fly the plan with each controller."""
        from neuroflight.training.evaluation.robustness import examine
        from neuroflight.training.evaluation.robustness_plot import draw_robustness

        plan = self._plan()
        controllers = self.opened(plan.aircraft, ends)
        results = [examine(each, plan, bar(each.label)) for each in controllers]
        each = "pulses" if plan.commands == 1 else f"flights of {plan.commands} commands and a hover"
        title = (
            f"Robustness on {plan.aircraft.name}: {plan.episodes} {each} a case, throttle 0 to "
            f"{plan.throttle_max:g}, seed {plan.seed}"
        )
        return SuiteResult(
            request=replace(self, episodes=plan.episodes * plan.commands, draws=plan.draws),
            aircraft=plan.aircraft,
            document=lambda: {"robustness": _document(plan, results)},
            tables=lambda: [Table(title, list(_rows(plan, results)), _note(plan))],
            pictures={"plot": lambda: draw_robustness(results, title)},
        )

    def _plan(self) -> RobustnessPlan:
        """Return the cases to fly. Raises TrainingError on values outside the range that the task allows."""
        from neuroflight.sim.aircraft.model import load_aircraft
        from neuroflight.sim.physics.world import COUNT_MAX, Mount
        from neuroflight.training.evaluation.robustness import COMMANDS_PER_DRAW, FLIGHT, RobustnessPlan
        from neuroflight.training.tasks.task import PulseTask

        commands = EPISODES[self.task] if self.episodes is None else self.episodes
        draws = DRAWS[self.task] if self.draws is None else self.draws
        flights = self.task == "flight"
        check_ranges(
            ("--episodes", commands, 2, FLIGHTS_MAX * FLIGHT.pulses if flights else COUNT_MAX),
            ("--draws", draws, 0, FLIGHTS_MAX if flights else COUNT_MAX // COMMANDS_PER_DRAW),
        )
        return RobustnessPlan(
            aircraft=load_aircraft(self.aircraft),
            task=FLIGHT if flights else PulseTask(),
            episodes=max(2, -(-commands // FLIGHT.pulses)) if flights else commands,
            draws=draws,
            seed=self.seed,
            throttle_max=self.throttle_max,
            mount=Mount(self.mount or "centre"),
            noise=not self.no_noise,
        )


def _document(plan: RobustnessPlan, results: Sequence[Robustness]) -> dict[str, Any]:
    from neuroflight.training.evaluation.robustness import (
        CASE_RATIO_MAX,
        COMMANDS_PER_DRAW,
        HIGH,
        HIGH_RATIO_MAX,
        MEDIAN_RATIO_MAX,
    )

    return {
        "task": plan.task.name,
        "episodes": plan.episodes * plan.commands,
        "seed": plan.seed,
        "throttle_max": plan.throttle_max,
        "mount": plan.mount.value,
        "noise": plan.noise,
        "delay_s": plan.aircraft.propulsion.delay,
        "draws": plan.draws,
        "commands_per_draw": COMMANDS_PER_DRAW,
        "extremes": {name: bounds for name, bounds in asdict(plan.extremes()).items() if bounds},
        "divergence": plan.divergence,
        "bars": {"case": CASE_RATIO_MAX, "median": MEDIAN_RATIO_MAX, "high": HIGH_RATIO_MAX},
        "high_quantile": HIGH,
        "controllers": [
            {
                "controller": each.controller.name,
                "label": each.controller.label,
                **each.controller.facts,
                "idle": each.controller.idle,
                "control_rate_hz": each.controller.control_rate_hz,
                "cases": {flown.case.name: _case_document(flown) for flown in each.cases},
                "joint": each.joint and _joint_document(each.joint),
            }
            for each in results
        ],
    }


def _case_document(flown: CaseResult) -> dict[str, Any]:
    return {
        "parameter": flown.case.parameter,
        "value": flown.case.value if flown.case.parameter else None,
        "mae": flown.mae.document(),
        "ratio": flown.ratio.document(),
        "output": flown.output,
        "change": flown.change,
        "diverged": flown.diverged,
        "met": flown.met,
        **_drift(flown),
    }


def _joint_document(joint: JointResult) -> dict[str, Any]:
    return {
        "median": joint.median.document(),
        "high": joint.high.document(),
        "change": joint.change,
        "diverged": joint.diverged,
        "diverged_share": joint.diverged_share.document(),
        "ratios": [round(float(ratio), 4) for ratio in joint.ratios],
        "met": joint.met,
        **_drift(joint),
    }


def _drift(flown: CaseResult | JointResult) -> dict[str, float]:
    return {} if flown.drift is None else {"drift": flown.drift}


def _rows(plan: RobustnessPlan, results: Sequence[Robustness]) -> Iterator[tuple[str, ...]]:
    """Yield the heading, the nominal aircraft, each case and the draws; two or three columns a controller."""
    from neuroflight.training.evaluation.robustness import CASE_RATIO_MAX, HIGH_RATIO_MAX, MEDIAN_RATIO_MAX

    beside = ("|Δu|", "drift, °") if plan.commands > 1 else ("|Δu|",)
    yield ("", "bar", *(word for each in results for word in (each.controller.label, *beside)))
    first = [result.cases[0] for result in results]
    errors = [with_margin(float(each.mae.value), float(each.mae.high - each.mae.value), 2) for each in first]
    yield ("nominal, MAE deg/s", "", *_paired(errors, first))
    for row in zip(*(result.cases[1:] for result in results), strict=True):
        cells = []
        for each in row:
            lost = f" [{each.diverged} diverged]" if each.diverged else ""
            margin = _ratio(float(each.ratio.high - each.ratio.value))
            cells.append(f"{'' if each.met else '!'}{_ratio(float(each.ratio.value))} ± {margin}{lost}")
        yield (row[0].case.name, f"{CASE_RATIO_MAX:g}", *_paired(cells, row))
    drawn = [result.joint for result in results if result.joint]
    if not drawn:
        return
    for name, bar, means in (
        (f"median of {len(drawn[0].ratios)} draws", MEDIAN_RATIO_MAX, [each.median for each in drawn]),
        ("95th percentile", HIGH_RATIO_MAX, [each.high for each in drawn]),
    ):
        quantiles = [
            f"{'' if mean.value <= bar else '!'}{_ratio(float(mean.value))} "
            f"({_ratio(float(mean.low))} to {_ratio(float(mean.high))})"
            for mean in means
        ]
        yield (name, f"{bar:g}", *_paired(quantiles, drawn))
    shares = [f"{each.diverged} (≤ {100 * each.diverged_share.high:.1f} %)" for each in drawn]
    yield ("diverged of the draws", "0", *(text for cell in shares for text in (cell, *("" for _ in beside))))


def _note(plan: RobustnessPlan) -> str:
    from neuroflight.sim.physics.world import Mount

    drift = " Drift: in degrees in the hover about the worst axis, mean of the flights."
    held = " Held at its centre, an aircraft's mass has no part." if plan.mount is Mount.CENTRE else ""
    return (
        f"Ratios of MAE to the nominal aircraft's on the same commands, with 95 % confidence; ! misses its "
        f"bar. Divergence: {plan.divergence}.{drift if plan.commands > 1 else ''}{held}"
    )


def _paired(cells: Sequence[str], results: Sequence[CaseResult | JointResult]) -> list[str]:
    """Return each cell with its |delta u| beside it, and the drift of flights."""
    found = []
    for text, each in zip(cells, results, strict=True):
        found += [text, f"{each.change:.4f}"]
        if each.drift is not None:
            found.append(f"{each.drift:.1f}")
    return found


def _ratio(value: float) -> str:
    return f"{value:.2f}" if value < 100 else f"{value:.3g}"
