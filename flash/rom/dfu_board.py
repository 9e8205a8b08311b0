"""Boards in the USB boot loader of their chip's ROM: finding, opening, and the way there and back without a
button.

A board there is written "dfu" where it is the only one, or "dfu:3-1.4": bus and ports, as dfu-util -l tells.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable
from dataclasses import dataclass

from neuroflight.flash.board.info import read_info
from neuroflight.flash.board.restart import enter_rom
from neuroflight.flash.link.client import Client, NoAnswerError
from neuroflight.flash.link.transport import LineGoneError, SerialPort, parse_port
from neuroflight.flash.rom.dfu_client import DfuClient
from neuroflight.flash.usb.devices import BOOT_LOADER, serial_devices
from neuroflight.flash.usb.libusb import UsbControl, find_devices, name_of
from neuroflight.toolchain.errors import LinkError

PORT = "dfu"
WAIT_S = 15.0  # for a board to come: it and the system take a second or two
PAUSE_S = 0.2  # between two looks
SETTLE_S = 0.5  # for the system to set up a port's permissions
_MAKES = {"BTFL": "Betaflight", "INAV": "INAV"}


def is_dfu(port: str) -> bool:
    """Return whether a port means a board in its ROM's USB boot loader."""
    return port == PORT or port.startswith(f"{PORT}:")


def dfu_places() -> list[str]:
    """Return the places of boards in their ROM's USB boot loader; none where there is no libusb."""
    try:
        return [name_of(device) for device in find_devices(*BOOT_LOADER)]
    except LinkError:
        return []


def open_dfu(port: str) -> DfuClient:
    """Return a client of the board's ROM that `port` names. Raises LinkError."""
    devices = {name_of(device): device for device in find_devices(*BOOT_LOADER)}
    place = port.removeprefix(PORT).removeprefix(":")
    if not devices or (place and place not in devices):
        there = f"; there are {', '.join(f'{PORT}:{name}' for name in devices)}" if devices else ""
        raise LinkError(
            f"{port}: no board in the USB boot loader of its ROM there{there}; hold BOOT while plugging it "
            f"in, or `neuroflight board reboot --dfu`"
        )
    if not place and len(devices) > 1:
        names = ", ".join(f"{PORT}:{name}" for name in devices)
        raise LinkError(f"{port}: got several boards, expected one; name one of {names}")
    place = place or next(iter(devices))
    return DfuClient(UsbControl(devices[place], f"{PORT}:{place}"))


# --- A firmware that runs ------------------------------------------------------------------------
@dataclass(frozen=True)
class Running:
    """A firmware of any make on a board."""

    ours: bool
    text: str  # its name, version and board
    boards: tuple[str, ...]  # what it calls the board


def runs_firmware(port: str) -> bool:
    """Return whether `port` is the USB serial port of a firmware on an STM32, not an adapter."""
    parsed = None if is_dfu(port) else parse_port(port)
    if not isinstance(parsed, SerialPort):
        return False
    wanted = os.path.realpath(parsed.device)
    return any(device.chip and os.path.realpath(device.name) == wanted for device in serial_devices())


def read_running(client: Client) -> Running:
    """Ask the firmware on the line who it is. Raises LinkError."""
    info = read_info(client)
    names = tuple(name for name in (info.board.name, info.board.target, info.board.identifier) if name)
    if info.armed:
        raise LinkError(f"{client.name}: the motors are armed, expected a disarmed board; disarm first")
    make = "Neuroflight" if info.policy is not None else _MAKES.get(info.variant, info.variant)
    board = names[0] if names else "a board without a name"
    return Running(info.policy is not None, f"{make} {info.version} on {board}", names)


def check_board(client: Client, running: Running, board: str) -> None:
    """Raise LinkError for a firmware that says it is on another board than the image's."""
    if board not in running.boards:
        raise LinkError(
            f"{client.name}: {running.text}, and the image is for a {board}; nothing was written; build one "
            f"with `make firmware TARGET={running.boards[0] if running.boards else 'BOARD'}`, or if it is a "
            f"{board}, plug it in with BOOT held"
        )


def into_dfu(client: Client, wait: Callable[[float], None] = time.sleep) -> str:
    """Have the firmware at the other end start its chip's ROM. Returns the port of the board there.

    `client` is closed. Raises LinkError where the firmware refuses, and where no board comes.
    """
    before = set(dfu_places())
    with client, contextlib.suppress(NoAnswerError, LineGoneError):  # it may go before its answer does
        enter_rom(client)
    for _ in range(round(WAIT_S / PAUSE_S)):
        if new := sorted(set(dfu_places()) - before):
            wait(SETTLE_S)
            return f"{PORT}:{new[0]}"
        wait(PAUSE_S)
    raise LinkError(
        f"{client.name}: the board was asked to start its ROM, and no USB boot loader came within "
        f"{WAIT_S:g} s; is its USB cable in? Else plug it in anew with BOOT held"
    )


def port_back(before: set[str], wait: Callable[[float], None] = time.sleep) -> str | None:
    """Return the serial port of a board that was not among `before`, when it comes; None: it does not."""
    for _ in range(round(WAIT_S / PAUSE_S)):
        for device in serial_devices():
            if device.board and device.name not in before:
                wait(SETTLE_S)
                return device.name
        wait(PAUSE_S)
    return None


def board_ports() -> set[str]:
    """Return the names of serial ports of boards with Neuroflight."""

    return {device.name for device in serial_devices() if device.board}
