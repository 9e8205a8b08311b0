"""The image's USB connector on the emulated board: MSP, peers that go, hosts that misbehave, the card."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from neuroflight.flash.link import records, requests
from neuroflight.flash.link.client import Client, RefusedError
from neuroflight.flash.link.msp import Decoder, Direction, Message, Version, encode
from neuroflight.sim.board.core.context import TIME_HZ
from neuroflight.sim.board.debug.snapshot import Snapshot, restore_snapshot, take_snapshot
from neuroflight.sim.board.devices.sd_card import SdCard
from neuroflight.sim.board.serial.idle_board import IdleBoard
from neuroflight.sim.board.serial.usb_peer import DATA_IN, DATA_OUT, Idle, UsbPeer, finish, plug, run
from neuroflight.sim.board.usb.enumeration import Description, complete, enumerate_device, transfer_to
from neuroflight.sim.board.usb.enumeration import request as ask
from neuroflight.sim.board.usb.host import IN, Status
from neuroflight.toolchain.contract import MOTOR_TEST_MAGIC, ArmingReason, Msp, Reboot, Refusal
from neuroflight.toolchain.image.elf import read_flashable
from tests.firmware.storage.card.images import make_image

MOTORS = 4
API = encode(Message(Version.V1, Direction.REQUEST, Msp.API_VERSION, b""))
API_ANSWER = b"$M>\x03\x01\x00\x01\x2f\x2c"
STATUS = encode(Message(Version.V1, Direction.REQUEST, Msp.STATUS, b""))
GET_DESCRIPTOR, STRING = 6, 0x300
UP_S = 1.5  # past the boot's grace, within which nothing can be tested


@pytest.fixture(scope="module")
def booted(board_image: Path) -> Iterator[tuple[IdleBoard, Snapshot, Description]]:
    """A board that a computer has found."""
    idle = IdleBoard(read_flashable(board_image.with_suffix(".bin")), elf=board_image)
    idle.run_to(round(UP_S * TIME_HZ))
    device = plug(idle)
    yield idle, take_snapshot(idle.board.engine), device
    idle.close()


@pytest.fixture
def peer(booted: tuple[IdleBoard, Snapshot, Description]) -> UsbPeer:
    """A program that has the port open."""
    restore_snapshot(booted[0].board.engine, booted[1])
    return UsbPeer(booted[0], booted[2])


def text(peer: UsbPeer, number: int) -> str:
    asked = peer.host.control(
        ask(IN, GET_DESCRIPTOR, STRING | number, 0x409, 255), address=peer.device.address
    )
    return finish(peer.idle, asked).received[2:].decode("utf-16-le")


def serial_of(uid: bytes) -> str:
    """The number that ST's boot loader and other firmware make of a chip's unique id."""
    first, second, third = (int.from_bytes(uid[at : at + 4], "little") for at in (0, 4, 8))
    return f"{(first + third) & 0xFFFFFFFF:08X}{second >> 16:04X}"


def test_a_host_finds_board_policy_and_number_of_the_chip(peer: UsbPeer) -> None:
    assert (peer.device.vendor, peer.device.product) == (0x0483, 0x5740)
    assert peer.device.interfaces == ((2, 2, 1), (10, 0, 0))
    assert text(peer, 1) == "Neuroflight"
    board, _, policy = text(peer, 2).partition(" ")
    with peer.client() as client:
        assert (
            board == client.request(Msp.BOARD_INFO)[9:].split(b"\0")[0][: len(board)].decode() == "MATEKF722"
        )
        name = client.request(Msp.NAME).decode()
        assert policy and name.endswith(policy)
        uid = client.request(Msp.UID)
    assert text(peer, 3) == serial_of(uid)


def test_both_lines_answer_at_once(peer: UsbPeer) -> None:
    with peer.idle.client() as other, peer.client() as client:
        for _ in range(5):
            assert client.request(Msp.FC_VARIANT) == other.request(Msp.FC_VARIANT)


def test_replies_leave_as_fast_as_the_bus_takes_them(peer: UsbPeer) -> None:
    peer.write(STATUS * 2000)
    began, came = peer.clock(), b""
    while peer.clock() - began < 0.1:
        came += peer.read(0.001)
    seconds = peer.clock() - began
    print(f"{len(came) / seconds / 1e3:.0f} KB/s of replies")
    assert len(came) / seconds > 300e3
    assert all(isinstance(one, Message) and one.command == Msp.STATUS for one in Decoder().feed(came))


def locked(client: Client) -> bool:
    """Does a peer forbid arming?"""
    return bool(records.safety(client.request(Msp.SAFETY)).arming_flags >> ArmingReason.MSP & 1)


def turning(idle: Idle) -> bool:
    return bool(max(idle.board.hardware.obeyed(MOTORS)) > 47)


LEFT_MS = 12  # the longest of them: a host that sleeps is known to after 6 ms without a frame
GOING: dict[str, Callable[[UsbPeer], object]] = {
    "drops DTR": lambda peer: peer.lines(0),
    "pulls the cable": lambda peer: peer.host.unplug(),
    "sleeps": lambda peer: peer.host.suspend(),
    "resets the bus": lambda peer: peer.host.reset(),
}


@pytest.mark.parametrize("how", GOING)
def test_a_programs_motors_stop_at_once_when_it_goes(peer: UsbPeer, how: str) -> None:
    """Long before its values are too old."""
    idle, client = peer.idle, peer.client()
    client.request(Msp.MOTOR_TEST, requests.motor_test(MOTOR_TEST_MAGIC))
    client.request(Msp.SET_MOTOR, struct.pack("<4H", *[1100] * MOTORS))
    run(idle, 5)
    assert turning(idle)
    GOING[how](peer)
    run(idle, LEFT_MS)
    assert not turning(idle)


@pytest.mark.parametrize("how", GOING)
def test_motors_stop_and_the_lock_is_lifted_at_once_when_the_peer_goes(peer: UsbPeer, how: str) -> None:
    idle, client = peer.idle, peer.client()
    client.request(Msp.ARMING_DISABLE, b"\1\1")
    client.request(Msp.SET_MOTOR, struct.pack("<4H", *[1100] * MOTORS))
    run(idle, 5)
    assert turning(idle)
    with idle.client() as other:
        assert locked(other)
        GOING[how](peer)
        run(idle, LEFT_MS)
        assert not turning(idle)
        assert not locked(other)


def test_a_host_that_never_reads_stops_nobody_else(peer: UsbPeer) -> None:
    peer.reads = False
    sent = transfer_to(peer.host, peer.device, DATA_OUT, STATUS * 2000)
    run(peer.idle, 100)
    assert not sent.done and sent.sent < 6000, "the board takes no more than it can answer"
    with peer.idle.client() as other:
        assert other.request(Msp.API_VERSION)
    peer.host.cancel(sent)
    peer.lines(0)
    again = UsbPeer(peer.idle, peer.device)
    again.host.cancel_all()
    with again.client() as client:
        assert client.request(Msp.API_VERSION), "the next one is served"


def test_a_host_that_floods_is_answered_in_order_and_delays_no_sample(peer: UsbPeer) -> None:
    peer.write(API * 3000)
    came = b""
    with peer.idle.client() as other:
        for _ in range(20):
            assert other.request(Msp.API_VERSION)
            for _ in range(5):
                came += peer.read(0.001)
    assert came == (API_ANSWER * 3000)[: len(came)] and len(came) > 9000


def test_half_a_request_of_one_peer_is_not_the_nexts(peer: UsbPeer) -> None:
    peer.write(API[:3])
    run(peer.idle, 2)
    peer.lines(0)
    again = UsbPeer(peer.idle, peer.device)
    again.write(API)
    assert again.read(0.1) == API_ANSWER


def test_it_is_found_again_when_plugged_in_again(peer: UsbPeer) -> None:
    for _ in range(2):
        peer.host.unplug()
        run(peer.idle, 50)
        device = plug(peer.idle)
        with UsbPeer(peer.idle, device).client() as client:
            assert client.request(Msp.API_VERSION)


def test_the_supply_alone_changes_nothing(board_image: Path) -> None:
    """A charger: VBUS, and nobody who talks."""
    idle = IdleBoard(read_flashable(board_image.with_suffix(".bin")), elf=board_image)
    idle.board.hardware.otg.vbus(True)
    idle.run_to(round(UP_S * TIME_HZ))
    with idle.client() as client:
        assert client.request(Msp.API_VERSION)
    assert len(idle.board.engine.resets) <= 1
    idle.close()


# --- Starts into something else -----------------------------------------------------------------------------
def test_it_starts_the_boot_loader_by_command(peer: UsbPeer) -> None:
    with peer.client() as client:
        client.request(Msp.REBOOT, bytes([Reboot.ROM]))
    run(peer.idle, 100)
    assert peer.idle.board.hardware.rom.runs


def test_it_starts_the_boot_loader_by_the_letter_of_old_programs(peer: UsbPeer) -> None:
    peer.write(b"AT+GMR")  # as Linux' modem manager asks
    run(peer.idle, 250)
    peer.write(b"R" * 2)
    run(peer.idle, 250)
    assert not peer.idle.board.hardware.rom.runs
    peer.write(b"R")
    run(peer.idle, 100)
    assert peer.idle.board.hardware.rom.runs


def test_a_card_is_not_shown_without_a_cable(peer: UsbPeer) -> None:
    peer.host.unplug()
    run(peer.idle, 20)
    with peer.idle.client() as client, pytest.raises(RefusedError) as refused:
        client.request(Msp.REBOOT, bytes([Reboot.CARD]))
    assert refused.value.reason is Refusal.ABSENT


@pytest.fixture
def with_card(board_image: Path, tmp_path: Path) -> Iterator[tuple[IdleBoard, UsbPeer, Path]]:
    """A board with a card, and a program at its port."""
    path = make_image(tmp_path / "card.img", {"README.TXT": b"a card\n" * 999})
    idle = IdleBoard(read_flashable(board_image.with_suffix(".bin")), elf=board_image, card=SdCard(path))
    idle.run_to(round(UP_S * TIME_HZ))
    yield idle, UsbPeer(idle, plug(idle)), path
    idle.close()


def command(idle: IdleBoard, device: Description, block: bytes, length: int) -> tuple[int, bytes]:
    """A SCSI command: its status and data."""
    host = idle.board.hardware.usb_host
    wrapper = (
        b"USBC" + b"tag1" + length.to_bytes(4, "little") + bytes([IN, 0, len(block)]) + block.ljust(16, b"\0")
    )
    assert finish(idle, transfer_to(host, device, DATA_OUT, wrapper)).status is Status.DONE
    data = b""
    if length:
        came = finish(idle, transfer_to(host, device, DATA_IN, length=length))
        data = came.received
        if came.status is Status.STALLED:
            cleared = host.control(ask(2, 1, 0, DATA_IN), address=device.address)
            assert finish(idle, cleared).status is Status.DONE
    status = finish(idle, transfer_to(host, device, DATA_IN, length=13)).received
    assert status[:8] == b"USBStag1"
    return status[12], data


@pytest.mark.slow
@pytest.mark.parametrize("kind", [Reboot.CARD, Reboot.CARD_UTC])
def test_the_card_is_a_disk_until_it_is_unplugged(
    with_card: tuple[IdleBoard, UsbPeer, Path], kind: Reboot
) -> None:
    idle, peer, path = with_card
    content = path.read_bytes()
    with peer.client() as client:
        client.request(Msp.REBOOT, bytes([kind]))
    host = idle.board.hardware.usb_host
    while host.connected:
        run(idle, 1)
    while not host.connected:
        run(idle, 1)
    device = complete(host, enumerate_device(host), idle.run_to)
    assert (device.vendor, device.product, device.interfaces) == (0x0483, 0x5720, ((8, 6, 0x50),))
    for _ in range(50):
        if command(idle, device, bytes(6), 0)[0] == 0:
            break
        run(idle, 20)
    status, capacity = command(idle, device, bytes([0x25]) + bytes(9), 8)
    assert status == 0 and int.from_bytes(capacity[:4], "big") + 1 == len(content) // 512
    began, data = idle.board.cycle, b""
    while len(data) < 64 * 1024:
        block = bytes([0x28, 0]) + (len(data) // 512).to_bytes(4, "big") + b"\0\0\x40\0"
        status, part = command(idle, device, block, 64 * 512)
        assert status == 0
        data += part
    seconds = (idle.board.cycle - began) / TIME_HZ
    print(f"{len(data) / seconds / 1e3:.0f} KB/s from the card")
    assert data == content[: len(data)] and len(data) / seconds > 800e3
    assert list(idle.board.hardware.obeyed(MOTORS)) == [0] * MOTORS
    host.unplug()
    run(idle, 1500)
    with UsbPeer(idle, plug(idle)).client() as client:
        assert client.request(Msp.API_VERSION), "the firmware is back"
    assert path.read_bytes() == content
