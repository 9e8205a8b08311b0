"""`neuroflight log card`: put empty files for logs onto a card; overwrite nothing on it unasked."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from neuroflight.cli.board.interrupts import one_interrupt
from neuroflight.cli.progress import step_bars
from neuroflight.cli.questions import confirm
from neuroflight.cli.tables import print_json, print_table
from neuroflight.toolchain.errors import CardError, NeuroflightError

if TYPE_CHECKING:
    from neuroflight.flash.card.files import Card, LogFile

MEGABYTES = 64
WORDS = {"write": "writing", "compare": "comparing", "clear": "emptying"}
HEADS = ("file", "holds", "MB", "in one piece")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare place and options."""
    parser.add_argument(
        "place",
        type=Path,
        metavar="PLACE",
        help="the folder where a FAT32 card is mounted, an image file, or a device that is not mounted",
    )
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--list", action="store_true", help="what is there; nothing is written")
    what.add_argument(
        "--clear", action="store_true", help="empty the logs that --copies has whole copies of; asks"
    )
    parser.add_argument(
        "--files",
        type=int,
        metavar="N",
        help="so many empty files shall be there; default: half of the room, 64 at most",
    )
    parser.add_argument(
        "--size", type=int, default=MEGABYTES, metavar="MB", help=f"of each new file (default {MEGABYTES})"
    )
    parser.add_argument(
        "--copies",
        type=Path,
        default=Path(),
        metavar="DIR",
        help="with --clear: the folder that logs were copied or fetched to (default: this one)",
    )
    parser.add_argument("--yes", action="store_true", help="with --clear: do not ask")
    parser.add_argument("--json", action="store_true", help="with --list: print JSON")


def run(args: argparse.Namespace) -> int:
    """Prepare the card. Returns 0; raises NeuroflightError for what cannot be done."""
    from neuroflight.flash.card.files import FILE_BYTES_MAX, MEBIBYTE, NUMBER_MAX
    from neuroflight.flash.card.place import open_card

    if not 1 <= args.size <= FILE_BYTES_MAX // MEBIBYTE:
        raise NeuroflightError(f"--size got {args.size}, expected 1 to {FILE_BYTES_MAX // MEBIBYTE} MB")
    if args.files is not None and not 1 <= args.files <= NUMBER_MAX:
        raise NeuroflightError(f"--files got {args.files}, expected 1 to {NUMBER_MAX}")
    card = open_card(args.place)
    with one_interrupt():
        if args.list:
            return _list(args, card)
        return _clear(args, card) if args.clear else _prepare(args, card)


def _list(args: argparse.Namespace, card: Card) -> int:
    files = card.files()
    if args.json:
        print_json([{"name": f.name, "bytes": f.bytes, "log": not f.blank, "whole": f.whole} for f in files])
        return 0
    if not files:
        print(f"{card.name}: no file for logs; `neuroflight log card {card.name}` makes them")
        return 0
    whole = {True: "yes", False: "no: takes no log", None: "?"}
    print_table(
        HEADS,
        [(f.name, "-" if f.blank else "a log", f"{f.bytes / 2**20:.0f}", whole[f.whole]) for f in files],
        frozenset({"MB"}),
    )
    print(_summary(files))
    return 0


def _summary(files: list[LogFile]) -> str:
    empty = sum(file.blank and file.whole is not False for file in files)
    return f"{sum(not file.blank for file in files)} with a log, {empty} empty"


def _prepare(args: argparse.Namespace, card: Card) -> int:
    from neuroflight.flash.card.files import MEBIBYTE, carry_out, plan_files

    there = card.files()
    plan = plan_files(there, card.free_bytes(), args.size * MEBIBYTE, args.files)
    for file in there:
        if not file.blank:
            print(f"kept: {file.name}, a log is in it")
    with step_bars(WORDS) as progress:
        files = carry_out(card, plan, progress) if plan.names else there
    print(f"{card.name}: {len(plan.names)} new, of {args.size} MB each; {_summary(files)}")
    if any(file.whole is False for file in files):
        print("some files do not lie in one piece (--list) and take no log: copy and delete those")
    if any(file.whole is None for file in files):
        print(
            "whether each lies in one piece cannot be read here: the aircraft looks, `board logs list` tells"
        )
    return 0


def _clear(args: argparse.Namespace, card: Card) -> int:
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
    for log in logs:
        copy = copied[log.name]
        print(f"{log.name}: " + (f"the same as {copy}" if copy else f"kept, no whole copy in {args.copies}"))
    clear = [log for log in logs if copied[log.name] is not None]
    if not clear:
        print(f"{card.name}: nothing to empty")
        return 0
    confirm(args.yes, f"empty {len(clear)} of {len(logs)} logs on {card.name}", "nothing was written")
    with step_bars(WORDS) as progress:
        total, done = sum(log.bytes for log in clear), 0
        for log in clear:
            card.clear(log.name, behind(progress, "clear", done, total))
            done += log.bytes
    print(f"{card.name}: {_summary(card.files())}")
    return 0
