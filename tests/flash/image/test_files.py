"""Which images a file holds, and every way in which it is none."""

from __future__ import annotations

import random
import shutil
import struct
from dataclasses import replace
from pathlib import Path

import pytest

from neuroflight.flash.image.files import NFI_BYTES_MAX, Policy, image_for, read_images
from neuroflight.toolchain.contract import FLASH_BANK_A, FLASH_BASE, IMAGE_LAYOUT, image_header
from neuroflight.toolchain.errors import NeuroflightError
from tests.flash.image.conftest import for_board, policy_of_build, stamped


def refused(path: Path) -> str:
    """The one line that reading the file ends in."""
    with pytest.raises(NeuroflightError) as caught:
        read_images(path)
    line = str(caught.value)
    assert "\n" not in line and line.startswith(str(path))
    return line


def test_both_banks_images_are_read_when_the_file_is_for_the_line(
    board_image: Path, board_images: list[bytes]
) -> None:
    file = read_images(board_image.with_suffix(".nfi"))
    assert [image.data for image in file.images] == board_images
    assert [image.bank for image in file.images] == [0, 1]
    assert file.header.board == "MATEKF722" and file.build != bytes(8)


@pytest.mark.parametrize("suffix", [".elf", ".hex", ".bin"])
def test_bank_as_image_is_the_same_in_every_kind_of_file(
    suffix: str, board_image: Path, board_images: list[bytes]
) -> None:
    (image,) = read_images(board_image.with_suffix(suffix)).images
    assert image.data == board_images[0]


def test_bank_bs_image_is_read_when_its_elf_is_named(board_image: Path, board_images: list[bytes]) -> None:
    (image,) = read_images(board_image.with_name("neuroflight-b.elf")).images
    assert image.data == board_images[1]


def test_a_whole_copy_of_flash_gives_the_image_when_marks_lie_behind_it(
    board_images: list[bytes], tmp_path: Path
) -> None:
    flash = bytearray(b"\xff" * (512 << 10))
    at = FLASH_BANK_A.address - FLASH_BASE
    flash[at : at + len(board_images[0])] = board_images[0]
    flash[at + FLASH_BANK_A.size - 128 : at + FLASH_BANK_A.size] = bytes(128)
    (tmp_path / "copy.bin").write_bytes(flash)
    (image,) = read_images(tmp_path / "copy.bin").images
    assert image.data == board_images[0]


# --- The other bank -----------------------------------------------------------------------------------
def test_the_file_beside_it_gives_what_is_missing_when_it_is_of_the_same_build(
    board_image: Path, board_images: list[bytes], board_policy: Policy
) -> None:
    for suffix in (".elf", ".hex", ".bin"):
        image, policy = image_for(read_images(board_image.with_suffix(suffix)), 1)
        assert (image.data, policy) == (board_images[1], replace(board_policy, file=policy.file))
        own, policy = image_for(read_images(board_image.with_suffix(suffix)), 0)
        assert (own.data, policy.file) == (board_images[0], board_image.with_suffix(suffix).name)
        assert policy.data == board_policy.data
    b, policy = image_for(read_images(board_image.with_name("neuroflight-b.elf")), 1)
    assert (b.data, policy.data) == (board_images[1], board_policy.data)


def test_the_nfi_is_asked_for_when_none_lies_beside_it_or_one_of_another_build(
    board_image: Path, board_images: list[bytes], board_policy: Policy, tmp_path: Path
) -> None:
    path = Path(shutil.copy(board_image.with_suffix(".bin"), tmp_path))
    file = read_images(path)
    with pytest.raises(NeuroflightError, match=r"bank A alone .* no neuroflight\.nfi lies beside it; give"):
        image_for(file, 1)
    other = [stamped(image, build=b"12345678") for image in board_images]
    policy = policy_of_build(board_policy, b"12345678")
    path.with_name("neuroflight.nfi").write_bytes(b"".join(other) + policy.data)
    with pytest.raises(NeuroflightError, match=r"the neuroflight\.nfi beside it is of another build; give"):
        image_for(file, 1)


