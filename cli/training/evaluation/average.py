"""The average of several policies in `neuroflight compare`: agents of one configuration, of several seeds."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from neuroflight.cli.output import with_margin
from neuroflight.cli.training.evaluation.contenders import BETAFLIGHT

if TYPE_CHECKING:
    from rich.console import Console

    from neuroflight.training.evaluation.comparison import Entry


def check_average(args: argparse.Namespace) -> None:
    """Raise TrainingError where --average has nothing to average."""
    from neuroflight.toolchain.errors import TrainingError

    if not args.average:
        return
    if args.thrust is not None:
        raise TrainingError("--average: --thrust flies each at a throttle of its own; leave one of them out")
    policies = [name for name in args.controllers if _is_policy(name)]
    if len(policies) < 2:
        raise TrainingError(f"--average: {len(policies)} policies, expected at least 2")


def _is_policy(name: str) -> bool:
    from neuroflight.training.evaluation.users_controller import is_users_controller

    return name.partition(":")[0] not in ("pid", BETAFLIGHT) and not is_users_controller(name)


def average_document(entries: Sequence[Entry]) -> dict[str, object]:
    """The average of the policies at one throttle, as JSON data."""
    from neuroflight.cli.output import plain
    from neuroflight.training.evaluation.comparison import average

    found = plain(average([entry for entry in entries if _is_policy(entry.controller.name)]))
    assert isinstance(found, dict)
    throttle = entries[0].throttle
    return {"throttle": "recorded" if throttle is None else throttle, **found}


def print_average(console: Console, found: dict[str, Any]) -> None:
    """Print the average of policies: a row a figure of their responses, a column an axis."""
    from rich.table import Table

    from neuroflight.cli.training.evaluation.evaluate import RESPONSE_ROWS
    from neuroflight.toolchain.contract import AXES

    policies, response = found["controllers"], found["response"]
    title = f"average of {len(policies)} policies, {found['episodes']:,} episodes"
    if response is not None:
        table = Table(title=title, title_justify="left", box=None, pad_edge=False)
        for heading in ("", *AXES):
            table.add_column(heading, justify="right" if heading else "left", no_wrap=True)
        for heading, name, factor, digits in RESPONSE_ROWS:
            parts = (response[name][key] for key in ("value", "low", "high", "count"))
            cells = [
                with_margin(factor * value, factor * (high - low) / 2, digits) if count else "none"
                for value, low, high, count in zip(*parts, strict=True)
            ]
            table.add_row(heading, *cells)
        console.print(table)
    sums = ", ".join(f"{value:,.1f}" for value in found["sum_of_errors"])
    console.print(f"best of {len(policies)}: {found['best']}; errors summed over the axes: {sums}")
