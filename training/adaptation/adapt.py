"""Adaptation of a policy: a warm start on the adapted aircraft, and the comparison that must be won."""

from __future__ import annotations

import shutil
from dataclasses import dataclass, replace
from pathlib import Path

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.analysis.confidence import Mean, mean_of, paired
from neuroflight.sim.analysis.holding import DRIFT_S
from neuroflight.toolchain.errors import TrainingError
from neuroflight.training.config.config_file import load_config
from neuroflight.training.config.pathwise_config import PathwiseConfig
from neuroflight.training.config.training_config import TrainingConfig
from neuroflight.training.evaluation.comparison import values
from neuroflight.training.evaluation.controllers import Conditions, load_controller
from neuroflight.training.evaluation.evaluation import Scores, scores
from neuroflight.training.runs.checkpoint import Learned, load_learned
from neuroflight.training.runs.train import CHECKPOINT, POLICY, RECORD, Callback, train
from neuroflight.training.tasks.flight import HOVER_THROTTLE, FlightTask

LEARNING_RATE = 5e-4  # a tenth of a fresh run's: the policy flies already
WARM_UP = 20
WITHIN = 0.05  # the adapted aircraft's own uncertainty of inertia and thrust
TRIES = 3  # trainings at most, each with a lower limit of the motors' change
FLIGHT = FlightTask(pulses=5, hover_s=DRIFT_S)  # flown by the proof: long enough for a drift to show
CALIBRATION, CALIBRATION_SEED = 40, 1000  # commands that find that limit; what is added to their seed
CHANGE_AIMED = 1.05  # |change| of the old policy's with which a training is good enough
CHANGE_MORE = 1.1  # most |change| of a motor in 1 ms, of the old policy's
DRIFT_MORE_DEG = 1.0  # most drift in DRIFT_S of hover beyond the old policy's, mean of the axes
ORIGINAL_MORE = (
    1.5  # most MAE on the aircraft of the unadapted file, of the old policy's: the log may be wrong
)


@dataclass(frozen=True, eq=False)
class Bench:
    """One policy on one aircraft."""

    mae: Mean  # [deg/s]
    change: float  # of the motors
    scores: Scores


@dataclass(frozen=True, eq=False)
class Proof:
    """Old and new policy on the same commands."""

    old: Bench  # on the adapted aircraft
    new: Bench
    gain: Mean  # MAE of the old less that of the new [deg/s], flight by flight
    drift: Mean  # of the new less that of the old [deg], likewise
    old_original: Bench  # on the aircraft of the file
    new_original: Bench

    @property
    def refusal(self) -> str | None:
        """Reason against replacing the old policy by the new one; None: there is none."""
        old, new = float(self.old.mae.value), float(self.new.mae.value)
        if not float(self.gain.low) > 0.0:
            return (
                f"is no better on the adapted aircraft: MAE {new:.3f} after {old:.3f} deg/s, a gain of "
                f"{float(self.gain.value):.3f} "
                f"({float(self.gain.low):.3f} to {float(self.gain.high):.3f}, 95 %)"
            )
        if float(self.drift.low) > DRIFT_MORE_DEG:
            return (
                f"drifts: {float(self.drift.value):.1f} deg "
                f"({float(self.drift.low):.1f} to {float(self.drift.high):.1f}, 95 %) more in {DRIFT_S:g} s "
                f"of centred sticks, expected at most {DRIFT_MORE_DEG:g}"
            )
        if self.new.change > CHANGE_MORE * self.old.change:
            return (
                f"moves the motors more: {self.new.change:.5f} after {self.old.change:.5f} in 1 ms, expected "
                f"at most {CHANGE_MORE:g} times that"
            )
        before, after = float(self.old_original.mae.value), float(self.new_original.mae.value)
        if after > ORIGINAL_MORE * before:
            return (
                f"flies the aircraft of the file with MAE {after:.3f} after {before:.3f} deg/s, expected "
                f"at most {ORIGINAL_MORE:g} times that: should the log mislead, it would be worse than before"
            )
        return None


def warm_config(
    folder: Path, steps: int, seed: int, change_factor: float = 1.0
) -> tuple[TrainingConfig, Learned]:
    """Return the configuration that refines the policy in `folder`, and what its run had learned.

    change_factor: multiplies the limit of the motors' change. Raises TrainingError for a folder without a run
    of
    the pathwise learner.
    """
    config = load_config(
        folder / RECORD,
        [
            f"steps={steps}",
            f"seed={seed}",
            f"checkpoint_steps={steps}",
            f"world.randomization.inertia=[{1 - WITHIN}, {1 + WITHIN}]",
            f"world.randomization.thrust=[{1 - WITHIN}, {1 + WITHIN}]",
        ],
    )
    algorithm = config.algorithm
    if not isinstance(algorithm, PathwiseConfig):
        raise TrainingError(
            f"{folder}: trained with {algorithm.name}, expected pathwise: only that learner is refined"
        )
    limit = algorithm.change_limit
    algorithm = replace(
        algorithm,
        learning_rate=LEARNING_RATE,
        warm_up=WARM_UP,
        change_limit=None if limit is None else change_factor * limit,
    )
    return replace(config, algorithm=algorithm), load_learned(folder / CHECKPOINT)


def refine(
    aircraft: Aircraft,
    folder: Path,
    steps: int,
    seed: int,
    out: Path,
    callback: Callback | None = None,
    command: str | None = None,
) -> None:
    """Train on `aircraft` from what the run in `folder` learned; writes checkpoint, policy, record to `out`.

    A policy may stay below the limit of the motors' change that it was trained with. One whose refinement
    uses what was left of it is refined again, from the same start with the limit as much lower. That is
    judged on commands that neither training nor proof flies.
    """
    policy, factor = out / POLICY, 1.0
    wanted = bench(folder / POLICY, aircraft, CALIBRATION, seed + CALIBRATION_SEED).change
    for left in reversed(range(TRIES)):
        config, learned = warm_config(folder, steps, seed, factor)
        train(aircraft, config, out, callback, command=command, start=learned)
        change = bench(policy, aircraft, CALIBRATION, seed + CALIBRATION_SEED).change
        limited = isinstance(config.algorithm, PathwiseConfig) and config.algorithm.change_limit is not None
        if change <= CHANGE_AIMED * wanted or not limited or not left:
            return
        factor *= wanted / change
        shutil.rmtree(out)
        out.mkdir()


def prove(old: Path, new: Path, original: Aircraft, adapted: Aircraft, commands: int, seed: int) -> Proof:
    """Fly both policies in the same unseen flights, on both aircraft."""
    first, second = bench(old, adapted, commands, seed), bench(new, adapted, commands, seed)
    before, after = (values(one.scores) for one in (first, second))
    return Proof(
        old=first,
        new=second,
        gain=paired(after["mae"], before["mae"]),
        drift=paired(before["drift"], after["drift"]),
        old_original=bench(old, original, commands, seed),
        new_original=bench(new, original, commands, seed),
    )


def bench(policy: Path, aircraft: Aircraft, commands: int, seed: int) -> Bench:
    """Fly a policy in unseen flights."""
    controller = load_controller(str(policy), aircraft)
    task, flights = FLIGHT.of_commands(commands)
    found = scores(Conditions(aircraft, task, flights, seed).fly(controller, HOVER_THROTTLE))
    assert found.motor_change is not None
    return Bench(
        mae=mean_of(found.tracking.mae.mean(axis=1)), change=float(found.motor_change.mean()), scores=found
    )
