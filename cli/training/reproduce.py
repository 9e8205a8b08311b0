"""neuroflight reproduce: the dissertation's experiments again, its figures beside ours."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from neuroflight.cli.options import Json
from neuroflight.cli.report import print_json
from neuroflight.cli.requests import Argument, Option, Request

if TYPE_CHECKING:
    from neuroflight.training.reproduction.experiments import ExperimentRow, Experiments
    from neuroflight.training.reproduction.steps import Done
    from neuroflight.training.reproduction.stored import Kept, RowResult

ROOT = Path(__file__).resolve().parents[2]
STORED = ROOT / "docs" / "results" / "dissertation"
PAGE = ROOT / "docs" / "dissertation.md"
PICTURES = ROOT / "docs" / "dissertation"
OUT = Path("runs", "reproduce")


@dataclass(frozen=True, kw_only=True)
class Reproduce(Request):
    """A request to run the dissertation's experiments again."""

    rows: Annotated[
        tuple[str, ...],
        Argument("ROW", "such as 3.9, 4.4 or 3.9-ppo; 3 stands for all of chapter 3; default: all"),
    ] = ()
    list: Annotated[
        bool,
        Option(
            None, "run nothing; list rows, stored figures and commands, of named rows also what these run"
        ),
    ] = False
    budget: Annotated[
        Literal["quick", "full"],
        Option(None, "quick: a fraction of the steps; full: as many as the dissertation"),
    ] = "quick"
    jobs: Annotated[int, Option("N", "commands at a time; default: 2", low=1, high=256)] = 2
    address: Annotated[
        str | None, Option("ADDRESS", "on Ray: local, or HOST:PORT of a cluster that sees the same folder")
    ] = None
    out: Annotated[
        Path,
        Option(
            "DIR",
            "what the commands write; finished ones are not repeated unless a file that they name, a recipe "
            "or an aircraft, has changed; default: runs/reproduce",
        ),
    ] = OUT
    force: Annotated[bool, Option(None, "repeat what is finished too, as after a change of the program")] = (
        False
    )
    store: Annotated[
        bool,
        Option(
            None,
            "keep the figures in docs/results/dissertation and write docs/dissertation.md; figures of the "
            "full budget are not replaced by quick ones",
        ),
    ] = False
    check: Annotated[bool, Option(None, "run nothing; fail if the page is not up to date")] = False
    json: Json = False

    def run(self) -> int:
        """Run the steps of the rows, then print them; or list them, or check the page."""
        from neuroflight.cli.training.pages import check_page
        from neuroflight.training.reproduction.experiments import experiments
        from neuroflight.training.reproduction.page import render
        from neuroflight.training.reproduction.stored import read_stored, row_result

        known = experiments()
        rows = known.chosen(self.rows)
        if self.check:
            page = render(known, read_stored(STORED), PICTURES.name)
            check_page(PAGE, page, STORED, "neuroflight reproduce --store ROW")
            print_json({"page": str(PAGE), "up_to_date": True}) if self.json else print(f"{PAGE}: up to date")
            return 0
        if self.list:
            _list(self, known, [row_result(row, read_stored(STORED)) for row in rows])
            return 0
        kept, failed = _run(self, known, rows)
        results = [row_result(row, kept) for row in rows if not row.hardware]
        if self.json:
            print_json([_document(each, known) for each in results])
        else:
            _print(results)
        return 1 if failed else 0


def _run(
    args: Reproduce, known: Experiments, rows: Sequence[ExperimentRow]
) -> tuple[Mapping[str, Kept], Mapping[str, str]]:
    """Run the steps of rows; return their stored parts, and the reasons why others failed."""
    from rich.console import Console

    from neuroflight.cli.training.pages import Lines, renewed
    from neuroflight.training.reproduction.ray_steps import on_ray
    from neuroflight.training.reproduction.steps import StepOutputs, run_steps
    from neuroflight.training.reproduction.stored import keep

    outputs = StepOutputs(ROOT, args.out.resolve(), args.budget, renewed)
    watcher = Lines(Console(stderr=True, highlight=False), len(known.plan(rows)))
    with nullcontext(None) if args.address is None else on_ray(args.address, args.jobs) as execute:
        done = run_steps(
            known.plan(rows), outputs, jobs=args.jobs, force=args.force, execute=execute, watcher=watcher
        )
    # Every row that reads a step keeps its figures, also one that was not asked for.
    used = {name for row in rows for name in row.steps}
    kept = {name: keep(each, known.rows) for name, each in done.items() if name in used}
    if args.store:
        _store(known, kept, done)
    return kept, watcher.reasons


