"""Images and policy slots over MSP: what is told and refused; lines that spoil, lose and mix frames."""

from __future__ import annotations

import hashlib
import struct
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from neuroflight.flash.link import layouts, requests
from neuroflight.flash.link.msp import Direction, Message, Version, encode
from neuroflight.toolchain.contract import (
    FLASH_BANKS,
    FLASH_POLICY_SLOTS,
    IMAGE_BUILD_BYTES,
    IMAGE_LAYOUT,
    IMAGE_TAIL_BYTES,
    MSP_IMAGE_CONFIRMED,
    MSP_IMAGE_FITS,
    MSP_IMAGE_INSTALLED,
    MSP_IMAGE_NUMBERED,
    MSP_IMAGE_REJECTED,
    Msp,
    Refusal,
    policy_header,
)
from neuroflight.toolchain.contract.msp_layouts import Direction as Speaks
from neuroflight.toolchain.contract.msp_messages import layout_of
from neuroflight.toolchain.image.bank_state import state
from neuroflight.toolchain.policy.blob import PolicyBlob, pack
from tests.firmware.conftest import Chip, Core, scripted_blob
from tests.firmware.images import crc_of, header_of, make_image
from tests.firmware.msp.test_msp_commands import Server, server
from tests.firmware.storage.bank_board import BankBoard, Held, confirmed
from tests.sampling import examples

__all__ = ["server"]  # the fixture
POLICY = policy_header(pack(scripted_blob()))
OLD, ONE, OTHER = (
    make_image(1, 700, bank=0, policy=POLICY),
    make_image(2, 700, policy=POLICY),
    make_image(3, 700, policy=POLICY),
)
PIECE = 128
BOARD, SHA256, BLOB_MAGIC = -19, -24, -7


def digest(image: bytes) -> bytes:
    return hashlib.sha256(image).digest()


def told(s: Server, command: Msp, payload: bytes = b"") -> dict[str, Any]:
    """The reply, read by its layout."""
    layout = layout_of(command, Speaks.REPLY)
    assert layout is not None
    return dict(layouts.decode(layout, s.reply(command, payload), whole=True))


def upload(image: bytes) -> list[tuple[Msp, bytes]]:
    """The requests that bring it, up to its end."""
    pieces = (
        (Msp.IMAGE_WRITE, requests.slot_write(at, image[at : at + PIECE]))
        for at in range(0, len(image), PIECE)
    )
    return [(Msp.IMAGE_BEGIN, header_of(image)), *pieces, (Msp.IMAGE_END, b"")]


def send_policy(s: Server, image: bytes) -> Message:
    """Brings the policy of that image; the answer to its end."""
    s.reply(Msp.POLICY_SLOT_BEGIN, requests.slot_begin(len(pack(scripted_blob()))))
    blob = pack(replace(scripted_blob(), sequence=9, build=header_of(image)[20:28]))
    for at in range(0, len(blob), PIECE):
        s.reply(Msp.POLICY_SLOT_WRITE, requests.slot_write(at, blob[at : at + PIECE]))
    return s.ask(Msp.POLICY_SLOT_END)


def put(s: Server, bank: int, image: bytes, marks: bytes) -> None:
    region = FLASH_BANKS[bank]
    tail = region.size - IMAGE_TAIL_BYTES
    s.chip.fill(region.address, image.ljust(tail, b"\xff") + marks.ljust(IMAGE_TAIL_BYTES, b"\xff"))


