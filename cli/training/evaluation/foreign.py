"""A policy that flies another aircraft's twin than its own: one line, wherever controllers are flown."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from typing import Protocol


class WithFacts(Protocol):
    """A controller that is flown."""

    @property
    def facts(self) -> Mapping[str, str]:
        """What a stored result records of it."""
        ...


def say_foreign(controllers: Iterable[WithFacts]) -> None:
    """Print a line to stderr for each policy that was trained on another aircraft than it flies."""
    from neuroflight.training.evaluation.controllers import OTHER_AIRCRAFT

    for controller in controllers:
        if (note := controller.facts.get(OTHER_AIRCRAFT)) is not None:
            print(f"neuroflight: {note}", file=sys.stderr)
