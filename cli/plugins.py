"""`--plugin FILE.py`: rewards and tasks of a user's own file, for every command that names one."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from neuroflight.training.plugins import Plugin


def add_plugin_argument(parser: argparse.ArgumentParser) -> None:
    """Declare the option; `load_named` acts on it."""
    parser.add_argument(
        "--plugin",
        action="append",
        type=Path,
        default=[],
        metavar="FILE.py",
        help="run this file of yours first; the rewards and tasks that it registers are known by name then; "
        "may be repeated",
    )


def load_named(args: argparse.Namespace) -> tuple[Plugin, ...]:
    """Run the files of the option. Raises TrainingError on one that cannot be run or registers nothing."""
    if not args.plugin:
        return ()
    from neuroflight.training.plugins import load_plugins

    return load_plugins(args.plugin)


def words(args: argparse.Namespace) -> list[str]:
    """Return the option as a stored command has it."""
    return [word for path in args.plugin for word in ("--plugin", str(path))]
