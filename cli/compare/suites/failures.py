"""Suite `failures`: controllers through a change in flight, of a motor's thrust or of a payload."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

from neuroflight.cli.compare.controllers import check_ranges, is_betaflight
from neuroflight.cli.compare.suite import Bar, NoNoise, Seed, Suite, SuiteResult
from neuroflight.cli.report import Table
from neuroflight.cli.requests import Option
from neuroflight.toolchain.contract import AXES
from neuroflight.toolchain.errors import TrainingError

if TYPE_CHECKING:
    from neuroflight.sim.aircraft.model import Aircraft
    from neuroflight.training.evaluation.failure import Case, CaseResult, Failure, FailurePlan

CASES_MAX = 12
MOTOR_CASES = (0.25, 0.5, 1.0)  # of motor 1, unless cases are given
Cases = tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Failures(Suite):
    """Errors through a motor that fails, or a payload that comes, goes or shifts in flight."""

    names = ("failures",)

    fail: Annotated[
        Cases,
        Option(
            "MOTOR=SHARE", "a motor loses this share of its thrust; default: 1=0.25, 1=0.5, 1=1", once=True
        ),
    ] = ()
    payload: Annotated[
        Cases, Option("GRAMS@X,Y,Z", "a payload comes on at this place of the body frame [m]", once=True)
    ] = ()
    drop: Annotated[Cases, Option("GRAMS@X,Y,Z", "a payload carried from the start goes", once=True)] = ()
    shift: Annotated[
        Cases, Option("GRAMS@X,Y,Z:X,Y,Z", "a payload carried from the start moves there", once=True)
    ] = ()
    at: Annotated[float, Option("S", "of the change; default: 1", low=0.1, high=60.0)] = 1.0
    after: Annotated[float, Option("S", "flown after it; default: 2", low=0.5, high=60.0)] = 2.0
    episodes: Annotated[int, Option("N", "commands a case; default: 50")] = 50
    seed: Seed = 0
    throttle: Annotated[float, Option("T", "pilot's thrust; default: 0.4", low=0.0, high=1.0)] = 0.4
    limit: Annotated[
        float,
        Option(
            "DEG_S",
            "greatest command of an axis; default: 200",
            low=0.0,
            high=500.0,
            name="--max-rate",
            old=("--limit",),
        ),
    ] = 200.0
    give_up_yaw: Annotated[
        bool, Option(None, "after the change the commanded yaw rate is the measured one")
    ] = False
    no_noise: NoNoise = False

    def fly(self, bar: Bar, ends: ExitStack) -> SuiteResult:
        """Fly all cases with each controller."""
        from neuroflight.sim.aircraft.model import load_aircraft
        from neuroflight.sim.physics.world import COUNT_MAX
        from neuroflight.training.evaluation.failure import FailurePlan, examine
        from neuroflight.training.evaluation.failure_plot import draw_failures

        check_ranges(("--episodes", self.episodes, 1, COUNT_MAX))
        if self.give_up_yaw and any(map(is_betaflight, self.controllers)):
            raise TrainingError("--give-up-yaw: Betaflight cannot be told to; fly policies and PIDs")
        aircraft = load_aircraft(self.aircraft)
        plan = FailurePlan(
            cases=_cases(self, aircraft),
            episodes=self.episodes,
            seed=self.seed,
            at_s=self.at,
            after_s=self.after,
            throttle=self.throttle,
            limit_deg_s=self.limit,
            noise=not self.no_noise,
            yaw_given_up=self.give_up_yaw,
        )
        results = [examine(each, plan, bar(each.label)) for each in self.opened(aircraft, ends)]
        title = f"A change in flight, {aircraft.name}: {plan.episodes} commands, throttle {plan.throttle:g}"
        return SuiteResult(
            request=self,
            aircraft=aircraft,
            document=lambda: {"failure": _document(plan, results)},
            tables=lambda: [Table(title, list(_rows(plan, results)), _note())],
            pictures={"plot": lambda: draw_failures(results, plan.at_s, title)},
        )


def _cases(asked: Failures, aircraft: Aircraft) -> tuple[Case, ...]:
    """Return the cases asked for, after one in which nothing happens. Raises NeuroflightError."""
    from neuroflight.sim.aircraft.payload import parse_payload
    from neuroflight.training.evaluation.failure import (
        motor_loses,
        nothing_happens,
        payload_attached,
        payload_dropped,
        payload_shifted,
    )

    found = [motor_loses(aircraft, *_loss(text, aircraft)) for text in asked.fail]
    found += [payload_attached(aircraft, parse_payload(text)) for text in asked.payload]
    found += [payload_dropped(aircraft, parse_payload(text)) for text in asked.drop]
    for text in asked.shift:
        start, _, place = text.partition(":")
        to = parse_payload(f"{start.partition('@')[0]}@{place}")
        found.append(payload_shifted(aircraft, parse_payload(start), to))
    if not found:
        found = [motor_loses(aircraft, 1, share) for share in MOTOR_CASES]
    names = {case.name for case in found}
    if len(names) < len(found) or len(found) > CASES_MAX:
        raise TrainingError(
            f"{len(found)} cases, {len(names)} of them different, expected 1 to {CASES_MAX} different ones"
        )
    return (nothing_happens(aircraft), *found)


def _loss(text: str, aircraft: Aircraft) -> tuple[int, float]:
    motor, _, share = text.partition("=")
    try:
        found = int(motor), float(share)
    except ValueError:
        found = 0, 0.0
    if not (1 <= found[0] <= aircraft.motor_count and 0.0 < found[1] <= 1.0):
        raise TrainingError(
            f"--fail {text}: expected MOTOR=SHARE, a motor of 1 to {aircraft.motor_count} and a share "
            "above 0 to 1, such as 1=0.5"
        )
    return found


def _document(plan: FailurePlan, results: Sequence[Failure]) -> dict[str, Any]:
    from neuroflight.training.evaluation.failure import DIVERGENCE, RECOVERY

    return {
        "episodes": plan.episodes,
        "seed": plan.seed,
        "at_s": plan.at_s,
        "after_s": plan.after_s,
        "throttle": plan.throttle,
        "limit_deg_s": plan.limit_deg_s,
        "noise": plan.noise,
        "yaw_given_up": plan.yaw_given_up,
        "recovery": RECOVERY,
        "divergence": DIVERGENCE,
        "controllers": {
            each.controller.name: {
                "controller": each.controller.name,
                "label": each.controller.label,
                **each.controller.facts,
                "cases": {flown.case.name: _case_document(flown) for flown in each.cases},
            }
            for each in results
        },
    }


def _case_document(flown: CaseResult) -> dict[str, Any]:
    return {
        "kind": flown.case.kind,
        **{name: _by_axis(getattr(flown, name)) for name in ("before", "after", "settled", "peak")},
        "recovered_share": _by_axis(flown.recovered),
        "recovery_s": _by_axis(flown.recovery_s),
        "lost_axes": list(flown.lost),
        "diverged_share": flown.diverged,
    }


def _by_axis(values: Any) -> dict[str, float | None]:  # noqa: ANN401 - an array
    return {axis: float(x) if x == x else None for axis, x in zip(AXES, values, strict=True)}


def _rows(plan: FailurePlan, results: Sequence[Failure]) -> Iterator[tuple[str, ...]]:
    """Yield the heading, then each case with a row for each controller."""
    heading = ("before", "after", "at the end", "back in s", "of episodes", "diverged")
    yield ("", *heading)
    for number, case in enumerate(plan.cases):
        yield (case.name, *("" for _ in heading))
        for result in results:
            flown = result.cases[number]
            yield (
                f"  {result.controller.label}",
                *(_three(values, "{:.1f}") for values in (flown.before, flown.after, flown.settled)),
                _three(flown.recovery_s, "{:.2f}"),
                _three(100 * flown.recovered, "{:.0f}"),
                f"{100 * flown.diverged:.0f} %",
            )


def _note() -> str:
    from neuroflight.training.evaluation.failure import DIVERGENCE, RECOVERY

    return (
        f"Roll / pitch / yaw. Mean errors in deg/s: of the half second before the change, from it to the "
        f"end, of the last half second. Back: {RECOVERY}; the median, and the share [%] of episodes. "
        f"Diverged: {DIVERGENCE}."
    )


def _three(values: Any, form: str) -> str:  # noqa: ANN401 - an array
    return " / ".join("-" if value != value else form.format(value) for value in values)
