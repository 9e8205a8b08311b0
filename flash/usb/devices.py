"""Boards among this computer's USB devices: at work, in the ROM's boot loader, or with their card as a disk.

A board at work is a serial port. The system's name of it (/dev/ttyACM0) may be another one after a restart;
its link in /dev/serial/by-id, made of its serial number, is not. Vendor and product alone tell no board: the
chip's maker gives 0483:5740 to every serial port of its chips, Betaflight's among them.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

MAKER = "Neuroflight"  # iManufacturer of a board at work and of its disk
SERIAL_PORT = (0x0483, 0x5740)  # vendor and product: STMicroelectronics, "Virtual COM Port"
DISK = (0x0483, 0x5720)  # "Mass Storage Device"
BOOT_LOADER = (0x0483, 0xDF11)  # of the ROM: "STM Device in DFU Mode"; AN2606

LINKS = Path("/dev/serial/by-id")
DEVICES = Path("/sys/bus/usb/devices")
NODES = Path("/dev/bus/usb")


class SerialDevice(NamedTuple):
    """A serial port of this computer."""

    name: str  # a link that outlasts a restart of the device where the system has one, or its name
    usb: bool
    board: bool  # runs Neuroflight
    text: str  # what it says of itself
    chip: bool = False  # of a firmware on an STM32, whichever: no adapter


@dataclass(frozen=True)
class UsbDevice:
    """A USB device of this computer, of a kind that a board can be."""

    vendor: int
    product: int
    maker: str  # "" where the device has no such text
    name: str
    serial: str
    node: Path  # what a program opens to talk to it

    @property
    def boot_loader(self) -> bool:
        """True for a chip in the boot loader of its ROM."""
        return (self.vendor, self.product) == BOOT_LOADER

    @property
    def disk(self) -> bool:
        """True for a board that shows its card as a disk."""
        return (self.vendor, self.product, self.maker) == (*DISK, MAKER)

    @property
    def allowed(self) -> bool:
        """True if this user may talk to it."""
        return os.access(self.node, os.R_OK | os.W_OK)


def serial_devices() -> Sequence[SerialDevice]:
    """Return the serial ports of this computer, by their names."""
    from serial.tools.list_ports import comports

    links = _links()
    found = []
    for port in sorted(comports(), key=lambda port: port.device):
        board = (port.vid, port.pid) == SERIAL_PORT and port.manufacturer == MAKER
        name = links.get(port.device, port.device) if board else port.device
        chip = (port.vid, port.pid) == SERIAL_PORT
        found.append(SerialDevice(name, port.vid is not None, board, port.description or "", chip))
    return found


def usb_devices() -> Sequence[UsbDevice]:
    """Return boards that are no serial port now: in the ROM's boot loader, or showing a disk. Linux only;
    elsewhere none."""
    return [device for device in _devices() if device.boot_loader or device.disk]


def _links() -> dict[str, str]:
    """Return the links of serial ports by the ports' names."""
    try:
        return {str(link.resolve()): str(link) for link in sorted(LINKS.iterdir())}
    except OSError:
        return {}


def _devices() -> Iterator[UsbDevice]:
    for folder in sorted(DEVICES.glob("*")):
        try:
            vendor, product = (int(_text(folder / name), 16) for name in ("idVendor", "idProduct"))
            bus, number = (int(_text(folder / name)) for name in ("busnum", "devnum"))
        except (OSError, ValueError):  # an interface, or unplugged meanwhile
            continue
        maker, name, serial = (_text_or_none(folder / n) for n in ("manufacturer", "product", "serial"))
        yield UsbDevice(vendor, product, maker, name, serial, NODES / f"{bus:03}" / f"{number:03}")


def _text(path: Path) -> str:
    return path.read_text(errors="replace").strip()


def _text_or_none(path: Path) -> str:
    try:
        return _text(path)
    except OSError:
        return ""
