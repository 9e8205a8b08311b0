"""The result of reading a Betaflight file: settings in groups, lines left out and why, notes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from neuroflight.flash.betaflight.diff_file import Line
from neuroflight.flash.link.client import NoAnswerError, RefusedError
from neuroflight.flash.settings.text import RATES, STYLE, Value, same
from neuroflight.flash.settings.values import Settings
from neuroflight.toolchain.errors import LinkError


@dataclass(frozen=True)
class Left:
    """A line that is not imported."""

    line: Line
    reason: str


@dataclass
class Group:
    """Settings that are imported together or not at all."""

    name: str
    changes: dict[str, Value] = field(default_factory=dict)
    lines: list[Line] = field(default_factory=list)


@dataclass(frozen=True)
class ImportPlan:
    """The changes that a file asks for; each of its lines is in one group or among those left out."""

    groups: tuple[Group, ...]
    left: tuple[Left, ...]
    notes: tuple[str, ...]  # what the pilot has to check

    @property
    def changes(self) -> dict[str, Value]:
        """All settings of all groups."""
        return {name: value for group in self.groups for name, value in group.changes.items()}


def fitted(plan: ImportPlan, settings: Settings) -> ImportPlan:
    """Drop the groups that the firmware behind `settings` would refuse. Raises LinkError if it is gone."""
    kept: list[Group] = []
    left, notes, changes = list(plan.left), list(plan.notes), dict[str, Value]()
    for group in plan.groups:
        try:
            settings.check(changes | group.changes)
            settings.check_together(changes | group.changes)
        except (NoAnswerError, RefusedError):
            raise
        except LinkError as error:
            left += [Left(line, str(error)) for line in group.lines]
            notes.append(f"{group.name}: not brought over, as {error}")
            continue
        kept.append(group)
        changes |= group.changes
    return ImportPlan(tuple(kept), tuple(sorted(left, key=lambda one: one.line.number)), tuple(notes))


def needed(plan: ImportPlan, present: Mapping[str, Value]) -> dict[str, Value]:
    """Return the settings whose values change. A new style of rates sets all rates, so these are kept."""
    changes = plan.changes
    turned = STYLE in changes and not same(STYLE, changes[STYLE], present[STYLE])
    return {
        name: value
        for name, value in changes.items()
        if not same(name, value, present[name]) or (turned and name in RATES)
    }
