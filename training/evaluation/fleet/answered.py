"""The aircraft file that `aircraft new` writes for a row of the table."""

from __future__ import annotations

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.aircraft.typical import Answers, Propeller, typical
from neuroflight.training.evaluation.fleet.builds import Build


def answered(build: Build, name: str) -> Aircraft:
    """Return the typical aircraft of a pilot who answers what the row knows."""
    answers = Answers(
        weight_kg=build.weight_kg,
        cells=build.cells,
        kv=build.kv,
        propeller=Propeller.parse(build.propeller),
        arm_m=build.arm_m,
        stator_mm=build.stator_mm,
        name=name,
    )
    return typical(answers).aircraft(name)
