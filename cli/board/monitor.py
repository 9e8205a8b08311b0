"""`neuroflight board monitor`: watch a running firmware live."""

from __future__ import annotations

import argparse
import os
import select
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from typing import TYPE_CHECKING

from neuroflight.cli.board.interrupts import one_interrupt
from neuroflight.cli.options import add_port
from neuroflight.cli.tables import console, print_json
from neuroflight.toolchain.errors import LinkError, NeuroflightError

if TYPE_CHECKING:
    from neuroflight.flash.monitoring.watch import Sight, Watch

RATE_DEFAULT, RATE_MAX = 5.0, 20.0  # Hz; a look is a dozen requests, 60 ms at 115200 baud
ENDING_KEYS = b"qQ\x04"  # Ctrl-D as well


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the port, and the form of the display."""
    add_port(parser)
    parser.add_argument(
        "--rate",
        type=float,
        default=RATE_DEFAULT,
        metavar="HZ",
        help=f"looks a second (default {RATE_DEFAULT:g}, at most {RATE_MAX:g})",
    )
    once = parser.add_mutually_exclusive_group()
    once.add_argument("--once", action="store_true", help="look once and print it as text")
    once.add_argument("--json", action="store_true", help="look once and print it as JSON")


def run(args: argparse.Namespace) -> int:
    """Show it until q or Ctrl-C. Returns 0; raises NeuroflightError where the first look finds nothing."""
    from neuroflight.flash.link.transport import open_transport
    from neuroflight.flash.monitoring.watch import Watch

    if not 0.1 <= args.rate <= RATE_MAX:
        raise NeuroflightError(f"--rate got {args.rate:g}, expected 0.1 to {RATE_MAX:g} Hz")
    if not (args.once or args.json or sys.stdout.isatty()):
        raise NeuroflightError("stdout is no terminal; give --once or --json")
    with Watch(lambda: open_transport(args.port)) as watch:
        first = watch.look()
        if first.problem:  # a port that never worked is a mistake, one that is lost later is waited for
            raise LinkError(first.problem)
        if args.json:
            print_json(document(first))
        elif args.once:
            from neuroflight.cli.board.monitor_view import lines

            console().print(lines(first, args.port))
        else:
            _show(watch, first, args.port, args.rate)
    return 0


def document(sight: Sight) -> dict[str, object]:
    """Return the state that was read, as JSON data."""
    from neuroflight.cli.board.state import task_rows

    assert sight.snapshot is not None and sight.info is not None
    snapshot = sight.snapshot
    tasks = None if snapshot.tasks is None else task_rows(snapshot.tasks)
    link = {"corrupt": sight.corrupt, "answer_ms": round(sight.answer_ms, 3)}
    return {"info": asdict(sight.info)} | asdict(snapshot) | {"tasks": tasks, "link": link}


def _show(watch: Watch, first: Sight, port: str, rate_hz: float) -> None:
    from rich.live import Live

    from neuroflight.cli.board.monitor_view import view

    screen, sight = console(), first
    with one_interrupt(), _keys() as pressed:
        try:
            with Live(console=screen, screen=True, auto_refresh=False) as live:
                while True:
                    begin = time.monotonic()
                    live.update(view(sight, port, rate_hz, *screen.size), refresh=True)
                    if pressed(max(0.0, 1 / rate_hz - sight.answer_ms / 1000 - (time.monotonic() - begin))):
                        return
                    sight = watch.look()
        except KeyboardInterrupt:
            pass  # Ctrl-C is the usual way to end it


@contextmanager
def _keys() -> Iterator[Callable[[float], bool]]:
    """Yield a function that waits so many seconds and returns True if a key was pressed that ends."""
    if not sys.stdin.isatty():
        yield _pause
        return
    try:
        import termios
        import tty
    except ImportError:  # a system without them: Ctrl-C ends it
        yield _pause
        return
    handle = sys.stdin.fileno()
    before = termios.tcgetattr(handle)
    tty.setcbreak(handle)

    def pressed(seconds: float) -> bool:
        deadline = time.monotonic() + seconds
        while True:
            ready, _, _ = select.select([handle], [], [], max(0.0, deadline - time.monotonic()))
            if not ready:
                return False
            keys = os.read(handle, 64)
            if not keys or any(key in ENDING_KEYS for key in keys):
                return True

    try:
        yield pressed
    finally:
        termios.tcsetattr(handle, termios.TCSADRAIN, before)


def _pause(seconds: float) -> bool:
    time.sleep(seconds)
    return False
