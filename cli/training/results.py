"""neuroflight results: write the page of results from stored figures."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from neuroflight.training.results_page.stored_results import Stored

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument(
        "--folder",
        type=Path,
        default=DOCS / "results",
        metavar="DIR",
        help="output of commands with --json; default: docs/results",
    )
    parser.add_argument(
        "--out", type=Path, default=DOCS / "results.md", metavar="FILE.md", help="default: docs/results.md"
    )
    parser.add_argument(
        "--check", action="store_true", help="write nothing; fail if the page is not up to date"
    )
    parser.add_argument(
        "--again",
        nargs="*",
        metavar="NAME.json",
        help="first repeat the commands in DIR/commands.txt for these files; all unless named",
    )


def run(args: argparse.Namespace) -> int:
    """Write the page, or check that it is up to date."""
    from neuroflight.cli.output import check_output
    from neuroflight.toolchain.errors import NeuroflightError
    from neuroflight.toolchain.files import write_text_if_changed
    from neuroflight.training.results_page.page import render
    from neuroflight.training.results_page.stored_results import read_results

    check_output(args.out, ".md")
    if args.again is not None:
        _make_again(args.folder, args.again)
    results = read_results(args.folder)
    page = render(results)
    if args.check:
        if not args.out.is_file() or args.out.read_bytes() != page.encode():
            raise NeuroflightError(
                f"{args.out}: not what the files in {args.folder} give; run `neuroflight results`"
            )
        print(f"{args.out}: up to date with {len(results)} files")
        return 0
    written = write_text_if_changed(args.out, page)
    _draw(args.folder, results)
    print(f"{args.out}: {'written from' if written else 'already up to date with'} {len(results)} files")
    return 0


def _draw(folder: Path, results: Sequence[Stored]) -> None:
    """Draw the study of sizes, if there is one, into the folder."""
    from neuroflight.sim.plotting import save_png
    from neuroflight.training.results_page.studies import PLOT, SIZES
    from neuroflight.training.results_page.studies_plot import draw_sizes, points

    for stored in results:
        if stored.has("sweep") and stored.text("sweep") == SIZES and (drawn := points(stored)):
            title = f"What a policy of the {stored.text('aircraft', 'name')} costs and gives by size"
            save_png(folder / PLOT, draw_sizes(drawn, title))


def _make_again(folder: Path, names: Sequence[str]) -> None:
    """Repeat commands in the project's folder; a file is replaced when its command has succeeded."""
    from rich.console import Console

    from neuroflight.toolchain.errors import NeuroflightError
    from neuroflight.toolchain.files import write_text
    from neuroflight.training.results_page.stored_results import COMMANDS, read_commands

    commands = read_commands(folder)
    for name in names:
        if name not in commands:
            raise NeuroflightError(
                f"{folder / COMMANDS}: {name}: not there, expected one of: {', '.join(commands)}"
            )
    console = Console(stderr=True, highlight=False)
    for name in names or commands:
        words = commands[name]
        told = f"{name}: `neuroflight {' '.join(words)}`"
        with console.status(told):
            done = subprocess.run(
                [sys.executable, "-m", "neuroflight.cli.main", *words, "--json"],
                cwd=ROOT,
                capture_output=True,
                text=True,
                check=False,
            )
        if done.returncode:
            last = (done.stderr.strip().splitlines() or ["it said nothing"])[-1]
            raise NeuroflightError(f"{told} ended with {done.returncode}: {last}")
        try:
            json.loads(done.stdout)
        except ValueError as error:
            raise NeuroflightError(f"{told} printed no JSON ({error})") from error
        write_text(folder / name, done.stdout)
        if console.is_terminal:
            console.print(told)
