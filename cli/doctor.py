"""`neuroflight doctor`: what is installed, which serial ports there are, and what is missing."""

from __future__ import annotations

import os
import shutil
import stat
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from neuroflight.cli.extras import EXTRAS, ROOT, install_command
from neuroflight.cli.options import PORT_VARIABLE, Json
from neuroflight.cli.requests import Option, Request

if TYPE_CHECKING:
    from neuroflight.flash.usb.devices import SerialDevice

SYSTEM = "sudo apt-get install {}"
PROGRAMS = {  # what needs it, the Debian package that has it
    "arm-none-eabi-gcc": ("images for a board", "gcc-arm-none-eabi libnewlib-arm-none-eabi"),
    "cc": ("the host program, the twin's own C", "gcc"),
    "make": ("every build", "make"),
    "llvm-mca": ("predicted cycles", "llvm"),
    "dfu-util": ("a board in its USB boot loader, and the right to open it", "dfu-util"),
    "stm32flash": ("a peer of `board rescue` in tests", "stm32flash"),
    "gdb-multiarch": ("debugging an emulated board", "gdb-multiarch"),
    "mcopy": ("card images, in tests", "mtools"),
    "mkfs.vfat": ("card images", "dosfstools"),
}
BUILDS = {  # what makes it
    "HOST/neuroflight": "make host",
    "MATEKF722/neuroflight.nfi": "make firmware",
}
GAMEPAD = {"gamepad": ("pygame",)}  # stands beside the others
PATH = f"{os.environ.get('PATH', os.defpath)}:/sbin:/usr/sbin"


@dataclass(frozen=True)
class Finding:
    """A part of the installation that was looked for."""

    kind: str
    name: str
    good: bool
    text: str
    mend: str = ""  # the command that brings it; "" where nothing is missing


@dataclass(frozen=True, kw_only=True)
class Doctor(Request):
    """A request for the state of this computer: installation, ports, missing parts."""

    udev: Annotated[
        bool, Option(None, "print the rules for udev that let this computer's user open boards, and no more")
    ] = False
    json: Json = False

    def run(self) -> int:
        """Print the state, or the rules for udev. Returns 0."""
        from neuroflight.cli.report import print_facts, print_json
        from neuroflight.flash.usb.rules import udev_rules

        if self.udev:
            print_json({"rules": udev_rules()}) if self.json else print(udev_rules(), end="")
            return 0
        found = [*_extras(), *_programs(), *_builds(), *_ports(), *_boards()]
        if self.json:
            print_json({"python": sys.version.split()[0], "found": [asdict(one) for one in found]})
            return 0
        kind = ""
        rows = []
        for one in found:
            text = one.text if one.good else f"{one.text}: {one.mend}" if one.mend else one.text
            rows.append(
                (one.kind if one.kind != kind else "", f"{'+' if one.good else '-'} {one.name}: {text}")
            )
            kind = one.kind
        print_facts([("python", f"+ {sys.version.split()[0]}, {sys.executable}"), *rows])
        return 0


def _extras() -> Iterator[Finding]:
    for extra, packages in {**EXTRAS, **GAMEPAD}.items():
        missing = [package for package in packages if find_spec(package) is None]
        text = f"{', '.join(missing)} missing" if missing else "installed"
        mend = install_command("dev" if extra in GAMEPAD else extra) if missing else ""
        yield Finding("packages", extra, not missing, text, mend)


def _programs() -> Iterator[Finding]:
    for name, (purpose, package) in PROGRAMS.items():
        place = shutil.which(name, path=PATH)
        text = place or f"missing, for {purpose}"
        yield Finding("programs", name, place is not None, text, "" if place else SYSTEM.format(package))


def _builds() -> Iterator[Finding]:
    from neuroflight.sim.ports.betaflight.build import is_built

    found = {name: (command, (ROOT / "build" / name).is_file()) for name, command in BUILDS.items()}
    found["BETAFLIGHT"] = ("neuroflight fly --on betaflight", is_built(ROOT / "build" / "BETAFLIGHT"))
    for name, (command, there) in found.items():
        yield Finding("builds", name, there, "built" if there else "not built", "" if there else command)


def _ports() -> Iterator[Finding]:
    from neuroflight.flash.usb.devices import serial_devices
    from neuroflight.flash.usb.rules import INSTALL

    if given := os.environ.get(PORT_VARIABLE, ""):
        yield Finding("ports", given, True, f"by {PORT_VARIABLE}")
    found = serial_devices()
    for device in found:
        problem, mend = _refused(Path(device.name))
        yield Finding(
            "ports",
            device.name,
            not problem,
            problem or _told(device),
            INSTALL if mend and device.board else mend,
        )
    if not found:
        yield Finding("ports", "none", True, "no serial device is there")


def _told(device: SerialDevice) -> str:
    if device.board:
        return f"a board with Neuroflight, {device.text}"
    return f"{device.text or 'a serial device'}, on USB" if device.usb else "built in; --port has to name it"


def _refused(path: Path) -> tuple[str, str]:
    """Return why this user may not open a device, and the command that mends it; "" and "" where he may."""
    if os.access(path, os.R_OK | os.W_OK):
        return "", ""
    try:
        found = path.stat()
    except OSError as error:
        return error.strerror or "gone", ""
    if not found.st_mode & stat.S_IRGRP:
        return "this user may not open it", f"sudo chmod g+rw {path}"
    return "this user may not open it", f"sudo usermod -aG {_group(found.st_gid)} $USER, then log in anew"


def _group(number: int) -> str:
    import grp

    try:
        return grp.getgrgid(number).gr_name
    except KeyError:
        return str(number)


def _boards() -> Iterator[Finding]:
    """Yield boards on USB that are no serial port now."""
    from neuroflight.flash.usb.devices import usb_devices
    from neuroflight.flash.usb.rules import INSTALL

    for device in usb_devices():
        text = "in the boot loader of its ROM" if device.boot_loader else "shows its card as a disk"
        if device.boot_loader and not device.allowed:
            text = f"{text}; this user may not open it"
        good = device.allowed or not device.boot_loader  # the system opens a disk for its user
        yield Finding("boards", str(device.node), good, text, "" if good else INSTALL)
