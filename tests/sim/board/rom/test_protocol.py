"""AN3155 without a line: every answer, every checksum, and bytes that are none of it."""

from __future__ import annotations

from collections.abc import Iterable
from functools import reduce
from operator import xor

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from neuroflight.sim.board.rom.protocol import (
    ACCEPTED,
    DATA_MAX,
    OWN_RAM_BYTES,
    REFUSED,
    START,
    Action,
    Erase,
    Go,
    Read,
    Send,
    State,
    Write,
    feed,
)
from neuroflight.toolchain.contract import DTCM, FLASH_BASE, FLASH_BYTES, FLASH_SECTORS


def checked(data: bytes) -> bytes:
    """`data` and the exclusive or of its bytes."""
    return data + bytes([reduce(xor, data, 0)])


def command(code: int) -> bytes:
    return bytes([code, code ^ 0xFF])


def address(value: int) -> bytes:
    return checked(value.to_bytes(4, "big"))


def sectors(*numbers: int) -> bytes:
    return checked(b"".join(n.to_bytes(2, "big") for n in (len(numbers) - 1, *numbers)))


def write(at: int, data: bytes) -> bytes:
    return command(0x31) + address(at) + checked(bytes([len(data) - 1]) + data)


def said(data: Iterable[int], state: State = START) -> tuple[State, list[Action]]:
    """The state behind all bytes, and every action on the way."""
    actions = []
    for byte in data:
        state, action = feed(state, byte)
        if action is not None:
            actions.append(action)
    return state, actions


@pytest.mark.parametrize(
    ("code", "answer"),
    [
        (0x00, "79 0b 31 00 01 02 11 21 31 44 63 73 82 92 79"),
        (0x01, "79 31 00 00 79"),
        (0x02, "79 01 04 52 79"),
    ],
)
def test_it_tells_what_it_is_when_asked(code: int, answer: str) -> None:
    assert said(command(code)) == (START, [Send(bytes.fromhex(answer))])


@pytest.mark.parametrize("code", [0x63, 0x73, 0x82, 0x92, 0x7F, 0x43, 0xFF])
def test_command_is_refused_when_it_protects_or_is_none(code: int) -> None:
    assert said(command(code)) == (START, [REFUSED])


def test_action_comes_behind_every_answer_when_commands_are_whole() -> None:
    at = FLASH_BASE + 0x20000
    assert said(command(0x11) + address(at) + command(0xFF)) == (START, [ACCEPTED, ACCEPTED, Read(at, 256)])
    assert said(write(at, b"abcd")) == (START, [ACCEPTED, ACCEPTED, Write(at, b"abcd")])
    assert said(command(0x44) + sectors(0, 5)) == (START, [ACCEPTED, Erase((0, 5))])
    assert said(command(0x44) + checked(b"\xff\xff")) == (START, [ACCEPTED, Erase(None)])
    assert said(command(0x21) + address(at)) == (START, [ACCEPTED, Go(at)])


@pytest.mark.parametrize(
    "request_",
    [write(FLASH_BASE, b"abcd"), command(0x44) + sectors(5), command(0x21) + address(FLASH_BASE)],
)
def test_nothing_is_done_when_one_byte_of_a_request_is_another(request_: bytes) -> None:
    for at in range(len(request_)):
        for change in (0x01, 0x80, 0xFF):
            wrong = bytearray(request_)
            wrong[at] ^= change
            assert not [a for a in said(wrong)[1] if isinstance(a, Write | Erase | Go)], (at, change)


def test_it_erases_less_when_one_byte_of_a_list_of_sectors_is_another() -> None:
    """The checksum of AN3155 does not see it: whoever erases one sector at a time is safe."""
    wrong = bytearray(command(0x44) + sectors(0, 5))
    wrong[3] ^= 1
    assert said(wrong)[1] == [ACCEPTED, Erase((0,)), REFUSED]


@pytest.mark.parametrize(
    ("code", "at"),
    [
        (0x31, DTCM.address),  # the ROM's own variables
        (0x31, DTCM.address + OWN_RAM_BYTES - 1),
        (0x31, FLASH_BASE - 1),
        (0x31, FLASH_BASE + FLASH_BYTES),
        (0x31, 0x1FF00000),
        (0x31, 0x00200000),
        (0x21, 0x40000000),
        (0x11, 0x40000000),
        (0x11, 0x1FF0EDC0),
    ],
)
def test_address_is_refused_when_nothing_is_to_be_had_there(code: int, at: int) -> None:
    assert said(command(code) + address(at)) == (START, [ACCEPTED, REFUSED])


def test_range_is_refused_when_it_runs_out_of_its_memory() -> None:
    at = FLASH_BASE + FLASH_BYTES - 4
    assert said(write(at, b"abcd"))[1][-1] == Write(at, b"abcd")
    assert said(write(at, b"abcde"))[1][-1] == REFUSED
    assert said(command(0x11) + address(at) + command(3))[1][-1] == Read(at, 4)
    assert said(command(0x11) + address(at) + command(4))[1][-1] == REFUSED


@pytest.mark.parametrize("count", [len(FLASH_SECTORS), 0x7F7F, 0xFFF0, 0xFFFD, 0xFFFE])
def test_erasure_is_refused_when_the_number_of_sectors_is_none(count: int) -> None:
    assert said(command(0x44) + count.to_bytes(2, "big")) == (START, [ACCEPTED, REFUSED])


def test_erasure_is_refused_when_a_sector_is_none() -> None:
    assert said(command(0x44) + sectors(0, len(FLASH_SECTORS)))[1][-1] == REFUSED


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=400))
def test_it_answers_again_when_synchronised_behind_any_bytes(noise: bytes) -> None:
    """0x7F until a refusal: no more of them than the longest step takes."""
    state, _ = said(noise)
    for _ in range(DATA_MAX + 4):
        state, action = feed(state, 0x7F)
        if action == REFUSED:
            break
    else:
        raise AssertionError("never refused")
    assert state == START
    assert said(command(0x02), state)[1] == [Send(bytes.fromhex("79 01 04 52 79"))]
