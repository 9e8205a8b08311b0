"""A computer at the emulated board's USB cable, made of hosts that are not ours: programs run unchanged.

`Computer` stands for kernel and udev: while the board shows a serial port, serial-usbipclient serves it, and
a pseudo terminal with a link in a folder like /dev/serial/by-id is what programs open. Both go when the board
goes, and come back with it. DTR is set while a program has the terminal open, as Linux does. `plug` gives a
process that USB: pyusb's libusb is a USB/IP client there, and pyserial lists the links.

As a program: PORT FOLDER MODULE WORDS... runs MODULE's `main` at that computer.
"""

from __future__ import annotations

import contextlib
import importlib
import logging
import os
import select
import socket
import sys
import threading
import tty
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import serial.tools.list_ports
import usb.backend.libusb1
from serial.tools.list_ports_common import ListPortInfo
from serial_usbipclient import HardwareID, USBIPClient
from serial_usbipclient.protocol.urb_packets import UrbSetupPacket
from serial_usbipclient.usbip_client import (
    USBIP_Connection,
    USBIPError,
    USBIPResponseTimeoutError,
)
from usbip_backend import get_backend

from neuroflight.flash.usb import devices

LOOPBACK = "127.0.0.1"
SERIAL_PORT = HardwareID(vid=0x0483, pid=0x5740)
PAUSE_S = 0.1  # between two looks for a device
LINES = 0x03  # DTR and RTS, of SET_CONTROL_LINE_STATE
READ_MAX = 2048
logging.getLogger("serial_usbipclient").setLevel(logging.CRITICAL)


def plug(port: int, links: Path, put: Callable[[Any, str, Any], None] = setattr) -> None:
    """Make the USB/IP server on `port` the only USB of this process, and `links` its serial ports.

    put: what sets an attribute, monkeypatch's in tests.
    """
    links.mkdir(exist_ok=True)
    one = get_backend(LOOPBACK, port)

    def backend(find_library: Any = None) -> Any:
        one._devices = None  # it keeps what it found first, for ever
        one._conns = {key: conn for key, conn in one._conns.items() if not conn._closed}
        return one

    def comports() -> list[ListPortInfo]:
        found = []
        for link in sorted(links.iterdir()):
            info = ListPortInfo(str(link.resolve()))
            maker, text = link.name.removeprefix("usb-").removesuffix("-if00").split("_", 1)
            product, _, info.serial_number = text.replace("_", " ").rpartition(" ")
            info.manufacturer, info.product = maker, product
            info.vid, info.pid = SERIAL_PORT.vid, SERIAL_PORT.pid
            info.apply_usb_info()
            found.append(info)
        return found

    put(usb.backend.libusb1, "get_backend", backend)
    put(serial.tools.list_ports, "comports", comports)
    put(devices, "LINKS", links)


