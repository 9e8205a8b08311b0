"""Options that commands share, each with one meaning and one text."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple, Self

from neuroflight.cli.requests import Option, Request
from neuroflight.toolchain.errors import LinkError, NeuroflightError

if TYPE_CHECKING:
    from neuroflight.sim.blackbox.flight import Part

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
    """The machine that flies: one of `ON`, by its name or that of before."""

    said: str  # as the user wrote it, which reports repeat

    def __new__(cls, text: str) -> Self:
        found = super().__new__(cls, OLD_ON.get(text, text))
        found.said = text
        return found


HOST = Machine("host")
On = Annotated[Machine, Option(None, f"what flies; default host. {ON_HELP}", choices=ON)]


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


def picture(text: str) -> Option:
    """Return the option of a picture that is drawn on request."""
    return Option("FILE.png", text, suffix=".png", recorded=False)


Port = Annotated[str, Option("PORT", PORT_HELP, recorded=False, find=find_port)]
Json = Annotated[bool, Option(None, "print JSON", recorded=False)]
Build = Annotated[Path | None, Option("DIR", "Betaflight's build; default: build/BETAFLIGHT", recorded=False)]
Aircraft = Annotated[str, Option("NAME|FILE", "shipped name or a .toml file")]
Seed = Annotated[int, Option("S", "of everything that is drawn", low=0, high=2**32 - 1)]
Plot = Annotated[Path | None, picture("draw it")]
Jobs = Annotated[int, Option("N", "processes at a time", low=1, high=64, recorded=False)]
Header = Annotated[
    tuple[str, ...],
    Option(
        "NAME=VALUE",
        "take a log as if its header had this line, which it lost or its firmware does not write; may be "
        "given several times",
        once=True,
    ),
]


@dataclass(frozen=True, kw_only=True)
class OfPart(Request):
    """A request about a part of a recording."""

    start: Annotated[
        float | None,
        Option("S", "where the part begins, seconds since the first sample", low=0.0, name="--from"),
    ] = None
    stop: Annotated[float | None, Option("S", "where it ends; default: the end", name="--to")] = None

    @property
    def part(self) -> Part:
        """The part. Raises NeuroflightError if it is empty."""
        from neuroflight.sim.blackbox.flight import Part

        start = self.start or 0.0
        if self.stop is not None and not self.stop > start:
            raise NeuroflightError(f"--to {self.stop:g}, expected more than --from, {start:g}")
        return Part(start, self.stop)


@dataclass(frozen=True, kw_only=True)
class OfRecording(OfPart):
    """A request that flies recorded commands."""

    header: Header = ()
    cut_rates: Annotated[
        bool, Option(None, "fly recorded rates beyond full stick (1000 deg/s) as full stick, not refuse them")
    ] = False
