"""Options that commands share, each with one meaning and one text."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Self

from neuroflight.cli.requests import Option, Request
from neuroflight.toolchain.errors import LinkError, NeuroflightError

if TYPE_CHECKING:
    from neuroflight.flash.usb.devices import UsbDevice
    from neuroflight.sim.blackbox.flight import Part

PORT_HELP = (
    "tcp:HOST:PORT, serial:DEVICE[:BAUD] or a device such as /dev/ttyUSB0; default: NEUROFLIGHT_PORT, or the "
    "only board or serial device on USB"
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


def find_port() -> str:
    """Return NEUROFLIGHT_PORT, the only board on USB or the only USB serial device, and tell which.

    Raises LinkError where there are several, or none. A port that is built in tells nothing of what hangs
    on it.
    """
    from neuroflight.flash.usb.devices import serial_devices, usb_devices

    if given := os.environ.get(PORT_VARIABLE, ""):
        return told(given, PORT_VARIABLE)
    there = [device for device in serial_devices() if device.usb]
    boards = [device for device in there if device.board]
    if len(boards) == 1:
        return told(boards[0].name, f"the only board on USB: {boards[0].text}")
    if len(there) == 1:
        return told(there[0].name, "the only USB serial device")
    if there:
        found = f"got several: {', '.join(device.name for device in boards or there)}"
    else:
        found = "no USB serial device is there"
        found += "".join(f"; {hint}" for hint in sorted({_hint(device) for device in usb_devices()}))
    raise LinkError(f"--port is missing, and {found}; name one with --port or {PORT_VARIABLE}")


def _hint(device: UsbDevice) -> str:
    """Return how a board that is no serial port now becomes one."""
    if device.boot_loader:
        return "a board waits in the boot loader of its ROM: `neuroflight board rescue`, or plug it in anew"
    return "a board shows its card as a disk: eject that and plug the board in anew"


def told(port: str, why: str) -> str:
    """Return the port, after telling the user that it was chosen."""
    print(f"neuroflight: --port {port}, {why}", file=sys.stderr)
    return port


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
FlownSettings = Annotated[
    tuple[str, ...],
    Option("NAME=VALUE", "fly with this setting of the firmware, see docs/reference/settings.md", once=True),
]
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
