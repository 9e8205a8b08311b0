"""Frames of receivers, read back by independent parsers."""

from __future__ import annotations

import binascii
from collections.abc import Callable

import pytest

from neuroflight.sim.ports.receiver_frames import crsf_frame, sbus_frame
from neuroflight.toolchain.contract import CHANNEL_COUNT

CHANNELS = [880, 881, 988, 1000, 1500, 1501, 1999, 2000, 2012, 2159, 1234, 1357, 1111, 1789, 1023, 1777]
# A frame that others published, its address turned to the flight controller's, and its channels.
KNOWN = bytes.fromhex("c81816e003dfd9c0f78b5f94af7ce52b5ff9ca0700004c7ce223")
KNOWN_VALUES = [992, 992, 871, 992, 191, 191, 997, 997, 997, 997, 997, 997, 0, 0, 1811, 1811]


def microseconds(packed: bytes) -> list[int]:
    """Channels of 11 bits, from the text of all bits."""
    bits = "".join(f"{byte:08b}"[::-1] for byte in packed)
    values = [int(bits[11 * i : 11 * i + 11][::-1], 2) for i in range(CHANNEL_COUNT)]
    return [880 + (5 * value + 4) // 8 for value in values]


def remainder(data: bytes, polynomial: int = 0x1D5) -> int:
    """Of `data` as one long polynomial over two: 0 for a frame with its CRC at the end."""
    number = int(binascii.hexlify(data), 16)
    while number.bit_length() > 8:
        number ^= polynomial << number.bit_length() - 9
    return number


def test_an_sbus_frame_holds_every_channel_when_its_bits_are_read_back() -> None:
    frame = sbus_frame(CHANNELS)
    assert microseconds(frame[1:23]) == CHANNELS
    assert (len(frame), frame[0], *frame[23:]) == (25, 0x0F, 0, 0)


def test_a_crsf_frame_holds_every_channel_when_its_bits_are_read_back() -> None:
    frame = crsf_frame(CHANNELS)
    assert (len(frame), frame[0], frame[1], frame[2]) == (26, 0xC8, 24, 0x16)
    assert microseconds(frame[3:25]) == CHANNELS
    assert remainder(frame[2:]) == 0


def test_the_parser_reads_what_others_send_when_a_frame_is_published() -> None:
    assert remainder(KNOWN[2:]) == 0
    assert microseconds(KNOWN[3:25]) == [880 + (5 * value + 4) // 8 for value in KNOWN_VALUES]
    own = crsf_frame(microseconds(KNOWN[3:25]))
    assert (own[:3], microseconds(own[3:25])) == (KNOWN[:3], microseconds(KNOWN[3:25]))


@pytest.mark.parametrize(("frame", "begin"), [(sbus_frame, 1), (crsf_frame, 3)])
def test_a_frame_holds_the_nearer_end_when_pulses_are_no_receivers(
    frame: Callable[[list[int]], bytes], begin: int
) -> None:
    assert microseconds(frame([0, 3000] * 8)[begin : begin + 22]) == [880, 2159] * 8
    with pytest.raises(ValueError, match="15 channels, expected 16"):
        frame([1500] * 15)
