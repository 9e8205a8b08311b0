"""Options and ends that commands on the emulated board share: gyro chip, serial ports, gdb, Ctrl-C."""

from __future__ import annotations

import re
import signal
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from neuroflight.cli.requests import Option
from neuroflight.toolchain.contract import GyroChip
from neuroflight.toolchain.errors import NeuroflightError

if TYPE_CHECKING:
    from neuroflight.sim.board.debug.gdb import GdbServer
    from neuroflight.sim.board.fitted import Lines
    from neuroflight.sim.board.serial.bridge import End

PORT_MAX = 65535
GYROS = tuple(chip.name.lower() for chip in GyroChip)
SETTINGS = {"msp": "msp_baud", "second": "uart3_baud"}  # speed of each serial port
SIGNALS = (signal.SIGINT, signal.SIGTERM)
Gyro = Annotated[
    str | None, Option(None, "the chip that is fitted; default: one that the board carries", choices=GYROS)
]
Card = Annotated[
    Path | None,
    Option(
        "IMG",
        "what keeps logs: the raw image of an SD card, or the content of the board's flash chip, made if "
        "there is none; it is written to; default: an empty slot",
    ),
]


Serials = dict[str, tuple[str, int]]  # by the port's name: kind of end and TCP port


def parse_serials(texts: Sequence[str]) -> Serials:
    """Return each `--serial [uartN=]pty|tcp[:PORT]` by the UART's name, "msp" where it has none."""
    serials: Serials = {}
    for text in texts:
        found = re.fullmatch(r"(?:(uart[1-6])=)?(?:(pty)|tcp(?::(\d{1,5}))?)", text)
        if found is None or int(found[3] or 0) > PORT_MAX:
            raise NeuroflightError(
                f"--serial: got {text!r}, expected pty, tcp or tcp:PORT, for another UART behind uart3="
            )
        name = found[1] or "msp"
        if name in serials:
            raise NeuroflightError(f"--serial: got {name} twice, expected each UART once; leave one out")
        serials[name] = ("pty", 0) if found[2] else ("tcp", int(found[3] or 0))
    return serials


def on_board(serials: Serials, lines: Lines, board: str) -> Serials:
    """Return the same by purpose, "msp" and "second". Raises NeuroflightError where a UART has none there."""
    uarts = {f"uart{lines.msp}": "msp", f"uart{lines.second}": "second"}
    found: Serials = {}
    for name, serial in serials.items():
        purpose = name if name == "msp" and lines.msp is not None else uarts.get(name)
        if purpose is None:
            able = " and ".join(f"{uart} ({what})" for uart, what in uarts.items() if uart != "uartNone")
            raise NeuroflightError(
                f"--serial: got {name}, expected a serial port of {board}: {able or 'it has none, only USB'}"
            )
        if purpose in found:
            raise NeuroflightError(f"--serial: {name} is given twice on {board}; leave one out")
        found[purpose] = serial
    return {purpose: found[purpose] for purpose in SETTINGS if purpose in found}


def parse_usb(text: str) -> int:
    """Return the TCP port of `--usb [HOST:]PORT`, on this computer only."""
    found = re.fullmatch(r"(?:(127\.0\.0\.1|localhost):)?(\d{1,5})", text)
    if found is None or int(found[2]) > PORT_MAX:
        raise NeuroflightError(
            f"--usb: got {text!r}, expected a port of 0 to {PORT_MAX}, with a host 127.0.0.1:PORT: only "
            "programs on this computer are served"
        )
    return int(found[2])


def open_end(serial: tuple[str, int]) -> End:
    """Open the end of a serial line that was asked for."""
    from neuroflight.sim.board.serial.bridge import PtyEnd, TcpEnd

    kind, port = serial
    return PtyEnd() if kind == "pty" else TcpEnd(port)


def check_gdb(port: int | None) -> None:
    """Refuse a `--gdb PORT` that is none."""
    if port is not None and not 0 <= port <= PORT_MAX:
        raise NeuroflightError(f"--gdb: got {port}, expected a port of 0 to {PORT_MAX}, 0 for any")


class Interrupt:
    """The end of a run at Ctrl-C or SIGTERM, between two slices of the board's, where it is not lost."""

    def __init__(self, debugger: GdbServer | None) -> None:
        self._debugger = debugger
        self._came = False

    def __enter__(self) -> Interrupt:
        self._before = {number: signal.signal(number, self._note) for number in SIGNALS}
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def check(self) -> None:
        """Raise KeyboardInterrupt if a signal has come."""
        if self._came:
            raise KeyboardInterrupt

    def _note(self, number: int, frame: object) -> None:
        self._came = True
        if self._debugger is not None and self._debugger.holds:
            raise KeyboardInterrupt  # no slice is running, so nothing is cut short