# --- No image -------------------------------------------------------------------------------------------
def test_one_line_says_what_is_wrong_when_the_header_does_not_fit(
    board_images: list[bytes], board_policy: Policy, tmp_path: Path
) -> None:
    (a, b), policy = board_images, board_policy.data
    path = tmp_path / "wrong.nfi"
    size = struct.pack("<I", len(a) + 4)
    for content, words in (
        (stamped(a, layout=struct.pack("<H", IMAGE_LAYOUT - 1)), "its layout is 2, older than 3"),
        (stamped(a, layout=struct.pack("<H", IMAGE_LAYOUT + 1)), "its layout is 4, newer than 3"),
        (stamped(a, magic=b"NFIN"), "got no header of a Neuroflight image"),
        (stamped(a, bank=b"\x02"), "bank number 2"),
        (stamped(a, image_bytes=struct.pack("<I", 128 << 10)), "its header tells of 131072 bytes"),
        (stamped(a, image_bytes=struct.pack("<I", 12)), "its header tells of 12 bytes"),
        (stamped(a, image_bytes=size), f"it ends after {len(a)} of an image's {len(a) + 4} bytes"),
        (stamped(a, crc=b"\1\2\3\4"), "expected 04030201 as its header says: it is damaged"),
        (a + a, "got two images for bank A, expected one"),
        (a + for_board(b, "OTHER") + policy, "its images are of different builds"),
        (a + stamped(b, build=b"12345678") + policy, "its images are of different builds"),
        (a + b, "it ends behind its images, expected their policy"),
        (a + b + b"\n", "got no policy, expected one"),
        (a + b + policy[:-1], "got a policy that is damaged"),
        (a + b + policy[:700] + b"\1" + policy[701:], "got a policy that is damaged"),
        (a + b + policy[:4] + b"\4" + policy[5:], "got a policy of layout 4, expected 5"),
        (a + b + policy_of_build(board_policy, bytes(8)).data, "got the policy of build 0000000000000000"),
        (
            stamped(a, weight_count=b"\1\0\0\0") + policy,
            "got a policy that does not fit the image: its weight_count is",
        ),
        (b"", "got 0 bytes, expected images of 1 to"),
        (bytes(10 << 20), f"got {10 << 20} bytes, expected images of 1 to {NFI_BYTES_MAX}"),
    ):
        path.write_bytes(content)
        assert words in refused(path)


@pytest.mark.parametrize("suffix", [".nfi", ".elf", ".hex", ".bin"])
def test_a_file_is_refused_when_it_is_cut_off_random_or_huge(
    suffix: str, board_image: Path, tmp_path: Path
) -> None:
    whole = board_image.with_suffix(suffix).read_bytes()
    rng = random.Random(1)
    path = tmp_path / f"wrong{suffix}"
    for content in (
        *(whole[: rng.randrange(1, 100_000)] for _ in range(5)),
        *(rng.randbytes(rng.randrange(1, 200_000)) for _ in range(5)),
        whole[:1000],
        bytes(10 << 20),
    ):
        path.write_bytes(content)
        refused(path)


def test_every_flipped_bit_of_an_image_is_found(board_images: list[bytes], tmp_path: Path) -> None:
    rng = random.Random(2)
    path = tmp_path / "flipped.nfi"
    for at in (*range(508, 600, 7), *(rng.randrange(len(board_images[0])) for _ in range(30))):
        content = bytearray(board_images[0])
        content[at] ^= 1 << rng.randrange(8)
        path.write_bytes(content)
        refused(path)


def test_other_files_are_refused_when_named(tmp_path: Path) -> None:
    (tmp_path / "policy.onnx").write_bytes(b"x")
    assert "expected an image: .nfi, .elf, .hex, .bin" in refused(tmp_path / "policy.onnx")
    assert "No such file or directory; build it anew with `make firmware`" in refused(tmp_path / "no.nfi")
    (tmp_path / "folder.nfi").mkdir()
    assert "Is a directory" in refused(tmp_path / "folder.nfi")
    assert "pipe or a device" in refused_link(tmp_path / "zero.nfi")


def refused_link(path: Path) -> str:
    """What a link to a device ends in."""
    path.symlink_to("/dev/zero")
    return refused(path)


def test_the_header_says_nothing_of_its_own_when_text_in_it_is_no_text(board_images: list[bytes]) -> None:
    header = image_header(for_board(board_images[0], "\x1b[31mred"))
    assert header is not None and header.board == "?[31mred"
