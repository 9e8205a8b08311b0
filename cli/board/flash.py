"""`neuroflight board flash`: an image from a file onto a board that runs Neuroflight, over its MSP port."""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from neuroflight.cli.board.built import built_image
from neuroflight.cli.board.checked import Unchecked, checked_image
from neuroflight.cli.board.dfu import find_flash_port
from neuroflight.cli.board.image_aircraft import image_aircraft
from neuroflight.cli.board.state import OnPort
from neuroflight.cli.options import PORT_HELP, Json
from neuroflight.cli.progress import step_bars
from neuroflight.cli.report import print_facts, print_json
from neuroflight.cli.requests import Argument, Option
from neuroflight.toolchain.errors import NeuroflightError

if TYPE_CHECKING:
    from types import FrameType

    from neuroflight.flash.image.board import Board
    from neuroflight.flash.image.files import ImageFile, Policy
    from neuroflight.flash.image.install import Installation, Installed
    from neuroflight.flash.image.messages import Bank
    from neuroflight.flash.image.plan import InstallPlan
    from neuroflight.flash.settings.text import Value

WORDS = {
    **{"erase": "erasing", "write": "writing", "check": "checking", "policy": "its policy"},
    "prove": "proving",
}


@dataclass(frozen=True, kw_only=True)
class Flash(OnPort):
    """An image for a board that runs Neuroflight; the first one, by USB, for any that can take it."""

    port: Annotated[
        str,
        Option(
            "PORT",
            f"{PORT_HELP}, or dfu: a board in its ROM's USB boot loader",
            recorded=False,
            find=find_flash_port,
        ),
    ]
    image: Annotated[
        Path | None,
        Argument(
            "IMAGE",
            "a build's neuroflight.nfi; or its .elf, .hex or .bin with the .nfi beside it; default: that of "
            "the only board that was built for",
        ),
    ] = None
    dry_run: Annotated[bool, Option(None, "ask the board, print the plan, write nothing")] = False
    force: Annotated[bool, Option(None, "write it though the board runs this build")] = False
    keep_policy: Annotated[
        bool,
        Option(
            None,
            "the new image flies the policy that `board policy swap` has put on the board; else it brings "
            "its own",
        ),
    ] = False
    backup: Annotated[
        Path | None, Option("FILE", "where the settings go before; default: a new file in this folder")
    ] = None
    no_backup: Annotated[bool, Option(None, "write no such file")] = False
    unchecked: Unchecked = False
    other_aircraft: Annotated[bool, Option(None, "an image for another aircraft is meant")] = False
    no_reboot: Annotated[
        bool, Option(None, "do not start the board anew: until somebody does it flies what it flew")
    ] = False
    yes: Annotated[bool, Option(None, "replace a firmware of another make without asking")] = False
    json: Json = False

    @property
    def source(self) -> Path:
        """The image that is meant. Raises BuildError: none is named, and several are there."""
        return self.image or built_image("neuroflight.nfi")

    def run(self) -> int:
        """Install the image. Returns 0, 130 or 143 when stopped by Ctrl-C or SIGTERM; raises NeuroflightError
        of one line that says what was not written."""
        if self.backup is not None and self.no_backup:
            raise NeuroflightError("--backup and --no-backup: give one of them; nothing was written")
        with _nothing_written():
            first = _is_first(self.port)
        if first:
            return self._install_first()
        under_way = _UnderWay()
        with _sigterm_stops():
            try:
                return _flash(self, under_way)
            except KeyboardInterrupt as stop:
                by = "SIGTERM" if isinstance(stop, _Terminated) else "Ctrl-C"
                print(f"neuroflight: stopped by {by}: {under_way.consequence}", file=sys.stderr)
                return 143 if isinstance(stop, _Terminated) else 130

    def _install_first(self) -> int:
        """Install by the ROM's USB boot loader, as `board rescue` does."""
        from neuroflight.cli.board.rescue import Rescue

        because = "got it for a board without Neuroflight, which is written whole; leave it out"
        self.refuse("force", "keep_policy", "backup", "other_aircraft", "no_reboot", because=because)
        image = self.source.with_suffix(".hex") if self.source.suffix == ".nfi" else self.source
        return Rescue(
            port=self.port,
            image=image,
            dry_run=self.dry_run,
            unchecked=self.unchecked,
            yes=self.yes,
            json=self.json,
        ).run()


