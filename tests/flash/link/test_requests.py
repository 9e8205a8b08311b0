"""Payloads of requests against bytes written out by hand, and what is refused before it is sent."""

from __future__ import annotations

import struct
from collections.abc import Callable

import pytest

from neuroflight.flash.link import requests
from neuroflight.toolchain.contract import Refusal


@pytest.mark.parametrize(
    ("payload", "expected"),
    [
        (requests.set_raw_rc([1500, 1501, 1502, 1000, 2000]), "dc05 dd05 de05 e803 d007"),
        (requests.set_motor([1000, 2000]), "e803 d007"),
        (requests.motor_test(0x01020304), "04030201"),
        (requests.dshot_command(7, 2), "02 07"),
        (requests.dshot_command(21), "ff 15"),
        (requests.setting_index(258), "0201"),
        (requests.setting_set(3, 4000, kind="uint32_t"), "0300 a00f0000"),
        (requests.setting_set(4, 0.25, kind="float"), "0400 0000803e"),
        (requests.acknowledge(11), "0b000000"),
        (requests.slot_begin(54108), "5cd30000"),
        (requests.slot_write(508, b"\x01\x02\x03\x04"), "fc010000 01020304"),
    ],
)
def test_payloads_are_as_written_by_hand_when_encoded(payload: bytes, expected: str) -> None:
    assert payload == bytes.fromhex(expected)


@pytest.mark.parametrize(
    ("encode", "told"),
    [
        (lambda: requests.set_raw_rc([1500] * 3), "channel count 3, expected 4..16"),
        (lambda: requests.set_raw_rc([1500] * 17), "channel count 17, expected 4..16"),
        (lambda: requests.set_motor([]), "motor count 0, expected 1..8"),
        (lambda: requests.set_motor([999]), "999, expected 1000..2000"),
        (lambda: requests.set_motor([2001]), "2001, expected 1000..2000"),
        (lambda: requests.dshot_command(48), "DShot command 48, expected 0..47"),
        (lambda: requests.dshot_command(1, 8), "motor 8, expected 0..7"),
        (lambda: requests.setting_set(1, 0.5, kind="uint32_t"), "0.5, expected a whole number"),
        (lambda: requests.setting_set(1, -1, kind="uint32_t"), "setting 1 -1, expected 0.."),
        (lambda: requests.slot_write(0, b""), "number of bytes 0, expected 4..508"),
        (lambda: requests.slot_write(0, bytes(512)), "number of bytes 512, expected 4..508"),
        (lambda: requests.slot_write(2, bytes(4)), "4 bytes at 2, expected multiples of 4"),
        (lambda: requests.slot_write(0, bytes(6)), "6 bytes at 0, expected multiples of 4"),
    ],
)
def test_a_value_is_refused_in_one_line_when_the_command_cannot_take_it(
    encode: Callable[[], bytes], told: str
) -> None:
    with pytest.raises(ValueError, match=told.replace("..", r"\.\.")) as caught:
        encode()
    assert "\n" not in str(caught.value)


def test_each_refusal_has_its_words_when_a_firmware_says_no() -> None:
    assert set(requests.REASONS) == set(Refusal) - {Refusal.NONE}
    assert "disarm" in requests.refusal(struct.pack("<Bh", Refusal.ARMED, 0))
    assert "gyro_rate_hz does not fit" in requests.refusal(struct.pack("<Bh", Refusal.CONFLICT, 0))
    assert "setting 999 does not fit" in requests.refusal(struct.pack("<Bh", Refusal.CONFLICT, 999))
    assert "error -10" in requests.refusal(struct.pack("<Bh", Refusal.BLOB, -10))


def test_a_refusal_is_told_as_it_is_when_nothing_is_known_of_it() -> None:
    assert requests.refusal(b"") == requests.refusal(b"\x01") == ""
    assert "reason 200" in requests.refusal(b"\xc8\x00\x00")
