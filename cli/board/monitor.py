"""`neuroflight board monitor`: watch a running firmware live."""

from __future__ import annotations

import os
import select
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Annotated

from neuroflight.cli.board.interrupts import one_interrupt
from neuroflight.cli.board.state import OnPort
from neuroflight.cli.report import console, print_json
from neuroflight.cli.requests import Either, Option
from neuroflight.toolchain.errors import LinkError, NeuroflightError

if TYPE_CHECKING:
    from neuroflight.flash.monitoring.watch import Sight, Watch

RATE_DEFAULT, RATE_MAX = 5.0, 20.0  # Hz; a look is a dozen requests, 60 ms at 115200 baud
ENDING_KEYS = b"qQ\x04"  # Ctrl-D as well
ONCE = Either()


@dataclass(frozen=True, kw_only=True)
class Monitor(OnPort):
    """A request to watch a running firmware."""

    rate: Annotated[
        float,
        Option(
            "HZ",
            f"looks a second (default {RATE_DEFAULT:g}, at most {RATE_MAX:g})",
            low=0.1,
            high=RATE_MAX,
            unit="Hz",
        ),
    ] = RATE_DEFAULT
    once: Annotated[bool, Option(None, "look once and print it as text", either=ONCE)] = False
    json: Annotated[bool, Option(None, "look once and print it as JSON", either=ONCE)] = False

    def run(self) -> int:
        """Show it until q or Ctrl-C. Raises NeuroflightError where the first look finds nothing."""
        from neuroflight.flash.link.transport import open_transport
        from neuroflight.flash.monitoring.watch import Watch

        if not (self.once or self.json or sys.stdout.isatty()):
            raise NeuroflightError("stdout is no terminal; give --once or --json")
        with Watch(lambda: open_transport(self.port)) as watch:
            first = watch.look()
            if first.problem:  # a port that never worked is a mistake, one that is lost later is waited for
                raise LinkError(first.problem)
            if self.json:
                print_json(document(first))
            elif self.once:
                from neuroflight.cli.board.monitor_view import lines

                console().print(lines(first, self.port))
            else:
                _show(watch, first, self.port, self.rate)
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
