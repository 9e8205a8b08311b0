"""The parser of one command: argparse with errors of one line that suggest what was meant."""

from __future__ import annotations

import argparse
import difflib
import re
from collections.abc import Iterable, Sequence
from typing import Any, NoReturn

CLOSE = 0.6  # of 1: two words that are as much alike as `--stpes` and `--steps`


class Parser(argparse.ArgumentParser):
    """A parser whose hidden options (help=argparse.SUPPRESS) are old spellings."""

    def __init__(self, *args: Any, **words: Any) -> None:  # noqa: ANN401 - as argparse has it
        super().__init__(*args, **words)
        self._negative_number_matcher = re.compile(r"-[\d.]")  # -1,1 too is no option

    def parse_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> argparse.Namespace:
        """Return the parsed arguments. Ends the process, status 2, where a word is not known."""
        found, unknown = self.parse_known_args(args, namespace)
        if unknown:
            known = [text for action in self._actions if shown(action) for text in action.option_strings]
            first = unknown[0]
            hint = suggestion(first.partition("=")[0], known) if first.startswith("-") else ""
            self.error(f"unrecognized arguments: {' '.join(unknown)}{hint}")
        return found

    def error(self, message: str) -> NoReturn:
        """Print one line on stderr and end the process, status 2."""
        self.exit(2, f"{self.prog}: {message}; {self.prog} --help tells more\n")

    def _check_value(self, action: argparse.Action, value: Any) -> None:  # noqa: ANN401 - as argparse has it
        if action.choices is not None and value not in action.choices:
            choices = [str(choice) for choice in action.choices if choice not in hidden_choices(action)]
            hint = suggestion(str(value), choices)
            told = f"invalid choice: {value!r} (choose from {', '.join(choices)}){hint}"
            raise argparse.ArgumentError(action, told)


def shown(action: argparse.Action) -> bool:
    """Return True if --help shows an option."""
    return action.help is not argparse.SUPPRESS


def hidden_choices(action: argparse.Action) -> Sequence[str]:
    """Return the choices of an option that are old spellings."""
    return getattr(action, "old_choices", ())


def suggestion(word: str, known: Iterable[str]) -> str:
    """Return "; did you mean X?", or "" where nothing known is similar to the word."""
    near = difflib.get_close_matches(word, list(known), 1, CLOSE)
    return f"; did you mean {near[0]}?" if near else ""
