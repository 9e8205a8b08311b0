"""Options that commands share, each with one meaning and one text."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, NamedTuple

from neuroflight.cli.requests import Option
from neuroflight.toolchain.errors import LinkError

PORT_HELP = (
    "tcp:HOST:PORT, serial:DEVICE[:BAUD] or a device such as /dev/ttyUSB0; default: NEUROFLIGHT_PORT, or the "
    "only USB serial device"
)
PORT_VARIABLE = "NEUROFLIGHT_PORT"
ON = ("library", "host", "board", "betaflight")  # what flies: the core in this process, a program, an image
OLD_ON = {"reference": "library", "emulator": "board"}  # earlier names
ON_HELP = (
    "library: the firmware's C core in this process; host: the firmware as a program; board: its image, "
    "emulated; betaflight: Betaflight as a program"
)


class Machine(str):
    """The machine that flies: one of `ON`."""

    said: str  # as the user wrote it, which reports repeat


def machine(text: str) -> Machine:
    """Return the machine of that name, or of its name of before."""
    found = Machine(OLD_ON.get(text, text))
    found.said = text
    return found


class Device(NamedTuple):
    """A serial port of this computer."""

    name: str
    usb: bool
    text: str  # what it says of itself


def find_port() -> str:
    """Return NEUROFLIGHT_PORT or the only device, and tell which. Raises LinkError where there are several.

    Devices on a USB are taken alone: a port that is built in tells nothing of what hangs on it.
    """
    if given := os.environ.get(PORT_VARIABLE, ""):
        return told(given, PORT_VARIABLE)
    there = [device.name for device in devices() if device.usb]
    if len(there) == 1:
        return told(there[0], "the only USB serial device")
    found = f"got several: {', '.join(there)}" if there else "no USB serial device is there"
    raise LinkError(f"--port is missing, and {found}; name one with --port or {PORT_VARIABLE}")


def told(port: str, why: str) -> str:
    """Return the port, after telling the user that it was chosen."""
    print(f"neuroflight: --port {port}, {why}", file=sys.stderr)
    return port


def devices() -> Sequence[Device]:
    """Return the serial ports of this computer."""
    from serial.tools.list_ports import comports

    found = sorted(comports(), key=lambda port: port.device)
    return [Device(port.device, port.vid is not None, port.description or "") for port in found]


Port = Annotated[str, Option("PORT", PORT_HELP, recorded=False, find=find_port)]
Json = Annotated[bool, Option(None, "print JSON", recorded=False)]
Aircraft = Annotated[str, Option("NAME|FILE", "shipped name or a .toml file")]
Seed = Annotated[int, Option("S", "of everything that is drawn", low=0, high=2**32 - 1)]
Plot = Annotated[Path | None, Option("FILE.png", "draw it", recorded=False)]
Jobs = Annotated[int, Option("N", "processes at a time", low=1, high=64, recorded=False)]


def add_port(parser: argparse.ArgumentParser, help: str = PORT_HELP) -> None:
    """Declare --port of a command that has no typed request; `cli.main` finds it where it is not given."""
    parser.add_argument("--port", metavar="PORT", help=help)
    parser.set_defaults(find_port=find_port)


def add_plot(parser: argparse.ArgumentParser, text: str, *, old: str, required: bool = False) -> None:
    """Declare --plot of a command that has no typed request, and its option of before."""
    either = parser.add_mutually_exclusive_group(required=required)
    either.add_argument("--plot", type=Path, metavar="FILE.png", help=text)
    either.add_argument(old, dest="plot", type=Path, default=argparse.SUPPRESS, help=argparse.SUPPRESS)
