"""USB on a board that does not measure the cable's supply, as most do not: the cable counts as plugged in."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from neuroflight.flash.link import requests
from neuroflight.flash.link.client import RefusedError
from neuroflight.flash.rom.segments import content_of, read_segments
from neuroflight.sim.board.core.context import TIME_HZ
from neuroflight.sim.board.devices.sd_card import SdCard
from neuroflight.sim.board.serial.idle_board import IdleBoard
from neuroflight.sim.board.serial.usb_peer import UsbPeer, plug, run
from neuroflight.sim.board.usb.enumeration import complete, enumerate_device
from neuroflight.toolchain.boards.allocation import allocate
from neuroflight.toolchain.boards.description import pack
from neuroflight.toolchain.boards.table import find_board
from neuroflight.toolchain.contract import MOTOR_TEST_MAGIC, Msp, Reboot, Refusal
from neuroflight.toolchain.image.elf import FLASH
from neuroflight.toolchain.image.stamp import stamp
from tests.firmware.storage.card.images import make_image

BOARD = find_board("NERO")  # with a card
MOTORS = 4
UP_S = 1.5  # past the boot's grace, within which nothing can be tested
LEFT_MS = 12  # a host that sleeps, or is gone, is known to after 6 ms without a frame
UNSEEN_MS = 3000  # after which a card is not shown to nobody any more

Make = Callable[..., IdleBoard]


@pytest.fixture(scope="module")
def elf(board_image: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("unsensed") / f"{BOARD.name}.elf"
    stamp(board_image, pack(allocate(BOARD)), path)
    return path


@pytest.fixture
def make(elf: Path) -> Iterator[Make]:
    """Makes a board that is up."""
    made = []

    def powered(card: SdCard | None = None) -> IdleBoard:
        idle = IdleBoard(content_of(read_segments(elf), FLASH), elf=elf, wiring=BOARD, card=card)
        made.append(idle)
        idle.run_to(round(UP_S * TIME_HZ))
        return idle

    yield powered
    for idle in made:
        idle.close()


def turning(idle: IdleBoard) -> bool:
    return bool(max(idle.board.hardware.obeyed(MOTORS)) > 47)


def test_a_host_is_answered_and_motors_stop_at_once_when_the_cable_is_pulled(make: Make) -> None:
    assert BOARD.usb_supply is None
    idle = make()
    for _ in range(2):
        peer = UsbPeer(idle, plug(idle))
        client = peer.client()
        client.request(Msp.MOTOR_TEST, requests.motor_test(MOTOR_TEST_MAGIC))
        client.request(Msp.SET_MOTOR, struct.pack("<4H", *[1100] * MOTORS))
        run(idle, 5)
        assert turning(idle)
        peer.host.unplug()
        run(idle, LEFT_MS)
        assert not turning(idle)
    assert idle.board.report().notes == ()


@pytest.mark.slow
def test_the_card_is_shown_where_a_host_is_seen_until_it_is_not(make: Make, tmp_path: Path) -> None:
    idle = make(SdCard(make_image(tmp_path / "card.img", {"README.TXT": b"a card\n" * 999})))
    with idle.client() as client, pytest.raises(RefusedError) as refused:
        client.request(Msp.REBOOT, bytes([Reboot.CARD]))
    assert refused.value.reason is Refusal.ABSENT
    with UsbPeer(idle, plug(idle)).client() as client:
        client.request(Msp.REBOOT, bytes([Reboot.CARD]))
    host = idle.board.hardware.usb_host
    for connected in (False, True):
        while host.connected is not connected:
            run(idle, 1)
    device = complete(host, enumerate_device(host), idle.run_to)
    assert (device.vendor, device.product, device.interfaces) == (0x0483, 0x5720, ((8, 6, 0x50),))
    run(idle, UNSEEN_MS)
    assert host.connected, "the host is there all along"
    host.unplug()
    run(idle, UNSEEN_MS + 1500)
    with UsbPeer(idle, plug(idle)).client() as client:
        assert client.request(Msp.API_VERSION), "the firmware is back"
