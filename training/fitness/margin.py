"""The margin of a policy on an aircraft that changed: how much worse it flies, and what it withstands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.training.evaluation.controllers import Conditions, ControllerSpec, load_controller
from neuroflight.training.fitness.check import Verdict, check
from neuroflight.training.fitness.flying import Progress
from neuroflight.training.fitness.proof import SEED, Flown, fly_unseen, weakened
from neuroflight.training.fitness.references import References
from neuroflight.training.tasks.pieces import RecordedPieces

WORSE = 1.05  # times the error on its own aircraft, from which a refinement is worth its minute


@dataclass(frozen=True, eq=False)
class Margin:
    """A policy on the aircraft of its file, and on the one that a flight tells."""

    own: Flown
    synced: Flown
    verdict: Verdict | None  # of `policy check` on the synced aircraft; None: no reference could fly

    @property
    def worse(self) -> float:
        """Error on the synced aircraft over that on its own."""
        return float(self.synced.mae.value) / float(self.own.mae.value)

    @property
    def refine(self) -> bool:
        """True if a refinement is worth its minute."""
        return self.worse > WORSE or (self.verdict is not None and not self.verdict.fit)

    def document(self) -> dict[str, Any]:
        """Return the figures as JSON data."""
        told = self.verdict
        return {
            "own": self.own.document(),
            "synced": self.synced.document(),
            "worse": self.worse,
            "check": None if told is None else {"fit": told.fit, "reasons": told.reasons},
            "refine": self.refine,
        }


def find_margin(
    policy: Path,
    own: Aircraft,
    synced: Aircraft,
    strengths: Sequence[float],
    references: References | None,
    progress: Progress = lambda done: None,
) -> Margin:
    """Fly a policy on both aircraft in the same flights, and check it on the synced one.

    strengths: thrust of the synced one's motors, see `fly_unseen`; references: of the synced one.
    """
    if references is not None:
        references.begin()
    controller = load_controller(str(policy), own)
    first = fly_unseen(controller, own, lambda done: progress(done / 3.0))
    second = fly_unseen(controller, synced, lambda done: progress((1.0 + done) / 3.0), strengths)
    verdict = None
    if references is not None:
        verdict = check(policy, synced, references, lambda done: progress((2.0 + done) / 3.0))
    return Margin(first, second, verdict)


def predicted_error(
    controller: ControllerSpec,
    aircraft: Aircraft,
    commands: RecordedPieces,
    noise_deg_s: Sequence[float],
    strengths: Sequence[float] = (),
) -> float:
    """Compute the MAE [deg/s] against the gyro that a flight of these commands has in the twin.

    noise_deg_s: of the gyro about each axis, as the log has it.
    """
    flown = Conditions(aircraft, commands, commands.count, SEED).fly(
        controller, None, variation=weakened(aircraft, commands.count, strengths)
    )
    error = np.rad2deg(flown.setpoint - flown.rate, dtype=np.float64)
    heard = np.random.default_rng(SEED).standard_normal(error.shape) * np.asarray(noise_deg_s)
    return float(np.abs(error - heard).mean())
