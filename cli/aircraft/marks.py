"""The marks of an aircraft's numbers as a user sees them: how each is known, and what a wrong one costs."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

from neuroflight.cli.report import print_facts, print_table

NEXT_TO_NOTHING = 0.005  # of a policy's error


def known_document(name: str | Path) -> dict[str, Any]:
    """Return the marks of an aircraft's file as JSON data, the dearest first."""
    from neuroflight.sim.design.guesses import marked_numbers

    return {
        guess.key: {
            "how": guess.mark.how.value,
            "range": guess.mark.range and list(guess.mark.range),
            "from": guess.mark.source or None,
            "cost_of_half": guess.cost,
        }
        for guess in marked_numbers(name)
    }


def print_known(name: str | Path) -> None:
    """Print how each number of an aircraft's file is known, and what to measure first."""
    from neuroflight.sim.aircraft.known import How
    from neuroflight.sim.design.guesses import TRAITS, WRONG, marked_numbers

    guesses = marked_numbers(name)
    rows = [("number", "known", "costs", "by")]
    for guess in guesses:
        if guess.cost > NEXT_TO_NOTHING:
            mark = guess.mark
            within = "" if mark.range is None else "{:.4g} to {:.4g}; ".format(*mark.range)
            rows.append((guess.key, mark.how.value, f"{100 * guess.cost:.0f} %", within + mark.source))
    count = Counter(guess.mark.how for guess in guesses)
    told = ", ".join(f"{count[how]} {how.value}" for how in How)
    print_table(
        f"How its numbers are known: {told}",
        rows,
        f"costs: more error of a policy trained on a number {WRONG:g} times off, or at the end of its range",
        numbers=("costs",),
    )
    for how in How:
        keys = [each.key for each in guesses if each.mark.how is how and each.cost <= NEXT_TO_NOTHING]
        if keys:
            print(f"{how.value}, and next to nothing if wrong: {', '.join(keys)}")
    first: dict[str, None] = {}
    for guess in guesses:
        if guess.mark.how is not How.MEASURED and guess.cost > NEXT_TO_NOTHING:
            first[guess.trait] = None
    if first:
        print()
        print_facts(
            ("measure first" if at == 0 else "then", f"{TRAITS[trait].words}: {TRAITS[trait].told_by}")
            for at, trait in enumerate(first)
        )
