"""neuroflight report: write the page of results from stored figures."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from neuroflight.training.results_page.stored_results import Stored

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
OUTPUTS = Path("runs", "results")  # what commands print, whole


def add_arguments(parser: argparse.ArgumentParser) -> None:
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
    from neuroflight.cli.training.pages import check_page
    from neuroflight.toolchain.files import write_text_if_changed
    from neuroflight.training.results_page.page import render
    from neuroflight.training.results_page.stored_results import read_results

    check_output(args.out, ".md")
    if args.again is not None:
        _make_again(args.folder, args.again)
    results = read_results(args.folder)
    page = render(results)
    if args.check:
        check_page(args.out, page, args.folder, "neuroflight report", f" with {len(results)} files")
        return 0
    written = write_text_if_changed(args.out, page)
    _draw(args.folder, results)
    print(f"{args.out}: {'written from' if written else 'already up to date with'} {len(results)} files")
    return 0


def _draw(folder: Path, results: Sequence[Stored]) -> None:
    """Draw the study of sizes, if there is one, into the folder."""
    from neuroflight.sim.plotting import save_png
    from neuroflight.training.results_page.studies import PLOT, drawn_points
    from neuroflight.training.results_page.studies_plot import draw_sizes

    for stored in results:
        if drawn := drawn_points(stored):
            title = f"What a policy of the {stored.text('aircraft', 'name')} costs and gives by size"
            save_png(folder / PLOT, draw_sizes(drawn, title))


def _make_again(folder: Path, names: Sequence[str]) -> None:
    """Repeat commands in the project's folder, and replace their files by the parts that the page reads."""
    import shlex

    from rich.console import Console

    from neuroflight.cli.training.pages import Lines
    from neuroflight.toolchain.errors import NeuroflightError
    from neuroflight.toolchain.files import write_text
    from neuroflight.training.reproduction.experiments import Step
    from neuroflight.training.reproduction.steps import Done, StepOutputs, run_steps
    from neuroflight.training.results_page.stored_results import COMMANDS, compact, read_commands
    from neuroflight.training.results_page.summary import summary

    commands = read_commands(folder)
    for name in names:
        if name not in commands:
            raise NeuroflightError(
                f"{folder / COMMANDS}: {name}: not there, expected one of: {', '.join(commands)}"
            )
    steps = [Step(Path(name).stem, *[shlex.join(commands[name])] * 2) for name in names or commands]

    class Keeper(Lines):
        """A watcher that stores each result as soon as it is there."""

        def finished(self, done: Done, *, again: bool) -> None:
            name = f"{done.step.name}.json"
            write_text(folder / name, compact(summary(name, done.output)) + "\n")
            super().finished(done, again=again)

    console = Console(stderr=True, highlight=False, quiet=not sys.stderr.isatty())
    keeper = Keeper(console, len(steps))
    run_steps(steps, StepOutputs(ROOT, OUTPUTS.resolve(), "full"), jobs=1, force=True, watcher=keeper)
    if keeper.reasons:
        raise NeuroflightError("; ".join(f"{name}.json: {why}" for name, why in keeper.reasons.items()))
