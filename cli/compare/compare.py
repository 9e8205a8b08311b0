"""neuroflight compare: controllers side by side in a suite of flights; the engine of every evaluation."""

from __future__ import annotations

import argparse
import importlib
import pkgutil
from collections.abc import Sequence

from neuroflight.cli.compare import suites
from neuroflight.cli.compare.suite import Suite

DEFAULT = "flights"


def _found() -> dict[str, type[Suite]]:
    """Return the suites of all files in `cli/compare/suites`, by their names."""
    found: dict[str, type[Suite]] = {}
    for module in pkgutil.iter_modules(suites.__path__, f"{suites.__name__}."):
        for kind in vars(importlib.import_module(module.name)).values():
            if isinstance(kind, type) and issubclass(kind, Suite) and kind.__module__ == module.name:
                found |= dict.fromkeys(kind.names, kind)
    return found


SUITES = _found()
Suite.every = SUITES


class Compare(Suite):
    """The suite that the words of the command line name, the default where they name none or no such."""

    @classmethod
    def chosen(cls, words: Sequence[str]) -> type[Suite]:
        """Return the suite."""
        first = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
        first.add_argument("--suite", nargs="?")
        name = first.parse_known_args(list(words))[0].suite
        return SUITES[name if name in SUITES else DEFAULT]
