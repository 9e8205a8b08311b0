"""The proof of a refined policy: it and the one before fly the same unseen flights on one aircraft."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.analysis.confidence import Mean, mean_of, paired
from neuroflight.sim.analysis.holding import DRIFT_S
from neuroflight.sim.physics.variation import Variation
from neuroflight.training.evaluation.comparison import values
from neuroflight.training.evaluation.controllers import Conditions, ControllerSpec
from neuroflight.training.evaluation.evaluation import Scores, scores
from neuroflight.training.fitness.flying import Progress
from neuroflight.training.tasks.flight import HOVER_THROTTLE, FlightTask

COMMANDS = 100
SEED = 3_000_017  # of commands, noise and bias: neither training, monitor, check nor results use it
FLIGHT = FlightTask(pulses=3, idle_s=0.2, command_s=0.8, rest_s=1.0, hover_s=DRIFT_S)  # drifts show
CHANGE_MORE = 1.1  # most |change| of a motor in 1 ms, of the old policy's
SHOWN_STEPS = 500  # control steps from one report of the progress to the next
DRIFT_MORE_DEG = 1.0  # most drift in DRIFT_S of hover beyond the old policy's, mean of the axes


@dataclass(frozen=True, eq=False)
class Flown:
    """One policy on one aircraft."""

    mae: Mean  # [deg/s]
    mse: Mean  # [(deg/s)^2]
    change: float  # of the motors, in 1 ms
    drift: float  # [deg], in DRIFT_S of hover, mean of the axes
    scores: Scores

    def document(self) -> dict[str, Any]:
        """Return the figures as JSON data."""
        return {
            "mae": self.mae.document(),
            "mse": self.mse.document(),
            "motor_change": self.change,
            "drift_deg": self.drift,
        }


@dataclass(frozen=True, eq=False)
class Proof:
    """Old and new policy on the same commands."""

    aircraft: Aircraft
    old: Flown
    new: Flown

    @property
    def gain(self) -> Mean:
        """MAE of the old less that of the new [deg/s], flight by flight."""
        before, after = (values(each.scores) for each in (self.old, self.new))
        return paired(after["mae"], before["mae"])

    @property
    def drift(self) -> Mean:
        """Drift of the new less that of the old [deg], flight by flight."""
        before, after = (values(each.scores) for each in (self.old, self.new))
        return paired(before["drift"], after["drift"])

    @property
    def refusal(self) -> str | None:
        """Reason against replacing the old policy by the new one; None: there is none."""
        old, new = float(self.old.mae.value), float(self.new.mae.value)
        gain, drift = self.gain, self.drift
        if not float(gain.low) > 0.0:
            return (
                f"is no better: MAE {new:.3f} after {old:.3f} deg/s, a gain of {float(gain.value):.3f} "
                f"({float(gain.low):.3f} to {float(gain.high):.3f}, 95 %)"
            )
        if float(drift.low) > DRIFT_MORE_DEG:
            return (
                f"drifts: {float(drift.value):.1f} deg ({float(drift.low):.1f} to {float(drift.high):.1f}, "
                f"95 %) more in {DRIFT_S:g} s of centred sticks, expected at most {DRIFT_MORE_DEG:g}"
            )
        if self.new.change > CHANGE_MORE * self.old.change:
            return (
                f"moves the motors more: {self.new.change:.5f} after {self.old.change:.5f} in 1 ms, expected "
                f"at most {CHANGE_MORE:g} times that"
            )
        return None

    def document(self) -> dict[str, Any]:
        """Return the figures as JSON data."""
        return {
            "aircraft": self.aircraft.name,
            "aircraft_sha256": self.aircraft.sha256,
            "flights": len(self.old.scores.output),
            "old": self.old.document(),
            "new": self.new.document(),
            "gain": self.gain.document(),
            "drift": self.drift.document(),
            "refused": self.refusal,
        }


def prove(
    old: ControllerSpec, new: ControllerSpec, aircraft: Aircraft, progress: Progress | None = None
) -> Proof:
    """Fly both policies in the same unseen flights. progress: is called with the part that is done."""
    show = progress or (lambda done: None)
    before = fly_unseen(old, aircraft, lambda done: show(done / 2.0))
    return Proof(aircraft, before, fly_unseen(new, aircraft, lambda done: show(0.5 + done / 2.0)))


def fly_unseen(
    controller: ControllerSpec,
    aircraft: Aircraft,
    progress: Progress | None = None,
    strengths: Sequence[float] = (),
) -> Flown:
    """Fly a controller in flights that no training, check or result uses.

    strengths: thrust of each motor at the same command, of the file's; none: as the file has them.
    """
    task, flights = FLIGHT.of_commands(COMMANDS)

    def show(step: int, steps: int) -> None:
        if progress is not None and step % SHOWN_STEPS == 0:
            progress(step / steps)

    found = scores(
        Conditions(aircraft, task, flights, SEED).fly(
            controller, HOVER_THROTTLE, show, weakened(aircraft, flights, strengths)
        )
    )
    assert found.motor_change is not None
    return Flown(
        mae=mean_of(found.tracking.mae.mean(axis=1)),
        mse=mean_of(found.tracking.mse.mean(axis=1)),
        change=float(found.motor_change.mean()),
        drift=float(values(found)["drift"].mean()),
        scores=found,
    )


def weakened(aircraft: Aircraft, count: int, strengths: Sequence[float]) -> Variation | None:
    """Return `count` aircraft whose motors give these shares of their thrust; None where all give it."""
    if all(share == 1.0 for share in strengths):
        return None
    alike = Variation.nominal(count, aircraft.propulsion.delay)
    motors = alike.motors.copy()
    motors[:, : len(strengths)] = strengths
    return replace(alike, motors=motors)