# --- What is told ---------------------------------------------------------------------------------
def test_the_banks_are_told_when_asked_for(server: Server) -> None:
    nothing = {
        **dict.fromkeys(("flags", "starts", "sequence", "image_bytes", "crc"), 0),
        "version": bytes(4),
        "build": bytes(IMAGE_BUILD_BYTES),
    }
    assert told(server, Msp.IMAGE_INFO) == {"running": 0, "banks": [nothing, nothing], "layout": IMAGE_LAYOUT}
    put(server, 0, OLD, state(sequence=5, confirmed=True))
    put(server, 1, ONE, b"")
    first: dict[str, Any] = {
        **{"flags": MSP_IMAGE_FITS | MSP_IMAGE_NUMBERED | MSP_IMAGE_CONFIRMED, "starts": 0, "sequence": 5},
        **{"image_bytes": 700, "crc": crc_of(OLD), "version": b"\0\1\0\0", "build": header_of(OLD)[20:28]},
    }
    second: dict[str, Any] = {
        **{"flags": MSP_IMAGE_FITS | MSP_IMAGE_INSTALLED, "starts": 0, "sequence": 0},
        **{"image_bytes": 700, "crc": crc_of(ONE), "version": b"\0\1\0\0", "build": header_of(ONE)[20:28]},
    }
    assert told(server, Msp.IMAGE_INFO) == {"running": 0, "banks": [first, second], "layout": IMAGE_LAYOUT}
    server.core.lib.image_bank_count_start(server.chip.flash, 1)
    server.core.lib.image_bank_reject(server.chip.flash, 1)
    (_, now) = told(server, Msp.IMAGE_INFO)["banks"]
    assert (now["flags"], now["starts"]) == (second["flags"] | MSP_IMAGE_REJECTED, 1)
    server.image.running = 1
    assert told(server, Msp.IMAGE_INFO)["running"] == 1
    put(server, 1, make_image(2, bank=0), state(sequence=5, confirmed=True))
    assert told(server, Msp.IMAGE_INFO)["banks"] == [first, nothing], "an image for another bank is none"


def test_an_image_is_written_hashed_and_switched_to_when_sent(server: Server) -> None:
    put(server, 0, OLD, state(sequence=5, confirmed=True))
    assert told(server, Msp.IMAGE_BEGIN, header_of(ONE)) == {"offset": 0}
    for command, payload in upload(ONE)[1:-1]:
        assert server.reply(command, payload) == b""
        assert (
            told(server, Msp.IMAGE_BEGIN, header_of(ONE))["offset"]
            == struct.unpack_from("<I", payload)[0] + len(payload) - 4
        )
    assert told(server, Msp.IMAGE_END) == {"crc": crc_of(ONE)}
    assert told(server, Msp.IMAGE_HASH, b"\1") == {"sha256": digest(ONE)}
    assert told(server, Msp.IMAGE_HASH, b"\0") == {"sha256": digest(OLD)}
    assert told(server, Msp.IMAGE_SWITCH, digest(ONE)) == {"sequence": 6}
    assert told(server, Msp.IMAGE_INFO)["banks"][1]["flags"] == MSP_IMAGE_FITS | MSP_IMAGE_NUMBERED
    assert server.chip.region(FLASH_BANKS[1])[:700] == ONE


@pytest.mark.parametrize(
    ("command", "payload", "refusal"),
    [
        (Msp.IMAGE_BEGIN, header_of(make_image(1, board="MATEKF722")), (Refusal.IMAGE, BOARD)),
        (Msp.IMAGE_WRITE, requests.slot_write(0, bytes(8)), (Refusal.ORDER, 0)),
        (Msp.IMAGE_END, b"", (Refusal.ORDER, 0)),
        (Msp.IMAGE_HASH, b"\1", (Refusal.IMAGE, -17)),
        (Msp.IMAGE_HASH, b"\2", (Refusal.INDEX, 0)),
        (Msp.IMAGE_SWITCH, bytes(32), (Refusal.IMAGE, -17)),
        (Msp.IMAGE_SWITCH, bytes(33), (Refusal.PAYLOAD, 0)),
        (Msp.POLICY_SLOT_INFO, b"\2", (Refusal.INDEX, 0)),
        (Msp.POLICY_SLOT_REVERT, b"", (Refusal.ORDER, 0)),
    ],
)
def test_a_refusal_says_why_when_nothing_can_be_done(
    server: Server, command: Msp, payload: bytes, refusal: tuple[int, int]
) -> None:
    assert server.refusal(command, payload) == refusal
    assert server.chip.operations == 0


def test_a_damaged_image_is_refused_and_not_switched_to(server: Server) -> None:
    for command, payload in upload(ONE[:-4] + bytes(4))[:-1]:
        server.reply(command, payload)
    assert server.refusal(Msp.IMAGE_END) == (Refusal.IMAGE, -23)
    assert server.refusal(Msp.IMAGE_SWITCH, digest(ONE)) == (Refusal.IMAGE, SHA256 + 1)


