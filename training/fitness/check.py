"""The check that a policy is fit to fly an aircraft: flies it and its references, and applies the bars."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.design.figures import aircraft_figures
from neuroflight.toolchain.policy.check_stamp import stamp_document
from neuroflight.training.evaluation.controllers import load_controller
from neuroflight.training.fitness.bars import Bar, bars
from neuroflight.training.fitness.course import SEED, CommandFlight
from neuroflight.training.fitness.flying import CommandFigures, CourseFigures, Progress, fly_course
from neuroflight.training.fitness.references import References

WORDS_MAX = 3  # most reasons that a bar states, the worst first


@dataclass(frozen=True)
class Verdict:
    """The result of a check."""

    policy_sha256: str
    aircraft: Aircraft
    references: tuple[CourseFigures, ...]
    missing: tuple[str, ...]  # references that could not be flown, and why
    bars: tuple[Bar, ...]
    flights: dict[CommandFlight, CommandFigures]  # of the policy

    @property
    def above_least(self) -> list[tuple[str, float, float]]:
        """Segments, with the relative excess of their MAE and MSE over the least that motors allow."""
        return [
            (flight.name, own.mae / own.mae_least - 1.0, own.mse / own.mse_least - 1.0)
            for flight, own in self.flights.items()
            if own.mae_least and own.mse_least
        ]

    @property
    def fit(self) -> bool:
        """True if every bar is met."""
        return all(bar.met for bar in self.bars)

    @property
    def reasons(self) -> list[str]:
        """Reasons against flying, a sentence each, the worst cases of each bar that is not met."""
        told = []
        for bar in self.bars:
            failed = sorted((case for case in bar.cases if not case.met), key=lambda c: -c.share)
            told += [case.reason for case in failed[:WORDS_MAX]]
            if len(failed) > WORDS_MAX:
                told.append(f"{len(failed) - WORDS_MAX} more of {len(bar.cases)} figures of: {bar.name}")
        return told

    def document(self) -> dict[str, Any]:
        """Return the sealed stamp as JSON data."""
        return stamp_document(
            policy_sha256=self.policy_sha256,
            aircraft=self.aircraft.name,
            aircraft_sha256=self.aircraft.sha256,
            fit=self.fit,
            figures={
                "seed": SEED,
                "references": [each.label for each in self.references],
                "missing": list(self.missing),
                "reasons": self.reasons,
                "bars": [_bar_document(bar) for bar in self.bars],
                "above_least": [
                    {"where": where, "mae": _number(mae), "mse": _number(mse)}
                    for where, mae, mse in self.above_least
                ],
            },
        )

    def cases(self) -> dict[str, list[dict[str, Any]]]:
        """Return every figure with its limit, by bar, as JSON data."""
        return {
            bar.name: [
                {
                    "where": case.where,
                    "seen": _number(case.seen),
                    "limit": _number(case.limit),
                    "met": case.met,
                }
                for case in bar.cases
            ]
            for bar in self.bars
        }


def check(
    policy: Path, aircraft: Aircraft, references: References, progress: Progress | None = None
) -> Verdict:
    """Fly a policy file and hold its bars. references: of the same aircraft.

    Raises PolicyError on a file that is no policy, or drives another number of motors, AircraftError where
    there is no reference.
    """
    controller = load_controller(str(policy), aircraft)
    references.begin()
    flown = fly_course(controller, references.course, progress)
    others, missing = references.flown()
    return Verdict(
        policy_sha256=hashlib.sha256(policy.read_bytes()).hexdigest(),
        aircraft=aircraft,
        references=others,
        missing=missing,
        bars=bars(flown, others, aircraft_figures(aircraft).thrust_to_weight),
        flights=flown.flights,
    )


def _bar_document(bar: Bar) -> dict[str, Any]:
    worst = bar.worst
    return {
        "name": bar.name,
        "unit": bar.unit,
        "met": bar.met,
        "seen": _number(worst.seen),
        "limit": _number(worst.limit),
        "where": worst.where,
        "source": bar.source,
    }


def _number(value: float) -> float | None:
    """Round to significant digits; None for NaN, which JSON does not have."""
    return float(f"{value:.4g}") if value == value and abs(value) != float("inf") else None
