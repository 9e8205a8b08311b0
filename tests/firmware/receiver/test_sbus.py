"""sbus.c: complete frames from any bytes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

SBUS2_FOOTERS = (0x04, 0x14, 0x24, 0x34)  # of an R7008SB, one after another

Encode = Callable[..., bytes]
VALUES = [172 + 103 * index for index in range(16)]  # no 0x0F and no 0x00 among their bytes


def parser_of(scripted: Any) -> Callable[[bytes], list[Any]]:
    """Return what feeds a parser of its own and returns the frames that came out."""
    parser, frame = scripted.new("struct sbus *"), scripted.new("struct sbus_frame *")
    scripted.lib.sbus_reset(parser)

    def feed(data: bytes) -> list[tuple[list[int], bool, bool]]:
        frames = []
        for byte in data:
            if scripted.lib.sbus_push(parser, byte, frame):
                frames.append((list(frame.channels_us), frame.frame_lost, frame.failsafe))
            assert parser.count < 25
        return frames

    return feed


@pytest.fixture
def push(scripted: Any) -> Callable[[bytes], list[Any]]:
    """Feeds one parser; returns the frames that came out."""
    return parser_of(scripted)


def microseconds(values: list[int]) -> list[int]:
    return [880 + (5 * value + 4) // 8 for value in values]


def test_each_channel_comes_out_when_its_values_run_through_all(push: Any, sbus: Encode) -> None:
    for value in range(2048):
        values = [(value + 128 * index) % 2048 for index in range(16)]
        assert push(sbus(values)) == [(microseconds(values), False, False)]


@pytest.mark.parametrize(("lost", "failsafe"), [(True, False), (False, True), (True, True)])
def test_flags_come_out_when_they_are_set(push: Any, sbus: Encode, lost: bool, failsafe: bool) -> None:
    assert push(sbus(VALUES, frame_lost=lost, failsafe=failsafe)) == [(microseconds(VALUES), lost, failsafe)]


def test_nothing_comes_out_when_header_or_footer_is_wrong(push: Any, sbus: Encode) -> None:
    good = sbus(VALUES)
    assert 0x0F not in good[1:] and 0 not in good[1:23]
    assert push(b"\x0e" + good[1:]) == []
    assert push(sbus(VALUES, footer=0x21)) == []
    assert push(good[:23] + b"\x10" + good[24:]) == []  # a flag that no receiver sets
    assert push(good) == [(microseconds(VALUES), False, False)]


def test_a_frame_comes_out_when_its_footer_may_be_a_receivers(scripted: Any, sbus: Encode) -> None:
    """Those that are known: SBUS's 0, an R7008SB's, and an R7003SB's 0x08."""
    for footer in range(256):
        frames = parser_of(scripted)(sbus(VALUES, footer=footer))
        may_be = footer in {0x00, *SBUS2_FOOTERS, 0x08} or footer & 0xC3 == 0
        assert frames == ([(microseconds(VALUES), False, False)] if may_be else []), footer


def test_sbus2_frames_come_out_when_sensors_speak_between_them(push: Any, sbus: Encode) -> None:
    """A receiver numbers its frames; slots of three bytes follow each, none of which begins a frame here."""
    data = b"".join(sbus(VALUES, footer=footer) + bytes([3, 0x40, 0x81]) * 8 for footer in SBUS2_FOOTERS)
    assert push(data) == [(microseconds(VALUES), False, False)] * len(SBUS2_FOOTERS)


def test_nothing_comes_out_when_a_byte_is_missing_but_the_next_frame_does(push: Any, sbus: Encode) -> None:
    good = sbus(VALUES)
    for cut in range(1, 24):
        frames = push(good[:cut] + good[cut + 1 :] + good)
        assert frames == [(microseconds(VALUES), False, False)], cut


def test_frames_come_out_when_bytes_trail_between_them(push: Any, sbus: Encode) -> None:
    good = sbus(VALUES)
    assert len(push(good + b"\x00\x01\xff" + good + b"\x55" + good)) == 3


def test_a_false_header_is_survived_when_it_stands_inside_the_noise(push: Any, sbus: Encode) -> None:
    good = sbus(VALUES)
    for noise in range(1, 25):
        assert push(b"\x0f" * noise + good)[-1:] == [(microseconds(VALUES), False, False)], noise


def test_any_bytes_are_survived_when_they_are_random(push: Any, scripted: Any) -> None:
    rng = np.random.default_rng(7)
    frames = []
    for _ in range(300):
        data = rng.integers(0, 256, 200, np.uint8)
        data[rng.random(200) < 0.3] = 0x0F  # plenty of false beginnings
        data[rng.random(200) < 0.3] = 0x00  # and ends
        frames += push(data.tobytes())
    assert frames, "random bytes with so many headers and footers do make frames"
    assert all(880 <= us <= 2159 for channels, _, _ in frames for us in channels)


def test_a_half_frame_is_forgotten_when_the_parser_is_reset(scripted: Any, sbus: Encode) -> None:
    parser, frame = scripted.new("struct sbus *"), scripted.new("struct sbus_frame *")
    good = sbus(VALUES)
    for byte in good[:12]:
        assert not scripted.lib.sbus_push(parser, byte, frame)
    scripted.lib.sbus_reset(parser)
    assert [scripted.lib.sbus_push(parser, byte, frame) for byte in good] == [False] * 24 + [True]


def test_frames_are_the_same_when_bytes_within_them_are_taken_in_runs(scripted: Any, sbus: Encode) -> None:
    rng = np.random.default_rng(11)
    data = b"".join(
        sbus(VALUES) if rng.random() < 0.5 else rng.choice([0x00, 0x0F, 0x55], 40).astype(np.uint8).tobytes()
        for _ in range(200)
    )
    single, runs, frame = (scripted.new(f"struct {name} *") for name in ("sbus", "sbus", "sbus_frame"))
    expected = [at for at, byte in enumerate(data) if scripted.lib.sbus_push(single, byte, frame)]
    found, at = [], 0
    while at < len(data):
        end = min(len(data), at + int(rng.integers(1, 40)))
        while at < end:
            at += scripted.lib.sbus_fill(runs, data[at:end], end - at)
            if at < end:
                if scripted.lib.sbus_push(runs, data[at], frame):
                    found.append(at)
                at += 1
    assert found == expected
    assert len(expected) > 50
