"""A second image over the emulated board's UART at 921600 baud: how long it takes, and what runs then."""

from __future__ import annotations

import hashlib
import struct
from pathlib import Path
from typing import Any

import pytest

from neuroflight.flash.board.info import read_info
from neuroflight.flash.link import layouts, requests
from neuroflight.flash.link.client import Client
from neuroflight.sim.board.core.context import TIME_HZ
from neuroflight.sim.board.serial.idle_board import IdleBoard, configured
from neuroflight.toolchain.contract import ARMING_DELAY_MS, MSP_IMAGE_NUMBERED, Msp, image_field_offset
from neuroflight.toolchain.contract.msp_layouts import Direction
from neuroflight.toolchain.contract.msp_messages import layout_of
from tests.firmware.images import header_of

BAUD = 921600
WRITTEN_S = 10.0  # from the erasing to the switch
SWITCHING_S = 0.2  # SHA-256 of all of it, the background standing still


def told(client: Client, command: Msp, payload: bytes = b"") -> dict[str, Any]:
    """The reply, read by its layout."""
    layout = layout_of(command, Direction.REPLY)
    assert layout is not None
    return dict(layouts.decode(layout, client.request(command, payload), whole=True))


def image_of_bank_b(board_image: Path) -> bytes:
    """The second of the two images in the .nfi file."""
    both = board_image.with_suffix(".nfi").read_bytes()
    return both[int(struct.unpack_from("<I", both, image_field_offset("image_bytes"))[0]) :]


@pytest.mark.slow
def test_a_second_image_is_written_in_seconds_and_runs_when_it_was_switched_to(board_image: Path) -> None:
    new = image_of_bank_b(board_image)
    factory = board_image.with_suffix(".bin").read_bytes()
    idle = IdleBoard(configured(factory, board_image, {"msp_baud": BAUD}), elf=board_image)
    idle.run_to((ARMING_DELAY_MS + 500) * TIME_HZ // 1000)
    before = idle.board.cycle
    with idle.client(BAUD) as client:
        reasons = read_info(client).arming_reasons
        assert told(client, Msp.IMAGE_BEGIN, header_of(new)) == {"offset": 0}
        for at in range(0, len(new), requests.SLOT_BYTES_MAX):
            client.request(Msp.IMAGE_WRITE, requests.slot_write(at, new[at : at + requests.SLOT_BYTES_MAX]))
        told(client, Msp.IMAGE_END)
        digest = told(client, Msp.IMAGE_HASH, b"\1")["sha256"]
        assert digest == hashlib.sha256(new).digest()
        last = idle.board.cycle
        assert told(client, Msp.IMAGE_SWITCH, digest + b"\0") == {"sequence": 2}
        assert idle.board.cycle - last < SWITCHING_S * TIME_HZ
        assert idle.board.cycle - before < WRITTEN_S * TIME_HZ
        assert read_info(client).arming_reasons == reasons, "nothing that it did forbids arming"
        client.request(Msp.REBOOT)
        idle.run_to(idle.board.cycle + (ARMING_DELAY_MS + 3000) * TIME_HZ // 1000)
    with idle.client(BAUD) as client:
        info = told(client, Msp.IMAGE_INFO)
        assert info["running"] == 1
        assert info["banks"][1]["flags"] & MSP_IMAGE_NUMBERED
        assert told(client, Msp.IMAGE_HASH, b"\1")["sha256"] == hashlib.sha256(new).digest()
        assert read_info(client).arming_reasons == reasons
    idle.close()
