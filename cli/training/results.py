"""neuroflight report: write the page of results from stored figures."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from neuroflight.cli.options import Json
from neuroflight.cli.report import print_json
from neuroflight.cli.requests import Option, Request

if TYPE_CHECKING:
    from neuroflight.training.results_page.stored_results import Stored

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
OUTPUTS = Path("runs", "results")  # what commands print, whole


@dataclass(frozen=True, kw_only=True)
class Report(Request):
    """A request for the page of results."""

    folder: Annotated[Path, Option("DIR", "output of commands with --json; default: docs/results")] = (
        DOCS / "results"
    )
    out: Annotated[Path, Option("FILE.md", "default: docs/results.md", suffix=".md")] = DOCS / "results.md"
    check: Annotated[bool, Option(None, "write nothing; fail if the page is not up to date")] = False
    again: Annotated[
        tuple[str, ...] | None,
        Option(
            "NAME.json",
            "first repeat the commands in DIR/commands.txt for these files; all unless named",
            number="*",
            name="--repeat",
            old=("--again",),
        ),
    ] = None
    json: Json = False

    def run(self) -> int:
        """Write the page, or check that it is up to date."""
        from neuroflight.cli.training.pages import check_page
        from neuroflight.toolchain.files import write_text_if_changed
        from neuroflight.training.results_page.page import render
        from neuroflight.training.results_page.stored_results import read_results

        if self.again is not None:
            _make_again(self.folder, self.again)
        results = read_results(self.folder)
        page = render(results)
        if self.check:
            check_page(self.out, page, self.folder, "neuroflight report")
            written, told = False, "up to date with"
        else:
            written = write_text_if_changed(self.out, page)
            _draw(self.folder, results)
            told = "written from" if written else "already up to date with"
        if self.json:
            print_json({"page": str(self.out), "written": written, "files": len(results)})
        else:
            print(f"{self.out}: {told} {len(results)} files")
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
