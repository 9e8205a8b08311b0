"""`neuroflight log card`: put empty files for logs onto a card; overwrite nothing on it unasked."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from neuroflight.cli.board.interrupts import one_interrupt
from neuroflight.cli.options import Json
from neuroflight.cli.progress import step_bars
from neuroflight.cli.questions import confirm
from neuroflight.cli.report import Account, print_table
from neuroflight.cli.requests import Argument, Either, Option, Request
from neuroflight.toolchain.contract import LOG_FILE_MIB, LOG_FILE_MIB_MAX, LOG_NUMBER_MAX
from neuroflight.toolchain.errors import CardError

if TYPE_CHECKING:
    from neuroflight.flash.card.files import Card, LogFile

WORDS = {"write": "writing", "compare": "comparing", "clear": "emptying"}
HEADS = ("file", "holds", "MB", "in one piece")
WHAT = Either()


@dataclass(frozen=True, kw_only=True)
class OnCard(Request):
    """A request about the files for logs on a card."""

    place: Annotated[
        Path,
        Argument(
            "PLACE",
            "the folder where a FAT32 card is mounted, an image file, or a device that is not mounted",
        ),
    ]
    list: Annotated[bool, Option(None, "what is there; nothing is written", either=WHAT)] = False
    clear: Annotated[
        bool, Option(None, "empty the logs that --copies has whole copies of; asks", either=WHAT)
    ] = False
    files: Annotated[
        int | None,
        Option(
            "N",
            "so many empty files shall be there; default: half of the room, 64 at most",
            low=1,
            high=LOG_NUMBER_MAX,
        ),
    ] = None
    size: Annotated[
        int,
        Option("MB", f"of each new file (default {LOG_FILE_MIB})", low=1, high=LOG_FILE_MIB_MAX, unit="MB"),
    ] = LOG_FILE_MIB
    copies: Annotated[
        Path,
        Option("DIR", "with --clear: the folder that logs were copied or fetched to (default: this one)"),
    ] = Path()
    yes: Annotated[bool, Option(None, "with --clear: do not ask")] = False
    json: Json = False

    def run(self) -> int:
        """Prepare the card. Returns 0; raises NeuroflightError for what cannot be done."""
        from neuroflight.flash.card.place import open_card

        card = open_card(self.place)
        with one_interrupt():
            if self.list:
                return _list(self, card)
            return _clear(self, card) if self.clear else _prepare(self, card)


def _list(args: OnCard, card: Card) -> int:
    files = card.files()
    told = Account(args.json)
    if not files:
        return told.end([], f"{card.name}: no file for logs; `neuroflight log card {card.name}` makes them")
    if not args.json:
        whole = {True: "yes", False: "no: takes no log", None: "?"}
        rows = [
            (f.name, "-" if f.blank else "a log", f"{f.bytes / 2**20:.0f}", whole[f.whole]) for f in files
        ]
        print_table("", [HEADS, *rows], numbers={"MB"})
    return told.end(_documents(files), _summary(files))


def _documents(files: list[LogFile]) -> list[dict[str, Any]]:
    return [{"name": f.name, "bytes": f.bytes, "log": not f.blank, "whole": f.whole} for f in files]


def _summary(files: list[LogFile]) -> str:
    empty = sum(file.blank and file.whole is not False for file in files)
    return f"{sum(not file.blank for file in files)} with a log, {empty} empty"


def _prepare(args: OnCard, card: Card) -> int:
    from neuroflight.flash.card.files import MEBIBYTE, carry_out, plan_files

    there = card.files()
    plan = plan_files(there, card.free_bytes(), args.size * MEBIBYTE, args.files)
    told = Account(args.json)
    for file in there:
        if not file.blank:
            told.say(f"kept: {file.name}, a log is in it")
    with step_bars(WORDS) as progress:
        files = carry_out(card, plan, progress) if plan.names else there
    told.say(f"{card.name}: {len(plan.names)} new, of {args.size} MB each; {_summary(files)}")
    if any(file.whole is False for file in files):
        told.say("some files do not lie in one piece (--list) and take no log: copy and delete those")
    if any(file.whole is None for file in files):
        told.say(
            "whether each lies in one piece cannot be read here: the aircraft looks, `board logs list` tells"
        )
    return told.end({"new": list(plan.names), "files": _documents(files)})


def _clear(args: OnCard, card: Card) -> int:
    from neuroflight.flash.card.copies import copy_of
    from neuroflight.flash.card.files import behind

    logs = [file for file in card.files() if not file.blank]
    if not args.copies.is_dir():
        raise CardError(f"--copies {args.copies}: no such folder, expected the one with the copied logs")
    with step_bars(WORDS) as progress:
        total = sum(log.bytes for log in logs)
        copied, done = {}, 0
        for log in logs:
            copied[log.name] = copy_of(card, log, args.copies, behind(progress, "compare", done, total))
            done += log.bytes
    told = Account(args.json)
    for name, copy in copied.items():
        told.say(f"{name}: " + (f"the same as {copy}" if copy else f"kept, no whole copy in {args.copies}"))
    clear = [log for log in logs if copied[log.name] is not None]
    document = {
        "copies": {name: None if copy is None else str(copy) for name, copy in copied.items()},
        "emptied": [log.name for log in clear],
    }
    if not clear:
        return told.end(document, f"{card.name}: nothing to empty")
    confirm(args.yes, f"empty {len(clear)} of {len(logs)} logs on {card.name}", "nothing was written")
    with step_bars(WORDS) as progress:
        total, done = sum(log.bytes for log in clear), 0
        for log in clear:
            card.clear(log.name, behind(progress, "clear", done, total))
            done += log.bytes
    return told.end(document, f"{card.name}: {_summary(card.files())}")
