"""crsf.c and crc8.c: complete frames from any bytes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from neuroflight.toolchain.contract import CRC8_DVB_S2_POLY
from tests.sampling import examples, sampled

SYNC, LINK, CHANNELS, BATTERY = 0xC8, 0x14, 0x16, 0x08
VALUES = [172 + 103 * index for index in range(16)]
Event = tuple[str, Any]
# Two frames that others published, the address of one turned to the flight controller's.
KNOWN = {
    "c81816e1e3de09c7d78a56800f7ce0031ff8c0073ef0810f7c36": [993, 988, 1063, 995, 173, 173, *[992] * 10],
    "c81816e003dfd9c0f78b5f94af7ce52b5ff9ca0700004c7ce223": [
        *[992, 992, 871, 992, 191, 191],
        *[997] * 6,
        *[0, 0, 1811, 1811],
    ],
}


def crc(data: bytes) -> int:
    """Bit by bit, as the polynomial's definition has it."""
    value = 0
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = (value << 1 ^ (CRC8_DVB_S2_POLY if value & 0x80 else 0)) & 0xFF
    return value


def frame(kind: int, payload: bytes, sync: int = SYNC) -> bytes:
    body = bytes([kind]) + payload
    return bytes([sync, len(body) + 1]) + body + bytes([crc(body)])


def channels(values: list[int] = VALUES) -> bytes:
    number = sum(value << 11 * index for index, value in enumerate(values))
    return frame(CHANNELS, number.to_bytes(22, "little"))


def link(quality: int) -> bytes:
    return frame(LINK, bytes([60, 70, quality, 5, 1, 2, 3, 80, 99, 6]))