def test_nothing_is_switched_to_before_the_image_has_a_policy(server: Server) -> None:
    put(server, 0, OLD, state(sequence=5, confirmed=True))
    server.chip.fill(
        FLASH_POLICY_SLOTS[0].address, pack(replace(scripted_blob(), build=header_of(OLD)[20:28]))
    )
    for command, payload in upload(ONE):
        server.reply(command, payload)
    assert server.refusal(Msp.IMAGE_SWITCH, digest(ONE)) == (Refusal.BLOB, -27)
    assert send_policy(server, OTHER).payload[0] == Refusal.BLOB
    assert server.refusal(Msp.IMAGE_SWITCH, digest(ONE)) == (Refusal.BLOB, -27)
    assert send_policy(server, ONE).direction is Direction.REPLY
    assert told(server, Msp.IMAGE_SWITCH, digest(ONE)) == {"sequence": 6}


def test_slots_are_left_alone_between_the_switch_and_the_proof(server: Server) -> None:
    put(server, 0, OLD, state(sequence=5, confirmed=True))
    for slot, sequence in enumerate((4, 5)):
        server.chip.fill(FLASH_POLICY_SLOTS[slot].address, pack(replace(scripted_blob(), sequence=sequence)))
    server.boot()
    for command, payload in upload(ONE):
        server.reply(command, payload)
    begin = requests.slot_begin(1000)
    server.reply(Msp.IMAGE_SWITCH, digest(ONE))
    before = server.chip.content
    assert server.refusal(Msp.POLICY_SLOT_BEGIN, begin) == (Refusal.ORDER, 0), "ONE is started next"
    assert server.refusal(Msp.POLICY_SLOT_REVERT) == (Refusal.ORDER, 0)
    server.core.lib.image_update_init(server.image, server.chip.flash, 1, b"HOST")
    assert server.refusal(Msp.POLICY_SLOT_BEGIN, begin) == (Refusal.ORDER, 0), "ONE runs and may fail"
    assert server.refusal(Msp.POLICY_SLOT_REVERT) == (Refusal.ORDER, 0)
    assert server.chip.content == before
    assert server.core.lib.image_bank_confirm(server.chip.flash, 1)
    assert server.reply(Msp.POLICY_SLOT_REVERT) == b""


def test_slots_are_told_and_gone_back_to_when_asked(server: Server, scripted_policy_blob: PolicyBlob) -> None:
    for slot, sequence in enumerate((4, 5)):
        blob = replace(scripted_policy_blob, sequence=sequence, aircraft=f"craft{sequence}", idle=0.25)
        server.chip.fill(FLASH_POLICY_SLOTS[slot].address, pack(blob))
    server.boot()
    expected = {
        **{
            "found": 0,
            "flown": 1,
            "sequence": 5,
            "architecture_hash": scripted_policy_blob.architecture_hash,
        },
        **{"filters_hash": scripted_policy_blob.filters_hash, "control_rate": 1000, "idle": 0.25},
        **{"aircraft": "craft5", "policy_sha256": bytes.fromhex(scripted_policy_blob.policy_sha256)},
        "build": bytes(IMAGE_BUILD_BYTES),
    }
    assert told(server, Msp.POLICY_SLOT_INFO, b"\1") == expected
    assert told(server, Msp.POLICY_SLOT_INFO, b"\0") == expected | {
        "flown": 0,
        "sequence": 4,
        "aircraft": "craft4",
    }
    for _ in range(2):
        assert server.reply(Msp.POLICY_SLOT_REVERT) == b""
    gone = told(server, Msp.POLICY_SLOT_INFO, b"\1")
    assert (gone["found"], gone["flown"], gone["sequence"], gone["aircraft"]) == (BLOB_MAGIC, 1, 0, "")
    assert not any(gone["policy_sha256"])
    server.boot()
    assert told(server, Msp.POLICY_SLOT_INFO, b"\0")["flown"] == 1


# --- Lines that spoil frames ----------------------------------------------------------------------
def frame(command: Msp, payload: bytes) -> bytes:
    return encode(Message(Version.V2, Direction.REQUEST, command, payload))


