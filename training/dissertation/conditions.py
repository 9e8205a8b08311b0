"""The conditions of the dissertation's experiments: conditions.toml, read strictly."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path

from neuroflight.toolchain.errors import NeuroflightError
from neuroflight.toolchain.strict_toml import StrictTable

FILE = Path(__file__).with_name("conditions.toml")
TEXTS = ("aircraft", "mount", "task", "machine", "reward", "inputs", "network")
NUMBERS = {"length_s": 1e4, "commands": 1e6, "steps": 1e9, "agents": 100}  # the largest


class ConditionsError(NeuroflightError):
    """A file of conditions that is damaged, or that lacks an aircraft."""


@dataclass(frozen=True)
class StandIn:
    """The dissertation's counterpart of a file of ours."""

    of: str  # which aircraft; of a recipe empty: that of the row
    differs: str  # empty: in nothing that is known


@dataclass(frozen=True)
class Conditions:
    """All conditions of the file."""

    experiments: Mapping[str, Mapping[str, str | float]]  # by patterns of rows' names, spaces between
    aircraft: Mapping[str, StandIn]  # by the name of our file
    recipes: Mapping[str, StandIn]

    def of(self, row: str) -> Mapping[str, str | float]:
        """Return the conditions of a row; empty if the file has none."""
        found: dict[str, str | float] = {}
        for patterns, values in self.experiments.items():
            if any(fnmatchcase(row, pattern) for pattern in patterns.split()):
                found |= values
        return found

    def stands_for(self, name: str) -> StandIn:
        """Return what an aircraft of ours stands for. Raises ConditionsError if the file does not tell."""
        if name not in self.aircraft:
            known = ", ".join(self.aircraft)
            raise ConditionsError(f"{FILE.name}: no [aircraft.{name}], expected one of: {known}")
        return self.aircraft[name]


@cache
def conditions() -> Conditions:
    """Return the shipped conditions. Raises ConditionsError naming the key that is wrong."""
    table = StrictTable(tomllib.loads(FILE.read_text()), FILE.name, ConditionsError)
    experiments = table.table("experiment")
    found = {}
    for rows in experiments.names():
        entry = experiments.table(rows)
        values: dict[str, str | float] = {key: entry.text(key) for key in TEXTS if entry.has(key)}
        found[rows] = values | {
            key: entry.number(key, 0.0, most) for key, most in NUMBERS.items() if entry.has(key)
        }
        entry.finish()
    aircraft, recipes = _stand_ins(table.table("aircraft")), _stand_ins(table.table("recipe"))
    table.finish()
    return Conditions(found, aircraft, recipes)


def _stand_ins(table: StrictTable) -> Mapping[str, StandIn]:
    found = {}
    for name in table.names():
        entry = table.table(name)
        found[name] = StandIn(entry.text("of", ""), entry.text("differs", ""))
        entry.finish()
    return found
