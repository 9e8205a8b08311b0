"""The image on the emulated board as other programs see it over USB/IP, and what a snapshot keeps of it."""

from __future__ import annotations

import os
import random
import re
import shutil
import struct
import subprocess
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from neuroflight.flash.link.msp import Decoder, Message, encode, request
from neuroflight.sim.board.debug.snapshot import restore_snapshot, take_snapshot
from neuroflight.sim.board.serial.idle_board import STEP, IdleBoard
from neuroflight.sim.board.usb.enumeration import Description, complete, enumerate_device, transfer_to
from neuroflight.sim.board.usb.enumeration import request as usb_request
from neuroflight.sim.board.usb.host import FRAME, Status, Transfer
from neuroflight.sim.board.usb.usbip import UsbIpServer
from neuroflight.toolchain.contract import Msp
from tests.sampling import sampled

CDC_OUT, CDC_IN = 0x01, 0x81
DTR = usb_request(0x21, 0x22, 1)  # SET_CONTROL_LINE_STATE
ASKED = (Msp.API_VERSION, Msp.BOARD_INFO, Msp.NAME)


@pytest.fixture
def idle(board_image: Path) -> Iterator[IdleBoard]:
    made = IdleBoard(board_image.with_suffix(".bin").read_bytes(), elf=board_image)
    made.boot()
    yield made
    made.close()


def connect(idle: IdleBoard) -> Description:
    """The cable plugged in, the device enumerated, DTR set."""
    host = idle.board.hardware.usb_host
    host.plug()
    while not host.connected:
        idle.run_to(idle.board.cycle + FRAME)
    found = complete(host, enumerate_device(host), idle.run_to)
    wait(idle, host.control(DTR, address=1))
    return found