def _is_first(port: str) -> bool:
    """Return whether the board at `port` runs no Neuroflight that takes an image over MSP: it is in its ROM's
    USB boot loader, or has a firmware of another make."""
    from neuroflight.cli.board.state import connect
    from neuroflight.flash.board.info import is_ours
    from neuroflight.flash.rom.dfu_board import is_dfu, runs_firmware

    if is_dfu(port) or not runs_firmware(port):
        return is_dfu(port)
    with connect(port) as client:
        return not is_ours(client)


class _UnderWay:
    """The installation, once there is one."""

    def __init__(self) -> None:
        self.installation: Installation | None = None

    @property
    def consequence(self) -> str:
        """The state of the board if nothing more happens."""
        return "nothing was written" if self.installation is None else self.installation.consequence


def _flash(args: Flash, under_way: _UnderWay) -> int:
    with _nothing_written():
        from neuroflight.flash.image.board import check_ready, read_board
        from neuroflight.flash.image.files import read_images
        from neuroflight.flash.image.install import Installation
        from neuroflight.flash.image.plan import plan_install
        from neuroflight.flash.image.settings_kept import read_settings
        from neuroflight.flash.link.client import Client
        from neuroflight.flash.link.transport import open_transport

        file = read_images(args.source)
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


def _checked(args: Flash, plan: InstallPlan) -> str:
    """Return the verdict of the check on the policy that the image brings."""
    if plan.policy is None:
        return "no new policy is written"
    unchecked = args.unchecked or args.dry_run
    return checked_image(args.source, plan.policy.sha256, unchecked=unchecked)


def _leave(args: Flash, facts: dict[str, object], plan: InstallPlan) -> int:
    """Say why nothing is written, which is no error."""
    told = "--dry-run" if args.dry_run else "the board runs this build already; --force writes it again"
    if args.json:
        print_json(facts | {"result": "dry run" if args.dry_run else "same build"})
    else:
        print(f"{told}: nothing was written")
    return 0


def _backup(args: Flash, board: Board, settings: dict[str, Value]) -> str | None:
    """Write the settings into a file, and return its name."""
    from neuroflight.flash.image.settings_kept import write_backup

    if args.no_backup:
        return None
    name = f"neuroflight-settings-{board.uid[-8:]}-{time.strftime('%Y%m%d-%H%M%S')}.txt"
    path = Path(name) if args.backup is None else args.backup
    write_backup(path, board.target, board.version, settings)
    if not args.json:
        print(f"backup: {len(settings)} settings in {path}; neuroflight board settings restore {path}")
    return str(path)


def _tell(args: Flash, facts: dict[str, object], done: Installed | None) -> int:
    """Say how the installation ended. done: None: the board was not restarted.

    Raises NeuroflightError unless the new image runs well.
    """
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
def _rows(args: Flash, file: ImageFile, plan: InstallPlan) -> list[tuple[str, str]]:
    from neuroflight.flash.image.files import bank_name
    from neuroflight.flash.link.transport import line_baud

    board, header = plan.board, plan.image.header
    baud = line_baud(args.port)
    line = "USB or TCP" if baud is None else f"a line of {baud} baud"
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


def _facts(args: Flash, file: ImageFile, plan: InstallPlan) -> dict[str, object]:
    """Return the facts of the plan that --json prints."""
    from neuroflight.flash.link.transport import line_baud

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
            "seconds": round(plan.seconds(line_baud(args.port)), 1),
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


# --- What goes on meanwhile -------------------------------------------------------------------------
@contextmanager
def _nothing_written() -> Iterator[None]:
    """Add to errors of the block that nothing was written."""
    from neuroflight.cli.main import os_error_line

    try:
        yield
    except NeuroflightError as error:
        raise NeuroflightError(f"{error}; nothing was written") from None
    except OSError as error:
        raise NeuroflightError(f"{os_error_line(error)}; nothing was written") from None


class _Terminated(KeyboardInterrupt):
    """SIGTERM as an exception."""


@contextmanager
def _sigterm_stops() -> Iterator[None]:
    """End the block at SIGTERM as at Ctrl-C, so that it can say what that means for the board."""
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