def microseconds(values: list[int]) -> list[int]:
    return [880 + (5 * value + 4) // 8 for value in values]


def sticks(values: list[int] = VALUES) -> Event:
    return ("channels", microseconds(values))


@pytest.fixture(params=[1, 7, 1000], ids="{}-bytes-at-once".format)
def push(scripted: Any, request: pytest.FixtureRequest) -> Callable[[bytes], list[Event]]:
    """Feeds one parser in pieces of a size; returns what came out."""
    parser, out, lib = scripted.new("struct crsf *"), scripted.new("struct crsf_frame *"), scripted.lib
    assert not lib.crsf_take(parser, False, out)

    def feed(data: bytes) -> list[Event]:
        events: list[Event] = []
        for begin in range(0, len(data), request.param):
            piece = data[begin : begin + request.param]
            while piece:
                taken = lib.crsf_put(parser, piece, len(piece))
                assert 0 < taken <= len(piece)
                piece = piece[taken:]
                while lib.crsf_take(parser, False, out):
                    if out.kind == lib.CRSF_CHANNELS:
                        events.append(("channels", list(out.channels_us)))
                    else:
                        events.append(("link", out.quality))
                assert parser.count < parser.needed <= 64
        return events

    return feed


Push = Callable[[bytes], list[Event]]


# --- CRC --------------------------------------------------------------------------------------
def test_crc_is_the_polynomials_when_bytes_are_random(scripted: Any) -> None:
    rng = np.random.default_rng(1)
    assert scripted.lib.crc8(0, b"123456789", 9) == 0xBC  # the catalogue's check value of DVB-S2
    for length in range(70):
        data = rng.integers(0, 256, length, np.uint8).tobytes()
        assert scripted.lib.crc8(0, data, length) == crc(data)
        half = scripted.lib.crc8(0, data, length // 2)
        assert scripted.lib.crc8(half, data[length // 2 :], length - length // 2) == crc(data)
        assert scripted.lib.crc8(0, data + bytes([crc(data)]), length + 1) == 0


# --- Good frames ------------------------------------------------------------------------------
@pytest.mark.parametrize("text", KNOWN)
def test_channels_are_the_known_ones_when_the_frame_is(push: Push, text: str) -> None:
    assert push(bytes.fromhex(text)) == [sticks(KNOWN[text])]


def test_each_channel_comes_out_when_its_values_run_through_all(push: Push) -> None:
    for value in range(2048):
        values = [(value + 128 * index) % 2048 for index in range(16)]
        assert push(channels(values)) == [sticks(values)]


@pytest.mark.parametrize(("value", "us"), [(172, 988), (191, 999), (992, 1500), (1792, 2000), (1811, 2012)])
def test_a_channel_is_what_transmitters_mean_when_it_is_at_a_mark(push: Push, value: int, us: int) -> None:
    assert push(channels([value] * 16)) == [("channels", [us] * 16)]


@pytest.mark.parametrize(("told", "quality"), [(0, 0), (73, 73), (100, 100), (101, 100), (255, 100)])
def test_quality_comes_out_when_link_statistics_come(push: Push, told: int, quality: int) -> None:
    assert push(link(told)) == [("link", quality)]


def test_frames_of_other_kinds_and_sizes_are_read_over_when_they_are_whole(push: Push) -> None:
    hidden = channels()  # what a frame carries is not for us, whatever it looks like
    others = [
        frame(BATTERY, bytes(8)),
        frame(0x7A, hidden + bytes(3)),
        frame(CHANNELS, bytes(21)),
        frame(LINK, bytes(9)),
        frame(0x28, b""),
        frame(0x7A, bytes([SYNC] * 60)),
    ]
    for other in others:
        assert push(other + channels()) == [sticks()], other.hex()


@pytest.mark.parametrize("more", [1, 2, 38])
def test_what_a_newer_sender_adds_is_ignored_when_frames_are_longer_than_known(push: Push, more: int) -> None:
    tail = bytes(range(0xA0, 0xA0 + more))
    assert push(frame(CHANNELS, channels()[3:-1] + tail)) == [sticks()]
    assert push(frame(LINK, link(50)[3:-1] + tail)) == [("link", 50)]


# --- Bad bytes --------------------------------------------------------------------------------
def test_nothing_comes_out_when_any_bit_of_a_frame_is_wrong(push: Push) -> None:
    good = channels()
    for bit in range(8 * len(good)):
        bad = bytearray(good)
        bad[bit // 8] ^= 1 << bit % 8
        assert push(bytes(bad)) == [], bit
        assert push(b"\x55" * 70) == []  # a length that grew may have kept it waiting


def test_frames_come_out_at_once_when_noise_before_them_has_no_sync(push: Push) -> None:
    rng = np.random.default_rng(2)
    for _ in range(300):
        noise = rng.integers(0, SYNC, rng.integers(0, 100), np.uint8).tobytes()
        assert push(noise) == []
        assert push(channels()[:-1]) == []
        assert push(channels()[-1:]) == [sticks()]


def test_all_frames_inside_a_false_one_come_out_in_order_when_it_turns_out(push: Push) -> None:
    """What looks like the longest frame holds two whole ones: no "off" is lost before the "on"."""
    off, on = [992] * 16, [1792] * 16
    false = bytes([SYNC, 62, 0x7A]) + channels(off) + channels(on)
    assert push(false + bytes(64 - len(false) - 1)) == []
    assert push(b"\x00") == [sticks(off), sticks(on)]


def found(data: bytes) -> list[Event]:
    """The frames of a whole recording, looked for from its beginning."""
    events: list[Event] = []
    at = 0
    while at + 2 <= len(data):
        end = at + 2 + data[at + 1]
        whole = data[at:end]
        if whole[0] != SYNC or not 4 <= len(whole) <= 64 or end > len(data) or crc(whole[2:]) != 0:
            at += 1
            continue
        if whole[2] == CHANNELS and len(whole) >= 26:
            number = int.from_bytes(whole[3:25], "little")
            events.append(sticks([number >> 11 * index & 0x7FF for index in range(16)]))
        if whole[2] == LINK and len(whole) >= 14:
            events.append(("link", min(whole[5], 100)))
        at = end
    return events


@pytest.mark.parametrize("seed", range(examples(24)))
def test_what_comes_out_is_what_a_search_finds_when_frames_are_mixed_with_noise(
    push: Push, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    pieces = []
    for _ in range(150):
        kind = rng.integers(5)
        if kind == 0:
            noise = rng.integers(0, 256, rng.integers(1, 40), np.uint8)
            noise[rng.random(len(noise)) < 0.4] = SYNC
            pieces.append(noise.tobytes())
        elif kind == 1:
            pieces.append(channels()[: rng.integers(1, 26)])
        elif kind == 2:
            pieces.append(link(int(rng.integers(0, 256))))
        else:
            pieces.append(channels(rng.integers(0, 2048, 16).tolist()))
    data = b"".join(pieces) + bytes(64)
    events = push(data)
    assert events == found(data)
    assert len(events) > 40


@pytest.mark.parametrize("length", sampled(range(2, 63), 2, 3, 17, 24, 62))
def test_frames_behind_a_false_beginning_come_out_and_a_half_one_is_forgotten_when_the_line_pauses(
    scripted: Any, length: int
) -> None:
    parser, out, lib = scripted.new("struct crsf *"), scripted.new("struct crsf_frame *"), scripted.lib

    def feed(data: bytes) -> list[int]:
        """Return the link qualities of the frames that came out at once."""
        seen = []
        for byte in data:
            while lib.crsf_take(parser, False, out):
                seen.append(out.quality)
            assert lib.crsf_put(parser, bytes([byte]), 1) == 1
        while lib.crsf_take(parser, False, out):
            seen.append(out.quality)
        return seen

    data = bytes([SYNC, length]) + link(10) + link(20) + link(30)[:-1]
    seen = feed(data)
    while lib.crsf_take(parser, True, out):
        seen.append(out.quality)
    assert seen == [quality for _, quality in found(data)]
    assert seen == [10, 20] or length == 17, "there the CRC of the false frame happens to be right"
    assert parser.count == 0
    assert feed(link(30)[-1:] + link(40)) == [40]


def test_no_more_bytes_are_taken_when_a_frame_waits(scripted: Any) -> None:
    parser, out, lib = scripted.new("struct crsf *"), scripted.new("struct crsf_frame *"), scripted.lib
    assert not lib.crsf_take(parser, False, out)
    inner = channels([992] * 16) + channels([1792] * 16)
    data = bytes([SYNC, 62, 0x7A]) + inner + bytes(61 - len(inner))
    assert len(data) == 64
    for begin, taken in ((0, 1), (1, 1), (2, 62)):
        assert lib.crsf_put(parser, data[begin:], len(data) - begin) == taken
        if begin < 2:
            assert not lib.crsf_take(parser, False, out)
    assert lib.crsf_put(parser, data, len(data)) == 0
    assert lib.crsf_take(parser, False, out)
    assert lib.crsf_put(parser, data, len(data)) == 0, "the second waits"
    assert lib.crsf_take(parser, False, out)
    assert not lib.crsf_take(parser, False, out)
    assert lib.crsf_put(parser, data, len(data)) > 0
