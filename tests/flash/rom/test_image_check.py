"""Whether an image would start: its boot part, its header, its checksum."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from neuroflight.flash.rom.image_check import check_image
from neuroflight.flash.rom.segments import Segment, read_segments
from neuroflight.toolchain.contract import (
    FLASH_BANK_A,
    FLASH_BANK_B,
    FLASH_BASE,
    IMAGE_HEADER_OFFSET,
    IMAGE_LAYOUT,
    bound_policy,
    image_field_offset,
    policy_header,
)
from neuroflight.toolchain.errors import LinkError
from tests.flash.rom.conftest import BANK, BOOT

BOARD_OFFSET = image_field_offset("board")


def refusal(segments: tuple[Segment, ...]) -> str:
    with pytest.raises(LinkError, match="nothing was written") as caught:
        check_image(segments)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.fixture
def image(board_image: Path) -> tuple[Segment, ...]:
    return read_segments(board_image.with_suffix(".hex"))


def changed(image: tuple[Segment, ...], at: int, data: bytes) -> tuple[Segment, ...]:
    """With other bytes at `at` of its bank."""
    boot, policy, bank, *rest = image
    return boot, policy, Segment(bank.address, bank.data[:at] + data + bank.data[at + len(data) :]), *rest


def with_policy(image: tuple[Segment, ...], change: Callable[[bytes], bytes]) -> tuple[Segment, ...]:
    """With another policy in slot A."""
    boot, policy, *rest = image
    return boot, Segment(policy.address, change(policy.data)), *rest


@pytest.mark.parametrize("suffix", [".hex", ".bin", ".elf"])
def test_an_image_of_the_build_is_accepted(board_image: Path, suffix: str) -> None:
    facts = check_image(read_segments(board_image.with_suffix(suffix)))
    assert (facts.board, facts.bank, facts.version) == ("MATEKF722", 0, "0.1.0")
    policy = policy_header(read_segments(board_image)[1].data)
    assert policy is not None
    told = f"policy of aircraft nf1, sha256 {policy.policy_sha256[:12]}"
    assert str(facts) == f"MATEKF722 0.1.0, build {facts.build.hex()}, bank A, {told}"


def test_image_is_refused_when_its_policy_is_not_its_own(image: tuple[Segment, ...]) -> None:
    assert "policy slot A: got no policy, expected one" in refusal((image[0], *image[2:]))
    for change, said in (
        (lambda blob: b"\0" + blob[1:], "got no policy, expected one"),
        (lambda blob: blob[:-4], "got a policy that is damaged"),
        (lambda blob: blob[:600] + bytes([blob[600] ^ 1]) + blob[601:], "got a policy that is damaged"),
        (lambda blob: bound_policy(blob, b"another1"), "got the policy of build 616e6f7468657231, expected"),
    ):
        assert said in refusal(with_policy(image, change))


@pytest.mark.parametrize(
    ("segments", "said"),
    [
        ((Segment(FLASH_BANK_A.address, BANK),), "expected a boot part"),
        ((Segment(FLASH_BASE + 4, BOOT),), "expected a boot part"),
        ((Segment(FLASH_BASE, b"abcd"),), "expected a boot part"),
        ((Segment(FLASH_BASE, bytes(64)),), "stack 0x00000000"),
        ((Segment(FLASH_BASE, b"random data, " * 9),), "expected vectors"),
        ((Segment(FLASH_BASE, BOOT[:4] + bytes.fromhex("40000008") + BOOT[8:]),), "reset 0x08000040"),
        ((Segment(FLASH_BASE, BOOT[:4] + bytes.fromhex("01000020") + BOOT[8:]),), "reset 0x20000001"),
        ((Segment(FLASH_BASE, BOOT),), "a boot part without a bank"),
        ((Segment(FLASH_BASE, BOOT), Segment(FLASH_BANK_A.address, BANK)), "no header of Neuroflight"),
        ((Segment(FLASH_BASE, BOOT), Segment(FLASH_BANK_A.address, bytes(1024))), "no header of Neuroflight"),
    ],
)
def test_image_is_refused_when_it_would_not_start(segments: tuple[Segment, ...], said: str) -> None:
    assert said in refusal(segments)


def test_image_is_refused_when_it_names_no_board(image: tuple[Segment, ...]) -> None:
    assert image[2].data[BOARD_OFFSET:].startswith(b"MATEKF722\0")
    assert "names no board, expected the target" in refusal(changed(image, BOARD_OFFSET, bytes(9)))


def test_image_is_refused_when_it_is_linked_for_the_other_bank(image: tuple[Segment, ...]) -> None:
    boot, policy, bank, _ = image
    words = f"bank 0, expected {IMAGE_LAYOUT} and 1"
    assert words in refusal((boot, policy, Segment(FLASH_BANK_B.address, bank.data)))


def test_image_is_refused_when_any_of_its_bytes_is_another(image: tuple[Segment, ...]) -> None:
    size = len(image[2].data)
    for at in (0, 4, 100, BOARD_OFFSET - 20, 5000, size // 2, size - 8):
        refusal(changed(image, at, bytes([image[2].data[at] ^ 1])))


def test_image_is_refused_when_it_is_cut_short(image: tuple[Segment, ...]) -> None:
    boot, policy, bank, _ = image
    for size in (IMAGE_HEADER_OFFSET + 72, 1000, len(bank.data) - 4):
        assert "expected the" in refusal((boot, policy, Segment(bank.address, bank.data[:size])))