def wait(idle: IdleBoard, transfer: Transfer, frames: int = 500) -> Transfer:
    for _ in range(10 * frames):
        if transfer.done:
            assert transfer.status is Status.DONE
            return transfer
        idle.run_to(idle.board.cycle + FRAME // 10)
    raise AssertionError(transfer)


def test_an_unplugged_connector_costs_nothing_once_the_image_is_up(idle: IdleBoard) -> None:
    board = idle.board
    before = {touch.register: (touch.reads, touch.writes) for touch in board.hardware.touched()}
    idle.run_to(board.cycle + 100 * FRAME)
    after = {touch.register: (touch.reads, touch.writes) for touch in board.hardware.touched()}
    usb = [name for name in after if name.startswith("OTG_FS")]
    assert usb and all(after[name] == before.get(name) for name in usb)
    assert board.hardware.usb_host.frames == 0


def test_the_run_goes_on_to_the_bit_when_a_snapshot_amid_a_transfer_is_restored(idle: IdleBoard) -> None:
    found, board = connect(idle), idle.board
    host = board.hardware.usb_host
    transfer_to(host, found, CDC_OUT, b"".join(encode(request(command)) for command in ASKED) * 200)
    for _ in range(100):  # the first short packet ends each
        transfer_to(host, found, CDC_IN, length=4096)
    board.run_to(board.cycle + FRAME // 3)  # not by the idle board, which draws its noise
    snapshot = take_snapshot(board.engine)
    assert {transfer.inward for transfer in host.pending} == {False, True}

    def on() -> tuple[object, ...]:
        transfers = host.pending
        board.run_to(snapshot_cycle + 5 * FRAME)
        return (board.engine.trace_hash, *(transfer.received for transfer in transfers))

    snapshot_cycle = board.cycle
    first = on()
    assert any(first[1:])
    restore_snapshot(board.engine, snapshot)
    assert board.cycle == snapshot_cycle
    assert on() == first


def disturb(idle: IdleBoard, found: Description, chance: random.Random) -> None:
    """One thing that no sensible host does; `found` may be out of date."""
    host = idle.board.hardware.usb_host
    what = chance.randrange(8)
    if what < 4:  # a request of any kind, which is given up at any moment
        kind = chance.choice((0x00, 0x01, 0x02, 0x21, 0x80, 0x81, 0x82, 0xA1, chance.randrange(256)))
        value = chance.choice((0, 1, 2, 0x100, 0x200, 0x303, chance.randrange(65536)))
        index = chance.choice((0, 1, 0x81, 0x82, chance.randrange(65536)))
        number = chance.choice((*range(13), 0x20, 0x21, 0x22, 0x23, chance.randrange(256)))
        if (kind, number) == (0, 5):
            return  # an address of its own: nothing would reach it afterwards
        length = chance.choice((0, 1, 2, 7, 8, 18, 64, 255, chance.randrange(4096)))
        host.control(usb_request(kind, number, value, index, length), chance.randbytes(length), address=1)
    elif what == 4:
        transfer_to(host, found, CDC_OUT, chance.randbytes(chance.choice((0, 1, 63, 64, 65, 500))))
    elif what == 5:
        transfer_to(host, found, CDC_IN, length=chance.choice((1, 64, 1000)))
    elif what == 6:
        host.cancel_all()
    elif chance.random() < 0.3:
        (host.suspend if chance.random() < 0.5 else host.resume)()
    idle.run_to(idle.board.cycle + round(FRAME * chance.choice((0, 0.05, 0.1, 0.7, 2, 8))))


@pytest.mark.slow
@pytest.mark.parametrize("seed", sampled(range(8), 1))
def test_a_host_without_manners_finds_the_device_as_it_was(idle: IdleBoard, seed: int) -> None:
    chance, board = random.Random(seed), idle.board
    host = board.hardware.usb_host
    found = connect(idle)
    for _ in range(4):
        for _ in range(60):
            disturb(idle, found, chance)
        host.resume()
        idle.run_to(board.cycle + 30 * FRAME)
        if chance.random() < 0.5:
            host.reset()
        else:
            host.unplug()
            idle.run_to(board.cycle + FRAME)
        found = connect(idle)
        asked = transfer_to(host, found, CDC_OUT, encode(request(Msp.API_VERSION)))
        heard = b""
        while Msp.API_VERSION not in answers(heard):
            heard += wait(idle, transfer_to(host, found, CDC_IN, length=512)).received
        assert asked.status is Status.DONE
    assert board.report().notes == () and board.report().resets == ("power",)


class Served:
    """A board that runs, and its USB/IP server, while a client talks to it in a thread of its own."""

    def __init__(self, idle: IdleBoard) -> None:
        self.idle, self.server = idle, UsbIpServer([idle.board.hardware.usb_host], 0)
        self.run(200)  # until the device is enumerated: a client waits a quarter of a second of real time

    def run(self, frames: int) -> None:
        for _ in range(frames):
            self.server.exchange(STEP)
            self.idle.run_to(self.idle.board.cycle + STEP)

    def talk(self, client: Callable[[int], Any]) -> Any:
        """What `client` returns, which is called with the server's port in a thread of its own."""
        results: list[Any] = []

        def run() -> None:
            try:
                results.append(client(self.server.port))
            except BaseException as error:
                results.append(error)

        thread = threading.Thread(target=run)
        thread.start()
        while thread.is_alive():
            self.run(1)
        thread.join()
        if isinstance(results[0], BaseException):
            raise results[0]
        return results[0]


@pytest.fixture
def served(idle: IdleBoard) -> Iterator[Served]:
    made = Served(idle)
    yield made
    made.server.close()


def answers(data: bytes) -> list[int]:
    return [event.command for event in Decoder().feed(data) if isinstance(event, Message)]


def test_pyusb_reads_strings_and_speaks_msp_with_the_image(served: Served) -> None:
    backend = pytest.importorskip("usbip_backend.backend")
    core, util = pytest.importorskip("usb.core"), pytest.importorskip("usb.util")

    def client(port: int) -> tuple[list[str], list[int], int]:
        device = core.find(backend=backend.USBIPBackend("127.0.0.1", port), idVendor=0x0483, idProduct=0x5740)
        strings = [util.get_string(device, i) for i in (1, 2, 3)]
        device.ctrl_transfer(0x21, 0x22, 1, 0)
        heard = b""
        for command in ASKED:
            device.write(CDC_OUT, encode(request(command)))
            heard += bytes(device.read(CDC_IN, 512))
        coding = struct.pack("<IBBB", 123_457, 0, 0, 8)  # a rate that no UART has
        device.ctrl_transfer(0x21, 0x20, 0, 0, coding)
        assert bytes(device.ctrl_transfer(0xA1, 0x21, 0, 0, 7)) == coding
        with pytest.raises(core.USBError):
            device.ctrl_transfer(0xC0, 0x55, 0, 0, 8)  # nobody knows it: STALL
        return strings, answers(heard), int(device.ctrl_transfer(0x80, 0, 0, 0, 2)[0])

    strings, heard, status = served.talk(client)
    assert strings[0] == "Neuroflight" and strings[1].startswith("MATEKF722") and len(strings[2]) == 12
    assert heard == list(ASKED)
    assert status & 2 == 0  # no remote wake-up


def test_serial_usbipclient_opens_the_port_and_gets_answers(served: Served) -> None:
    usbip = pytest.importorskip("serial_usbipclient")

    def client(port: int) -> list[int]:
        made = usbip.USBIPClient(remote=("127.0.0.1", port))
        try:
            wanted = usbip.HardwareID(0x0483, 0x5740)
            made.attach(devices=[wanted])
            (usb,) = made.get_connection(wanted)
            heard = b""
            for command in ASKED:
                made.send(usb, encode(request(command)))
                while command not in answers(heard):
                    heard += usb.response_data(timeout=5.0, size=1)
            return answers(heard)
        finally:
            made.shutdown()

    assert served.talk(client) == list(ASKED)


def test_linuxs_own_usbip_lists_the_device(served: Served) -> None:
    program = shutil.which("usbip", path=f"{os.environ.get('PATH', '')}:/usr/sbin")
    if program is None:
        pytest.skip("needs usbip of Debian's package usbip, or of the kernel's tools")

    def client(port: int) -> str:
        words = [program, "--tcp-port", str(port), "list", "-r", "127.0.0.1"]
        return subprocess.run(words, capture_output=True, text=True, timeout=30, check=True).stdout

    told = served.talk(client)
    assert re.search(r"^ +1-1: .*\(0483:5740\)$", told, re.MULTILINE)
    assert re.search(r"^ +: .*\(ef/02/01\)$", told, re.MULTILINE)
    assert re.search(r"^ +: +0 - .*\(02/02/01\)$", told, re.MULTILINE)
    assert re.search(r"^ +: +1 - .*\(0a/00/00\)$", told, re.MULTILINE)