def _store(known: Experiments, kept: Mapping[str, Kept], done: Mapping[str, Done]) -> None:
    from neuroflight.toolchain.files import write_text_if_changed
    from neuroflight.training.reproduction.page import render
    from neuroflight.training.reproduction.stored import read_stored, store

    before = read_stored(STORED)
    for name, each in kept.items():
        if each.budget == "full" or name not in before or before[name].budget == "quick":
            store(each, STORED, done[name].picture, PICTURES)
    write_text_if_changed(PAGE, render(known, read_stored(STORED), PICTURES.name))


def _list(args: Reproduce, known: Experiments, results: Sequence[RowResult]) -> None:
    """Print each row with its stored figures and its command; the steps only of rows that were named."""
    from rich.console import Console

    from neuroflight.training.reproduction.page import differing, judged, measured, quoted

    if args.json:
        print_json([_document(each, known) for each in results])
        return
    console = Console(highlight=False, soft_wrap=True)
    for each in results:
        row = each.row
        console.print(f"{row.name}  {row.place}: {row.title}", markup=False, style="bold")
        if row.hardware:
            console.print(f"    no run fills it: {row.hardware}", markup=False)
            continue
        budgets = " and ".join(each.budgets) or "nothing stored"
        verdict = each.verdict.value if each.verdict else "not run"
        verdict = f", {verdict or 'no verdict'}" if each.results else ", a picture"
        console.print(f"    {budgets}{verdict}", markup=False)
        for result in each.results:
            ours, theirs = measured(result), quoted(result.figure)
            verdict = f": {judged(result)}" if judged(result) else ""
            differs = f"; differs: {told}" if (told := differing(result, row, known)) else ""
            line = f"    {result.figure.what}: {ours}; dissertation {theirs}{verdict}{differs}"
            console.print(line, markup=False)
        console.print(
            f"    neuroflight reproduce {row.name} --budget {args.budget}", markup=False, style="dim"
        )
        for step in known.plan([row]) if args.rows else ():
            line = f"        {step.name}: neuroflight {step.text(args.budget)}"
            console.print(line, markup=False, style="dim")
    console.print(f"{len(results)} rows", style="dim")


def _print(results: Sequence[RowResult]) -> None:
    """Print each row with its figures."""
    from neuroflight.cli.report import print_table
    from neuroflight.training.reproduction.page import barred, judged, measured, quoted, used_columns
    from neuroflight.training.reproduction.verdict import Verdict

    for each in results:
        title = f"{each.row.place}: {each.row.title}"
        if not each.results:
            print(f"{title}: a picture")
            continue
        body, notes = [], [each.row.why]
        for result in each.results:
            verdict = judged(result)
            if result.figure.unlike:
                notes.append(verdict)
                verdict = Verdict.UNLIKE.value
            shown = (quoted(result.figure), barred(result), measured(result))
            body.append((result.figure.what, *shown, verdict))
        headings, rows = used_columns(("", "dissertation", "bar", "ours", "verdict"), body)
        print_table(title, list(map(tuple, [headings, *rows])), "\n".join(filter(None, dict.fromkeys(notes))))


def _document(each: RowResult, known: Experiments) -> dict[str, Any]:
    from neuroflight.training.reproduction.page import barred, differing, judged

    row = each.row
    return {
        "row": row.name,
        "place": row.place,
        "title": row.title,
        "hardware": row.hardware or None,
        "budgets": list(each.budgets),
        "commands": {
            step.name: {
                "quick": ["neuroflight", *step.words("quick")],
                "full": ["neuroflight", *step.words("full")],
            }
            for step in known.plan([row])
        },
        "verdict": each.verdict and each.verdict.value,
        "why": row.why or None,
        "seconds": round(each.seconds, 1),
        "picture": row.picture,
        "figures": [
            {
                "what": result.figure.what,
                "quote": result.figure.quote and result.figure.quote.name,
                "dissertation": result.figure.quote and result.figure.quote.value,
                "margin": result.figure.quote and result.figure.quote.allowed,
                "bar": barred(result) or None,
                "ours": result.value,
                "ours_margin": result.margin,
                "verdict": judged(result) or None,
                "differs": differing(result, row, known) or None,
            }
            for result in each.results
        ],
    }
