"""What commands on the emulated board share: where other programs reach it."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from toolchain.errors import NeuroflightError

if TYPE_CHECKING:
    from sim.board.line import End

PORT_MAX = 65535


def parse_serial(text: str) -> tuple[str, int]:
    """Kind of end and TCP port of `--serial pty|tcp[:PORT]`."""
    found = re.fullmatch(r"(pty)|tcp(?::(\d{1,5}))?", text)
    if found is None or int(found[2] or 0) > PORT_MAX:
        raise NeuroflightError(f"--serial: got {text!r}, expected pty, tcp or tcp:PORT")
    return ("pty", 0) if found[1] else ("tcp", int(found[2] or 0))


def open_end(serial: tuple[str, int]) -> End:
    """The end of a serial line that was asked for."""
    from sim.board.line import PtyEnd, TcpEnd

    kind, port = serial
    return PtyEnd() if kind == "pty" else TcpEnd(port)


def check_gdb(port: int | None) -> None:
    """Refuse a `--gdb PORT` that is none."""
    if port is not None and not 0 <= port <= PORT_MAX:
        raise NeuroflightError(f"--gdb: got {port}, expected a port of 0 to {PORT_MAX}, 0 for any")
