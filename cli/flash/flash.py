"""`neuroflight flash`: an image from a file onto a board that runs Neuroflight, over its MSP port.

--policy, --list and --revert are of cli/flash/policy_swap.py, --rom of cli/flash/rescue.py.
"""

from __future__ import annotations

import argparse
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from neuroflight.cli.flash import checked, policy_swap, rescue
from neuroflight.cli.flash.image_aircraft import image_aircraft
from neuroflight.cli.flash.progress import step_bars
from neuroflight.cli.flash.tables import print_facts, print_json
from neuroflight.toolchain.errors import NeuroflightError

if TYPE_CHECKING:
    from types import FrameType

    from neuroflight.flash.image.board import Board
    from neuroflight.flash.image.files import ImageFile, Policy
    from neuroflight.flash.image.install import Installation, Installed
    from neuroflight.flash.image.messages import Bank
    from neuroflight.flash.image.plan import InstallPlan
    from neuroflight.flash.settings.text import Value

IMAGE = Path(__file__).resolve().parents[2] / "build" / "MATEKF722" / "neuroflight.nfi"
WORDS = {
    **{"erase": "erasing", "write": "writing", "check": "checking", "policy": "its policy"},
    "prove": "proving",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare image, port and options."""
    parser.add_argument(
        "image",
        type=Path,
        nargs="?",
        metavar="IMAGE",
        help="a build's neuroflight.nfi; or its .elf, .hex or .bin with the .nfi beside it; "
        "default: build/MATEKF722/neuroflight.nfi",
    )
    parser.add_argument(
        "--port",
        required=True,
        metavar="PORT",
        help="tcp:HOST:PORT, serial:DEVICE[:BAUD] or a device such as /dev/ttyUSB0",
    )
    parser.add_argument("--dry-run", action="store_true", help="ask the board, print the plan, write nothing")
    parser.add_argument("--force", action="store_true", help="write it though the board runs this build")
    parser.add_argument(
        "--keep-policy",
        action="store_true",
        help="the new image flies the policy that --policy has put on the board; else it brings its own",
    )
    backup = parser.add_mutually_exclusive_group()
    backup.add_argument(
        "--backup",
        type=Path,
        metavar="FILE",
        help="where the settings go before; default: a new file in this folder",
    )
    backup.add_argument("--no-backup", action="store_true", help="write no such file")
    checked.add_argument(parser)
    policy_swap.add_arguments(parser)
    rom = parser.add_argument_group("through the boot loader in the chip's ROM, as `neuroflight rescue` does")
    rom.add_argument("--rom", action="store_true", help="write to a board that nothing else reaches")
    rom.add_argument("--all", action="store_true", help="with --rom: erase bank B as well")
    rom.add_argument("--verify-only", action="store_true", help="with --rom: compare, write nothing")
    parser.add_argument("--json", action="store_true", help="print JSON")


def run(args: argparse.Namespace) -> int:
    """Install the image. Returns 0, 130 or 143 when stopped by Ctrl-C or SIGTERM; raises NeuroflightError
    of one line that says what was not written."""
    if policy_swap.wanted(args):
        if args.rom or args.image is not None:
            raise NeuroflightError(
                "--policy, --list and --revert got an image or --rom, expected neither; nothing was written"
            )
        return policy_swap.run_policy(args)
    if args.rom:
        args.image = args.image or rescue.IMAGE
        return rescue.run_rom(args)
    if args.all or args.verify_only:
        raise NeuroflightError("--all and --verify-only go with --rom, add it; nothing was written")
    args.image = args.image or IMAGE
    under_way = _UnderWay()
    with _sigterm_stops():
        try:
            return _flash(args, under_way)
        except KeyboardInterrupt as stop:
            by = "SIGTERM" if isinstance(stop, _Terminated) else "Ctrl-C"
            print(f"neuroflight: stopped by {by}: {under_way.consequence}", file=sys.stderr)
            return 143 if isinstance(stop, _Terminated) else 130


class _UnderWay:
    """The installation, once there is one."""

    def __init__(self) -> None:
        self.installation: Installation | None = None

    @property
    def consequence(self) -> str:
        """What it means for the board that nothing more happens."""
        return "nothing was written" if self.installation is None else self.installation.consequence


def _flash(args: argparse.Namespace, under_way: _UnderWay) -> int:
    with _nothing_written():
        from neuroflight.flash.image.board import check_ready, read_board
        from neuroflight.flash.image.files import read_images
        from neuroflight.flash.image.install import Installation
        from neuroflight.flash.image.plan import plan_install
        from neuroflight.flash.image.settings_kept import read_settings
        from neuroflight.flash.link.client import Client
        from neuroflight.flash.link.transport import open_transport

        file = read_images(args.image)
        client = Client(open_transport(args.port))
    try:
        with _nothing_written():
            board = read_board(client)
            plan = plan_install(board, file, keep_policy=args.keep_policy)
            aircraft, check = image_aircraft(file.path, plan), _checked(args, plan)
            facts = _facts(args, file, plan) | {"aircraft": aircraft.document(), "check": check}
            if not args.json:
                print_facts([*_rows(args, file, plan), *aircraft.rows(), ("check", check)])
            aircraft.check(board.port, other_aircraft=args.other_aircraft)
            check_ready(board)
            if args.dry_run or (plan.same_build and not args.force):
                return _leave(args, facts, plan)
            settings = read_settings(client)
            facts["backup"] = _backup(args, board, settings)
        with step_bars(WORDS) as progress:
            under_way.installation = Installation(client, plan, lambda: open_transport(args.port), progress)
            try:
                done = under_way.installation.run(settings, reboot=not args.no_reboot)
            finally:
                client = under_way.installation.client
    finally:
        client.close()
    return _tell(args, facts, done)


def _checked(args: argparse.Namespace, plan: InstallPlan) -> str:
    """What the check found of the policy that the image brings."""
    if plan.policy is None:
        return "no new policy is written"
    unchecked = args.unchecked or args.dry_run
    return checked.checked_image(args.image, plan.policy.sha256, unchecked=unchecked)


def _leave(args: argparse.Namespace, facts: dict[str, object], plan: InstallPlan) -> int:
    """Say why nothing is written, which is no error."""
    told = "--dry-run" if args.dry_run else "the board runs this build already; --force writes it again"
    if args.json:
        print_json(facts | {"result": "dry run" if args.dry_run else "same build"})
    else:
        print(f"{told}: nothing was written")
    return 0


def _backup(args: argparse.Namespace, board: Board, settings: dict[str, Value]) -> str | None:
    """Write the settings into a file; its name."""
    from neuroflight.flash.image.settings_kept import write_backup

    if args.no_backup:
        return None
    name = f"neuroflight-settings-{board.uid[-8:]}-{time.strftime('%Y%m%d-%H%M%S')}.txt"
    path = Path(name) if args.backup is None else args.backup
    write_backup(path, board.target, board.version, settings)
    if not args.json:
        print(f"backup: {len(settings)} settings in {path}; neuroflight msp --port PORT restore {path}")
    return str(path)


def _tell(args: argparse.Namespace, facts: dict[str, object], done: Installed | None) -> int:
    """Say how it ended. Raises NeuroflightError unless the new image runs well. done: None: no restart."""
    from neuroflight.flash.image.trial import Ending

    if done is None:
        if args.json:
            print_json(facts | {"result": "switched"})
        else:
            print("done: the next boot starts the new image, and keeps it if it proves good; --no-reboot")
        return 0
    trial, kept = done.trial, done.kept
    good = trial.ending is Ending.KEPT
    lines = kept.lines if kept is not None else []
    if args.json:
        result = trial.ending.name.lower().replace("_", " ")
        running = {
            "version": trial.version,
            "policy": trial.policy.name,
            "policy_sha256": trial.policy.sha256,
        }
        print_json(facts | {"result": result, "running": running, "settings": lines})
    else:
        for line in lines:
            print(f"settings: {line}")
        if kept is not None and not lines:
            print("settings: all as they were")
    if not good:
        raise NeuroflightError(f"{args.port}: {trial.why}")
    if not args.json:
        policy = f"policy {trial.policy.name} {trial.policy.sha256[:8]}, self-test passed"
        print(f"done: {trial.why}: version {trial.version}, {policy}")
    return 0


# --- What the plan is -------------------------------------------------------------------------------
def _rows(args: argparse.Namespace, file: ImageFile, plan: InstallPlan) -> list[tuple[str, str]]:
    from neuroflight.flash.image.files import bank_name

    board, header = plan.board, plan.image.header
    baud = _baud(args.port)
    line = "a line of unknown speed" if baud is None else f"{baud} baud"
    rows = [
        ("board", f"{board.target}, UID {board.uid}, on {board.port}"),
        (
            "runs",
            f"{bank_name(board.banks.running)}: {_bank_text(board.banks.now)}; "
            f"flies {board.policies.flown_text}",
        ),
        ("image", f"{file.path}: version {header.version}, build {header.build.hex()}"),
        ("SHA-256", plan.image.sha256.hex()),
        (
            "plan",
            f"{bank_name(plan.bank)}: erase sector {', '.join(map(str, plan.sectors))}, write {plan.bytes:,} "
            f"bytes in {plan.frames} frames, about {plan.seconds(baud):.0f} s over {line}",
        ),
        ("policy", _policy_text(plan)),
        ("meanwhile", "the motors stand and nothing arms while flash is written; the old image stays"),
    ]
    if plan.failed_before:
        rows.append(("note", "the board tried this very build before and went back"))
    return rows


def _policy_text(plan: InstallPlan) -> str:
    from neuroflight.flash.policy.slots import NAMES, SHA_SHOWN

    if (policy := plan.policy) is None:
        return f"{plan.board.policies.flown_text} stays and is flown: --keep-policy"
    told = f"aircraft {policy.header.aircraft}, sha256 {policy.sha256[:SHA_SHOWN]}"
    return (
        f"the image's own ({told}): erase {NAMES[plan.slot]}, write {policy.size:,} bytes; "
        "the old image keeps the one that it flies"
    )


def _bank_text(bank: Bank) -> str:
    return f"version {bank.version}, build {bank.build.hex()}" if bank.fits else "a program without a header"


def _facts(args: argparse.Namespace, file: ImageFile, plan: InstallPlan) -> dict[str, object]:
    """What --json tells of the plan."""
    board, header, now = plan.board, plan.image.header, plan.board.banks.now
    return {
        "port": board.port,
        "board": {
            "target": board.target,
            "version": board.version,
            "uid": board.uid,
            "running_bank": board.banks.running,
            "build": now.build.hex() if now.fits else None,
            "policy": board.policies.info.name,
        },
        "image": {
            "file": str(file.path),
            "version": header.version,
            "build": header.build.hex(),
            "sha256": plan.image.sha256.hex(),
            "bytes": plan.bytes,
        },
        "plan": {
            "bank": plan.bank,
            "sectors": list(plan.sectors),
            "frames": plan.frames,
            "seconds": round(plan.seconds(_baud(args.port)), 1),
            "policy": None if plan.policy is None else _policy_facts(plan, plan.policy),
            "keep_policy": args.keep_policy,
            "same_build": plan.same_build,
            "failed_before": plan.failed_before,
        },
    }


def _policy_facts(plan: InstallPlan, policy: Policy) -> dict[str, object]:
    from neuroflight.flash.policy.slots import NAMES

    return {
        "slot": NAMES[plan.slot],
        "aircraft": policy.header.aircraft,
        "sha256": policy.sha256,
        "bytes": policy.size,
    }


def _baud(port: str) -> int | None:
    from neuroflight.flash.link.transport import SerialPort, parse_port

    parsed = parse_port(port)
    return parsed.baud if isinstance(parsed, SerialPort) else None


# --- What goes on meanwhile -------------------------------------------------------------------------
@contextmanager
def _nothing_written() -> Iterator[None]:
    """Errors of the block end with that."""
    from neuroflight.cli.main import os_error_line

    try:
        yield
    except NeuroflightError as error:
        raise NeuroflightError(f"{error}; nothing was written") from None
    except OSError as error:
        raise NeuroflightError(f"{os_error_line(error)}; nothing was written") from None


class _Terminated(KeyboardInterrupt):
    """SIGTERM."""


@contextmanager
def _sigterm_stops() -> Iterator[None]:
    """SIGTERM ends the block as Ctrl-C does, so that it can say what it means for the board."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(number: int, frame: FrameType | None) -> None:
        raise _Terminated

    before = signal.signal(signal.SIGTERM, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
