"""How fast the image is over USB, in the board's own time: replies, a log over MSP, the card as a disk.

A computer in lockstep sits at the connector, on a full-speed bus of 19 packets of 64 bytes a millisecond at
most (1,216 KB/s). Its own thinking takes no time: these are the board's limits. Repeatable to the bit.
"""

from __future__ import annotations

import random
import shutil
import struct
import subprocess
import tempfile
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from neuroflight.flash.link.msp import encode, request
from neuroflight.flash.logs.catalogue import Wait, read_entries, settled_info
from neuroflight.flash.logs.reading import read_bytes
from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.board.core.context import TIME_HZ
from neuroflight.sim.board.devices.sd_card import SdCard
from neuroflight.sim.board.serial.idle_board import IdleBoard
from neuroflight.sim.board.serial.usb_peer import DATA_IN, DATA_OUT, UsbPeer, finish, plug, run
from neuroflight.sim.board.usb.enumeration import Description, transfer_to
from neuroflight.sim.board.usb.host import Transfer
from neuroflight.sim.control.pid_table import pid_table
from neuroflight.toolchain.contract import Msp
from neuroflight.toolchain.image.build import build
from tests.bench.board import AIRCRAFT, POLICY, ROOT

BAR = 500.0  # KB/s of a log
CARD_BYTES, LOG_BYTES, READ_BYTES = 64 << 20, 1 << 20, 200_000
COMMAND_BLOCKS, COMMANDS = 128, 4  # of 512 bytes, as computers ask disks
CARD_MODE = 2  # of REBOOT


@dataclass(frozen=True)
class Row:
    """One figure."""

    name: str
    value: float
    unit: str
    bar: float | None = None


def rows(tell: Callable[[str], None]) -> list[Row]:
    """Build the shipped image and measure it. Needs mtools and dosfstools (make peers)."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        tell("building the image")
        build("MATEKF722", POLICY, ROOT, folder, pid_table(load_aircraft(AIRCRAFT)))
        content = random.Random(1).randbytes(LOG_BYTES)
        card = _card(folder, content)
        image = folder / "MATEKF722" / "neuroflight.bin"
        idle = IdleBoard(image.read_bytes(), elf=image.with_suffix(".elf"), card=SdCard(card))
        with closing(idle):
            idle.boot()
            begun = idle.board.cycle
            device = plug(idle)
            found = [Row("from the plug to a configured device", _ms(idle, begun), "ms")]
            peer = UsbPeer(idle, device)
            tell("MSP over the serial port")
            found += [_round_trip(peer), _log(peer, content), _replies(idle, device)]
            tell("the card as a disk")
            found += _disk(idle, device, card.read_bytes())
        return found


def _ms(idle: IdleBoard, since: int) -> float:
    return 1000 * (idle.board.cycle - since) / TIME_HZ


def _card(folder: Path, log: bytes) -> Path:
    assert shutil.which("mcopy"), "mtools are missing; run: make peers"
    card, file = folder / "card.img", folder / "LOG00001.BBL"
    card.write_bytes(bytes(CARD_BYTES))
    file.write_bytes(log)
    mkfs = shutil.which("mkfs.vfat") or "/sbin/mkfs.vfat"
    subprocess.run([mkfs, "-F", "32", str(card)], check=True, capture_output=True)
    subprocess.run(["mcopy", "-i", str(card), str(file), "::"], check=True)
    return card


def _round_trip(peer: UsbPeer, count: int = 50) -> Row:
    client = peer.client()
    begun = peer.clock()
    for _ in range(count):
        client.request(Msp.STATUS)
    return Row("an MSP request and its answer", 1000 * (peer.clock() - begun) / count, "ms")


def _log(peer: UsbPeer, content: bytes) -> Row:
    client = peer.client()
    wait = Wait(peer.clock, lambda seconds: run(peer.idle, 1000 * seconds))
    (entry,) = read_entries(client, settled_info(client, wait), wait)
    begun = peer.clock()
    assert read_bytes(client, entry.index, 0, READ_BYTES, peer.clock) == content[:READ_BYTES]
    return Row("a log from the card over MSP", READ_BYTES / 1000 / (peer.clock() - begun), "KB/s", BAR)


def _replies(idle: IdleBoard, device: Description, ms: int = 300) -> Row:
    """Requests as many as the bus takes, all of it read."""
    host, heard = idle.board.hardware.usb_host, 0
    asked = encode(request(Msp.BOARD_INFO)) * 500

    def send(_: Transfer | None = None) -> None:
        transfer_to(host, device, DATA_OUT, asked).on_end = send

    def read(ended: Transfer | None = None) -> None:
        nonlocal heard
        heard += len(ended.received) if ended else 0
        transfer_to(host, device, DATA_IN, length=4096).on_end = read

    send()
    read()
    run(idle, 50)
    heard = 0
    run(idle, ms)
    for transfer in host.pending:
        transfer.on_end = None
    host.cancel_all()
    return Row("MSP replies to a flood of requests", heard / ms, "KB/s")


def _disk(idle: IdleBoard, device: Description, card: bytes) -> list[Row]:
    """Restart into the disk; then READ(10), one command after another."""
    host = idle.board.hardware.usb_host
    host.unplug()
    run(idle, 20)
    device = plug(idle)
    finish(idle, transfer_to(host, device, DATA_OUT, encode(request(Msp.REBOOT, bytes([CARD_MODE])))))
    begun = idle.board.cycle
    while host.connected:
        run(idle, 1)
    device = plug(idle, 5)
    while _scsi(idle, device, bytes(6), 0)[1]:  # TEST UNIT READY, until the card is
        _scsi(idle, device, bytes([3, 0, 0, 0, 18, 0]), 18)
        run(idle, 10)
    ready, begun = _ms(idle, begun), idle.board.cycle
    count = COMMAND_BLOCKS * 512
    for i in range(COMMANDS):
        command = struct.pack(">BBIBHB", 0x28, 0, i * COMMAND_BLOCKS, 0, COMMAND_BLOCKS, 0)
        assert _scsi(idle, device, command, count) == (card[i * count : (i + 1) * count], 0)
    return [
        Row("from REBOOT to a disk that is ready", ready, "ms"),
        Row("the card as a disk", COMMANDS * count / _ms(idle, begun), "KB/s", BAR),
    ]


def _scsi(idle: IdleBoard, device: Description, command: bytes, length: int) -> tuple[bytes, int]:
    """Data and status of a command that reads (USB Mass Storage, bulk-only transport)."""
    host = idle.board.hardware.usb_host
    block = struct.pack("<4sIIBBB", b"USBC", 1, length, 0x80, 0, len(command)) + command.ljust(16, b"\0")
    finish(idle, transfer_to(host, device, DATA_OUT, block))
    data = finish(idle, transfer_to(host, device, DATA_IN, length=length)).received if length else b""
    return data, finish(idle, transfer_to(host, device, DATA_IN, length=13)).received[12]


def print_table(measured: list[Row]) -> None:
    for row in measured:
        bar = "" if row.bar is None else f"   (bar: {row.bar:g})"
        print(f"{row.name:44}{row.value:10,.1f} {row.unit}{bar}")
