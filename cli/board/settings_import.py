"""`neuroflight board settings import`: settings from a file that Betaflight's `diff` or `dump` printed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from neuroflight.cli.board.settings import Yes, changed, when_flown
from neuroflight.cli.board.state import OnPort, connect
from neuroflight.cli.options import Json
from neuroflight.cli.questions import confirm
from neuroflight.cli.report import Account, print_table
from neuroflight.cli.requests import Argument, Option

if TYPE_CHECKING:
    from neuroflight.flash.betaflight.diff_file import Diff
    from neuroflight.flash.betaflight.plan import ImportPlan
    from neuroflight.flash.board.turn import Turn
    from neuroflight.flash.settings.text import Value


@dataclass(frozen=True, kw_only=True)
class Import(OnPort):
    """A request to import settings of Betaflight's."""

    file: Annotated[Path, Argument("DIFF", "as Betaflight's diff or dump printed it")]
    dry_run: Annotated[bool, Option(None, "show it and change nothing")] = False
    yes: Yes = False
    backup: Annotated[Path | None, Option("FILE", "write all settings as they are before, for `restore`")] = (
        None
    )
    rate_profile: Annotated[int | None, Option("N", "its rates (default: the one that was active)")] = None
    betaflight: Annotated[
        str | None, Option("VERSION", "that wrote the file, where it does not say so itself")
    ] = None
    json: Json = False

    def run(self) -> int:
        """Show which settings of a file have a counterpart, ask, then set and store all of them or none."""
        from neuroflight.flash.betaflight.diff_file import read_diff
        from neuroflight.flash.betaflight.plan import fitted, needed
        from neuroflight.flash.betaflight.planner import plan_import
        from neuroflight.flash.board.info import version_of
        from neuroflight.flash.image.settings_kept import write_backup
        from neuroflight.flash.link import messages
        from neuroflight.flash.settings.values import Settings
        from neuroflight.toolchain.contract import Msp

        diff = read_diff(self.file, self.betaflight)
        with connect(self.port) as client:
            settings = Settings(client)
            present = {stored.name: stored.value for stored in settings.read()}
            board = messages.board_info(client.request(Msp.BOARD_INFO)).target
            planned = plan_import(diff, board, present, self.rate_profile, *_facts(diff.board, board))
            plan = fitted(planned, settings)
            changes = needed(plan, present)
            told = Account(self.json)
            document = _document(diff, plan) | changed(changes, stored=not self.dry_run)
            if not self.json:
                _show(diff, plan, present, changes)
            if self.dry_run or not changes:
                why = ": a dry run" if self.dry_run else "; all of it is so already"
                return told.end(document, f"nothing is changed{why}")
            if self.backup is not None:
                version = version_of(client)
                write_backup(self.backup, board, version, present)
            what = f"set and store {_count(len(changes), 'setting')} on {client.name}"
            confirm(self.yes, what, "nothing is changed")
            settings.change(changes, save=True)
        done = f"{_count(len(changes), 'setting')} changed, all stored; {when_flown(changes, saved=True)}"
        return told.end(document, f"{self.file}: {done}")


def _facts(name: str, here: str) -> tuple[list[str], Turn | None]:
    """Return the pins of a known board's motor outputs, as C06, and what its maker turns it by.

    Of another board none are known, and of one that is `here`, with a description of its own, no turn.
    """
    from neuroflight.toolchain.boards.facts import NOT_TURNED
    from neuroflight.toolchain.boards.table import boards

    if (board := boards().get(name)) is None:
        return [], None if name == here else NOT_TURNED
    return [f"{pin.port}{pin.number:02}" for pin in board.motors], board.turn_deg


def _document(diff: Diff, plan: ImportPlan) -> dict[str, Any]:
    return {
        "file": str(diff.path),
        "betaflight": diff.release,
        "board": diff.board or None,
        "brought": sum(len(group.lines) for group in plan.groups),
        "left": [
            {"line": one.line.number, "text": one.line.shown, "reason": one.reason} for one in plan.left
        ],
        "notes": list(plan.notes),
    }


def _show(diff: Diff, plan: ImportPlan, present: dict[str, Value], changes: dict[str, Value]) -> None:
    """Print the settings that are left out and why, then the changes, and what the pilot has to check."""
    from neuroflight.flash.settings.text import value_text

    brought = sum(len(group.lines) for group in plan.groups)
    board = f" of {diff.board}" if diff.board else ""
    print(
        f"{diff.path}: Betaflight {diff.release}{board}, {_count(len(diff.lines), 'line')}: "
        f"{brought} brought over, {len(plan.left)} left"
    )
    reasons: dict[str, list[str]] = {}
    for one in plan.left:
        reasons.setdefault(one.reason, []).append(f"  {one.line.number}: {one.line.shown}")
    for reason, lines in reasons.items():
        print(f"left, {reason}:", *lines, sep="\n")
    rows = []
    for group in plan.groups:
        first = [(group.name, _spans([line.number for line in group.lines]) or "left out")]
        for name, value in group.changes.items():
            told = value_text(name, value) if name in changes else "the same"
            what, lines_of_it = first.pop() if first else ("", "")
            rows.append((what, name, value_text(name, present[name]), told, lines_of_it))
    if rows:
        heads = ("brought over", "setting", "now", "becomes", "lines")
        print_table("", [heads, *rows], numbers=())
    for note in plan.notes:
        print(f"note: {note}")


def _spans(numbers: list[int]) -> str:
    """Write whole numbers as text, neighbours as a range: 3, 5-9."""
    spans: list[list[int]] = []
    for number in sorted(set(numbers)):
        if spans and number == spans[-1][1] + 1:
            spans[-1][1] = number
        else:
            spans.append([number, number])
    return ", ".join(str(low) if low == high else f"{low}-{high}" for low, high in spans)


def _count(count: int, what: str) -> str:
    return f"1 {what}" if count == 1 else f"{count} {what}s"
