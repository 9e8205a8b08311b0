"""`neuroflight fly --blackbox FILE`: the firmware's log of the flight, written to a file."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from neuroflight.toolchain.contract import SETTINGS
from neuroflight.toolchain.errors import NeuroflightError
from neuroflight.toolchain.files import replacing

if TYPE_CHECKING:
    from neuroflight.cli.fly.options import FlyOptions
    from neuroflight.sim.ports.port import Logged

END = b"End of log\0"  # of Betaflight's last event
UART = "USART3"  # as the chip calls UART3
SERIAL = {"blackbox_device": "serial", "uart3_function": "blackbox"}  # on the emulated board


@dataclass(frozen=True)
class LogReport:
    """The log of a flight that is over."""

    file: str | None  # None: it went to the card
    bytes: int  # that went out
    frames: int
    dropped: int  # control steps that the log lacks, as the firmware tells
    ended: bool  # whether it came to its end


class FlightLog:
    """A log on its way."""

    def __init__(self, path: Path | None = None) -> None:
        """path: the file that the log replaces once the flight is over; None: none."""
        self.path = path
        self.source: Callable[[], bytes] = bytes  # gives what came since the last call
        self.told: Callable[[], Logged] | None = None  # what the firmware says of it
        self._undo = ExitStack()
        self.aside: Path | None = None if path is None else self._undo.enter_context(_kept(path))

    def watch(self) -> bool:
        """Keep the bytes since the last call; return True if the log has ended."""
        if self.aside is None:
            told = None if self.told is None else self.told()
            return told is not None and not told.busy and told.frames > 0
        if data := self.source():
            with self.aside.open("ab") as file:
                file.write(data)
        with self.aside.open("rb") as file:
            file.seek(max(0, os.fstat(file.fileno()).st_size - len(END)))
            return file.read() == END

    @property
    def size(self) -> int:
        """Number of bytes in the file so far."""
        return self.aside.stat().st_size if self.aside is not None and self.aside.exists() else 0

    def report(self) -> LogReport:
        """Report on the flight so far; the firmware still runs."""
        ended = self.watch()
        told = None if self.told is None else self.told()
        assert told is not None
        size = told.bytes if self.aside is None else self.size
        file = None if self.path is None else str(self.path)
        return LogReport(file, size, told.frames, told.dropped, ended)

    def rescue(self) -> None:
        """Keep the log of a flight that ends in an error, and say so."""
        self.watch()
        if self.size:
            print(
                f"{self.path}: {self.size:,} bytes of the log, up to the error", file=sys.stderr, flush=True
            )

    def close(self) -> None:
        """Put the file in its place, if there is anything in it. May be called twice."""
        self._undo.close()


class _EmptyError(Exception):
    """An empty log."""


@contextmanager
def _kept(path: Path) -> Iterator[Path]:
    """Replace a file as `replacing` does, but not by an empty one."""
    with suppress(_EmptyError), replacing(path) as aside:
        yield aside
        if aside.stat().st_size == 0:
            raise _EmptyError


def check_blackbox(args: FlyOptions) -> None:
    """Refuse impossible options before anything is opened."""
    if args.blackbox is None:
        return
    if args.on == "betaflight":
        args.refuse("blackbox", because="Betaflight's own log is none of ours; leave it out")
    if args.card is not None:
        where = "with --card the log goes to the card, where docs/guides/logs.md says how to get it"
        args.refuse("blackbox", because=f"{where}; leave --blackbox out")
    changes = _changes(args)
    for name in SERIAL if args.on == "board" else ():
        if name in changes:
            raise NeuroflightError(f"--set {name}: --blackbox chooses it on the emulated board; leave it out")
    if changes.get("blackbox_device") == 0:
        raise NeuroflightError("--blackbox: got blackbox_device=none, expected a log; leave --set ... out")


def emulated_settings(args: FlyOptions) -> dict[str, float]:
    """Return the settings with which the emulated board sends its log."""
    if args.blackbox is None:
        return {}
    choices = {setting.name: setting.choices for setting in SETTINGS}
    return {name: choices[name].index(choice) for name, choice in SERIAL.items()}


def blackbox_baud(args: FlyOptions) -> int:
    """Return the speed of UART3 in this flight."""
    default = next(setting.default for setting in SETTINGS if setting.name == "blackbox_baud")
    return int(_changes(args).get("blackbox_baud", default))


def _changes(args: FlyOptions) -> dict[str, float]:
    from neuroflight.flash.settings.values import parse_change

    return dict(parse_change(text) for text in args.set)


def log_rows(report: LogReport | None) -> list[tuple[str, str]]:
    """Return label and text of each line about the log."""
    if report is None:
        return []
    where = report.file or "on the card"
    if report.frames == 0 and report.bytes == 0:
        return [("blackbox", f"{where}: nothing was logged")]
    steps = "step" if report.dropped == 1 else "steps"
    end = "" if report.ended else ", without its end"
    told = (
        f"{report.bytes:,} bytes, {report.frames:,} frames, {report.dropped:,} control {steps} dropped{end}"
    )
    return [("blackbox", f"{where}: {told}")]
