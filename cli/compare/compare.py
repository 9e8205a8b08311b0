"""neuroflight compare: controllers side by side in a suite of flights; the engine of every evaluation."""

from __future__ import annotations

import argparse
import importlib
import pkgutil
from collections.abc import Sequence
from typing import Any

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


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the default suite; words that name another are parsed as that one's."""
    declare(parser, DEFAULT)

    def parsed(words: Sequence[str] | None = None, found: Any = None) -> Any:  # noqa: ANN401 - as argparse
        return suite_parser(parser, named(words or ())).parse_args(words, found), []

    parser.parse_known_args = parsed  # type: ignore[method-assign, assignment]


def suite_parser(parser: argparse.ArgumentParser, name: str) -> argparse.ArgumentParser:
    """Return the parser of a suite; parser: that of the command."""
    found = type(parser)(prog=parser.prog, description=f"{SUITES[name].__doc__}")
    found.set_defaults(**parser._defaults)
    declare(found, name)
    return found


def named(words: Sequence[str]) -> str:
    """Return the suite that the words of a command line name; the default where they name none or no such."""
    first = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    first.add_argument("--suite", nargs="?")
    name = first.parse_known_args(list(words))[0].suite
    return name if name in SUITES else DEFAULT


def declare(parser: argparse.ArgumentParser, name: str) -> None:
    """Declare the options of a suite."""
    kind = SUITES[name]
    kind.add_arguments(parser)
    parser.set_defaults(kind=kind)
    (suite,) = (action for action in parser._actions if action.dest == "suite")
    suite.choices, suite.metavar = tuple(SUITES), "NAME"
    suite.help = f"what is flown: {', '.join(SUITES)}; each has options of its own, see --suite NAME --help"


def run(args: argparse.Namespace) -> int:
    """Fly the suite and print its results."""
    asked: Suite = args.kind.of(args)
    return asked.run()