def serve(s: Server, data: bytes) -> bytes:
    """Bytes as they are, and a pause behind them."""
    out = s.core.new("uint8_t[4096]")
    count = s.core.lib.msp_port_serve(s._port, s.status, data, len(data), out, 4096)
    s.core.lib.msp_port_pause(s._port)
    return bytes(out)[:count]


def test_nothing_is_written_when_any_byte_of_a_frame_is_another(server: Server) -> None:
    put(server, 0, OLD, state(sequence=5, confirmed=True))
    spoilt = 0
    for command, payload in [*upload(ONE), (Msp.IMAGE_SWITCH, digest(ONE))]:
        good = frame(command, payload)
        before, written = server.chip.operations, server.image.written
        for at in range(len(good)):
            for wrong in (0x01, 0x80, 0xFF):
                serve(server, good[:at] + bytes([good[at] ^ wrong]) + good[at + 1 :])
                assert (server.chip.operations, server.image.written) == (before, written), (command, at)
                spoilt += 1
        server.reply(command, payload)
    assert spoilt > 3 * 700
    assert server.chip.region(FLASH_BANKS[1])[:700] == ONE


def test_nothing_is_written_when_a_frame_is_cut_anywhere(server: Server) -> None:
    for command, payload in upload(ONE):
        good = frame(command, payload)
        before = server.chip.operations
        for at in range(len(good)):
            serve(server, good[:at])
        assert server.chip.operations == before
        server.reply(command, payload)
    assert server.chip.region(FLASH_BANKS[1])[:700] == ONE


STEPS = st.one_of(
    st.tuples(
        st.just("send"), st.integers(0, 1), st.integers(0, 8)
    ),  # a request of one of two images' uploads
    st.tuples(st.just("switch"), st.integers(0, 1), st.just(0)),
    st.tuples(st.just("restart"), st.just(0), st.just(0)),
)
# Mostly in order, as a line does that loses, doubles and overtakes a frame now and then.
RUNS = st.lists(
    st.one_of(
        STEPS.map(lambda step: [step]),
        st.tuples(st.integers(0, 1), st.lists(st.integers(0, 8), max_size=4), st.integers(0, 8)).map(
            lambda run: [
                ("send", run[0], index)
                for index in sorted([*(set(range(9)) - set(run[1][:1])), *run[1][1:]])
                for _ in range(1 + (index == run[2]))
            ]
        ),
    ),
    max_size=6,
).map(lambda runs: [step for run in runs for step in run])


@settings(max_examples=examples(200), deadline=None, derandomize=True)
@given(steps=RUNS)
def test_never_a_wrong_image_is_accepted_when_frames_are_lost_doubled_and_mixed(
    scripted: Core, steps: list[tuple[str, int, int]]
) -> None:
    images = (ONE, OTHER)
    chip = Chip(scripted)
    scripted.lib.scripted_action = [0.0] * 4
    board = BankBoard(chip, [confirmed(OLD, 5), Held()])
    s = Server(chip)
    for kind, which, detail in steps:
        if kind == "send":
            command, payload = upload(images[which])[detail % len(upload(images[which]))]
            answer = s.ask(command, payload)
            if command is Msp.IMAGE_END and answer.direction is Direction.REPLY:
                crc = struct.unpack("<I", answer.payload)[0]
                (whole,) = (image for image in images if crc_of(image) == crc)
                assert chip.region(FLASH_BANKS[1])[:700] == whole
        elif kind == "switch":
            answer = s.ask(Msp.IMAGE_SWITCH, digest(images[which]))
            if answer.direction is Direction.REPLY:
                assert board.boot().image == images[which]
                return
        else:
            s.core.lib.image_update_init(s.image, chip.flash, 0, b"HOST")
        assert board.boot().image == OLD
    for command, payload in upload(ONE):  # and then an undisturbed line finishes it
        s.ask(command, payload)
    offset = told(s, Msp.IMAGE_BEGIN, header_of(ONE))["offset"]
    assert offset == len(ONE)
    assert told(s, Msp.IMAGE_SWITCH, digest(ONE))["sequence"] == 6
    assert board.boot().image == ONE