class Computer:
    """Serves the board's serial port at a link in `links`, in a thread, until closed."""

    def __init__(self, port: int, links: Path) -> None:
        self.port, self.links = port, links
        self.served = 0  # serial ports so far
        self._ended = threading.Event()
        self._backend = get_backend(LOOPBACK, port)
        self._thread = threading.Thread(target=self._live, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._ended.set()
        self._thread.join()

    def ids(self) -> list[tuple[int, int]]:
        """Vendor and product of each device that is there."""
        self._backend._devices = None
        try:
            return [(one.id_vendor, one.id_product) for one in self._backend.enumerate_devices()]
        except usb.core.USBError:
            return []

    def _live(self) -> None:
        while not self._ended.wait(PAUSE_S):
            if (SERIAL_PORT.vid, SERIAL_PORT.pid) not in self.ids():
                continue
            with contextlib.suppress(USBIPError, OSError, ValueError):
                self._serve()

    def _serve(self) -> None:
        """Be the driver of one serial port, until it goes."""
        client = USBIPClient((LOOPBACK, self.port))
        client.URB_QUEUE_MIN, client.URB_QUEUE_MAX = 2, 4  # requests to read; as many as it has cost more
        client.connect_server()
        client.attach([SERIAL_PORT])
        (line,) = client.get_connection(SERIAL_PORT)
        maker, product, number = (_text(client, line, index) for index in (1, 2, 3))
        master, slave = os.openpty()
        tty.setraw(slave)
        link = self.links / f"usb-{maker}_{product}_{number}-if00".replace(" ", "_")  # as udev writes it
        link.symlink_to(os.ttyname(slave))
        os.close(slave)
        self.served += 1
        try:
            self._carry(client, line, master)
        finally:
            link.unlink()
            os.close(master)
            with contextlib.suppress(USBIPError, OSError, ValueError, AttributeError):
                line.socket.shutdown(2)
                line.socket.close()

    def _carry(self, client: USBIPClient, line: USBIP_Connection, master: int) -> None:
        connection = line.socket
        raw = connection.raw_socket
        watch = select.poll()
        watch.register(raw, select.POLLIN)
        opened = False
        while not self._ended.is_set():
            client.queue_urbs(line)
            terminal = _poll(master)
            if opened == bool(terminal & select.POLLHUP):
                opened = not opened
                _set_lines(client, line, LINES if opened else 0)
            if terminal & select.POLLIN:
                _send(client, line, os.read(master, READ_MAX))
            if watch.poll(0 if terminal & select.POLLIN else 5):
                if not _alive(line):
                    return
                line.wait_for_response()
            for number in list(line.response_sequences):
                data = line._responses.pop(number).payload
                line._commands.pop(number)
                while data:
                    data = data[os.write(master, data) :]


def _alive(line: USBIP_Connection) -> bool:
    """False when the server has ended the connection, as it does when the device goes."""
    try:
        return bool(line.socket.raw_socket.recv(1, socket.MSG_PEEK))
    except (TimeoutError, BlockingIOError):
        return True


def _poll(terminal: int) -> int:
    """What a terminal's master tells: POLLIN, and POLLHUP while no program has it open."""
    watch = select.poll()
    watch.register(terminal, select.POLLIN)
    return next((event for _, event in watch.poll(0)), 0)


def _text(client: USBIPClient, line: USBIP_Connection, index: int) -> str:
    """A string of the device."""
    setup = UrbSetupPacket(request_type=0x80, request=6, value=0x0300 | index, index=0x0409, length=255)
    client.send_setup(setup=setup, usb=line)
    header = client.readall(48, line, timeout=3.0)
    data = client.readall(int.from_bytes(header[24:28], "big"), line)
    return bytes(data[2:]).decode("utf-16-le")


def _send(client: USBIPClient, line: USBIP_Connection, data: bytes) -> None:
    """Write to the port, however long the board takes: it answers nothing for seconds while it erases."""
    try:
        client.send(line, data)
    except USBIPResponseTimeoutError:  # after a quarter of a second
        _finish(line)
        line._commands.pop(line.seqnum)


def _finish(line: USBIP_Connection) -> None:
    """Wait for the answer to the last request."""
    while line.seqnum not in line._responses:
        with contextlib.suppress(USBIPResponseTimeoutError):
            if not line.wait_for_response() and not _alive(line):
                raise USBIPError("it went")
    line._responses.pop(line.seqnum)


def _set_lines(client: USBIPClient, line: USBIP_Connection, lines: int) -> None:
    """SET_CONTROL_LINE_STATE as a system does it; serial-usbipclient's own puts the bits elsewhere."""
    setup = UrbSetupPacket(request_type=0x21, request=0x22, value=lines, index=0, length=0)
    client.send_setup(setup=setup, usb=line)
    _finish(line)


def wait_until(done: Callable[[], Any], seconds: float = 30.0) -> Any:
    """What `done` returns as soon as that is true. Fails after so long."""
    event = threading.Event()
    for _ in range(round(seconds / PAUSE_S)):
        if found := done():
            return found
        event.wait(PAUSE_S)
    raise AssertionError(f"nothing came within {seconds} s")


@contextlib.contextmanager
def computer(port: int, links: Path) -> Iterator[Computer]:
    """A computer at the cable until the end of the block."""
    links.mkdir(exist_ok=True)
    one = Computer(port, links)
    try:
        yield one
    finally:
        one.close()


if __name__ == "__main__":
    plug(int(sys.argv[1]), Path(sys.argv[2]))
    sys.argv = sys.argv[3:]
    sys.exit(importlib.import_module(sys.argv[0]).main())
