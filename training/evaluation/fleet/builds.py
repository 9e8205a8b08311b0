"""Real aircraft of the classes that people fly: builds.csv, a row for each.

Weights are with battery, ready to fly. Of each row `source` says where its numbers are from; what is from
memory, or from a page that a catalogue of others quotes, is told there, and no row is measured by us. Makers
print weights without battery: packs are added by what packs of that size weigh.

What `aircraft new` makes of the rows lifts as others have found: an X500 hovers at 1/3.4 of its thrust, which
ArduPilot's parameters for it have learned, too; five inch aircraft with a camera at 1/6.8 to 1/8.0, where its
model of one has 1/8 (Tools/Frame_params/Holybro-X500v2-bdshot.param, Tools/autotest/models/freestyle.json).
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from functools import cache
from pathlib import Path

TABLE = Path(__file__).with_name("builds.csv")


@dataclass(frozen=True)
class Build:
    """An aircraft as a pilot describes it."""

    name: str
    kind: str  # class of the table
    weight_kg: float  # with battery
    cells: int
    kv: float  # [rpm/V], without load
    stator_mm: tuple[float, float]  # diameter, height
    propeller: str  # inches diameter x pitch x blades, or millimetres diameter x blades
    arm_m: float  # from the middle to a motor
    source: str


@cache
def builds() -> tuple[Build, ...]:
    """Return the rows of the table, in its order: by class, small ones first."""
    with TABLE.open(encoding="utf-8", newline="") as file:
        return tuple(
            Build(
                name=row["name"],
                kind=row["kind"],
                weight_kg=float(row["weight_g"]) / 1000,
                cells=int(row["cells"]),
                kv=float(row["kv"]),
                stator_mm=stator(row["stator"]),
                propeller=row["propeller"],
                arm_m=float(row["wheelbase_mm"]) / 2000,
                source=row["source"],
            )
            for row in csv.DictReader(file)
        )


def kinds() -> tuple[str, ...]:
    """Return the classes of the table, small ones first."""
    return tuple(dict.fromkeys(build.kind for build in builds()))


def stator(text: str) -> tuple[float, float]:
    """Return diameter and height [mm] of a stator's name: 2207, 1202.5."""
    return float(text[:2]), float(text[2:])
