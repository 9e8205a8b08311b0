"""Files for logs on cards that are not mounted; what mtools and fsck.vfat say of them afterwards."""

from __future__ import annotations

import random
import struct
from io import BytesIO
from pathlib import Path

import pytest

from neuroflight.flash.card.copies import copy_of
from neuroflight.flash.card.fat32 import Fat32
from neuroflight.flash.card.files import Progress, carry_out, plan_files
from neuroflight.flash.card.image import ImageCard
from neuroflight.flash.card.place import open_card
from neuroflight.toolchain.errors import CardError
from tests.flash.card.conftest import MEBIBYTE, MakeImage, chains, fsck, put, run

LOG = b"H Product:Blackbox flight data recorder by Nicholas Sherlock\n" + bytes(range(1, 256)) * 900


def ignore(*_: object) -> None:
    """Progress that nobody looks at."""


def prepare(card: ImageCard, files: int | None, progress: Progress = ignore) -> list[str]:
    plan = plan_files(card.files(), card.free_bytes(), MEBIBYTE, files)
    carry_out(card, plan, progress)
    return plan.names


def test_files_are_whole_empty_and_in_one_piece_as_others_see_them(
    card_image: MakeImage, tmp_path: Path
) -> None:
    image = card_image()
    card = ImageCard(image)
    told: list[tuple[int, int]] = []
    names = prepare(card, 3, lambda _, done, total: told.append((done, total)))
    assert names == ["LOG00001.BBL", "LOG00002.BBL", "LOG00003.BBL"]
    assert told[-1] == (3 * MEBIBYTE, 3 * MEBIBYTE)
    fsck(image)
    for name in names:
        assert chains(image, name) == 1
        run("mcopy", "-i", image, f"::{name}", tmp_path / name)
        assert (tmp_path / name).read_bytes() == bytes(MEBIBYTE)
    assert [(f.name, f.bytes, f.blank, f.whole) for f in card.files()] == [
        (name, MEBIBYTE, True, True) for name in names
    ]


def test_a_log_is_kept_and_files_are_added_behind_it(card_image: MakeImage, tmp_path: Path) -> None:
    image = card_image()
    card = ImageCard(image)
    prepare(card, 2)
    put(image, "LOG00001.BBL", LOG)
    assert prepare(card, 2) == ["LOG00003.BBL"]
    assert prepare(card, 2) == []
    assert [file.blank for file in card.files()] == [False, True, True]
    run("mcopy", "-i", image, "::LOG00001.BBL", tmp_path / "log")
    assert (tmp_path / "log").read_bytes().startswith(LOG)
    fsck(image)


def test_half_of_the_room_is_taken_unless_told(card_image: MakeImage) -> None:
    card = ImageCard(card_image())
    free = card.free_bytes()
    assert len(prepare(card, None)) == free // 2 // MEBIBYTE
    assert prepare(card, None) == []


def test_a_sector_that_the_card_erased_counts_as_empty(card_image: MakeImage) -> None:
    image = card_image()
    card = ImageCard(image)
    prepare(card, 1)
    put(image, "LOG00001.BBL", b"\xff" * MEBIBYTE)
    assert [file.blank for file in card.files()] == [True]


def test_only_logs_with_a_whole_copy_are_known_as_copied(card_image: MakeImage, tmp_path: Path) -> None:
    image = card_image()
    card = ImageCard(image)
    prepare(card, 4)
    for number in (1, 2, 3, 4):
        put(image, f"LOG0000{number}.BBL", LOG + b"%d" % number)
    copies = tmp_path / "copies"
    copies.mkdir()
    (copies / "fetched.bbl").write_bytes(LOG + b"1")  # as `log fetch` ends it
    run("mcopy", "-i", image, "::LOG00002.BBL", copies / "as copied by a computer")
    (copies / "cut short").write_bytes((LOG + b"3")[:-5])
    (copies / "changed").write_bytes((LOG[:5000] + b"?" + LOG[5001:]) + b"4")
    found = [copy_of(card, log, copies, lambda _: None) for log in card.files()]
    assert [path and path.name for path in found] == ["fetched.bbl", "as copied by a computer", None, None]


def test_clearing_empties_one_file_and_touches_nothing_else(card_image: MakeImage) -> None:
    image = card_image()
    card = ImageCard(image)
    prepare(card, 3)
    before = image.read_bytes()
    for number in (1, 2, 3):
        put(image, f"LOG0000{number}.BBL", LOG)
    card.clear("LOG00002.BBL", lambda _: None)
    assert [file.blank for file in card.files()] == [False, True, False]
    for name in ("LOG00001.BBL", "LOG00003.BBL"):
        assert card.read(name, 0, len(LOG)) == LOG
        card.clear(name, lambda _: None)
    assert image.read_bytes() == before


def test_a_file_that_found_no_room_in_one_piece_is_removed_again(
    card_image: MakeImage, tmp_path: Path
) -> None:
    image = card_image()
    small, large = tmp_path / "small", tmp_path / "large"
    small.write_bytes(b"x" * (MEBIBYTE // 2))
    for k in range(70):
        run("mcopy", "-i", image, small, f"::S{k}")
    large.write_bytes(b"x" * (ImageCard(image).free_bytes() - 4096))
    run("mcopy", "-i", image, large, "::REST")
    for k in range(0, 70, 2):
        run("mdel", "-i", image, f"::S{k}")
    card = ImageCard(image)
    with pytest.raises(CardError, match=r"LOG00001.BBL would lie in several pieces.*format it anew"):
        prepare(card, 2)
    assert card.files() == []
    fsck(image)


def test_too_many_files_are_refused_before_anything_is_written(card_image: MakeImage) -> None:
    image = card_image()
    before = image.read_bytes()
    with pytest.raises(CardError, match=r"MB are free, expected 50 MB for 50 files of 1 MB"):
        prepare(ImageCard(image), 50)
    assert image.read_bytes() == before


def test_a_partition_is_found_and_what_lies_before_it_stays(card_image: MakeImage, tmp_path: Path) -> None:
    system = card_image().read_bytes()
    first = 2048
    table = bytearray(512)
    table[446:462] = bytes((0, 0, 0, 0, 0x0C, 0, 0, 0)) + struct.pack("<II", first, len(system) // 512)
    table[510:] = b"\x55\xaa"
    image = tmp_path / "disk.img"
    image.write_bytes(bytes(table).ljust(first * 512, b"\xa5") + system)
    card = open_card(image)
    assert isinstance(card, ImageCard)
    prepare(card, 2)
    assert image.read_bytes()[: first * 512] == bytes(table).ljust(first * 512, b"\xa5")
    fsck(image, first * 512)
    assert [file.whole for file in card.files()] == [True, True]


def sector_of(**fields: bytes) -> bytes:
    """A first sector with bytes at places `at_N`."""
    sector = bytearray(4096)
    for place, data in fields.items():
        at = int(place.removeprefix("at_"))
        sector[at : at + len(data)] = data
    return bytes(sector)


OTHERS = {
    "FAT16 or FAT12, expected FAT32": None,
    "exFAT, expected FAT32": sector_of(at_0=b"\xeb\x76\x90EXFAT   ", at_510=b"\x55\xaa"),
    "neither a file system nor a partition table": bytes(4096),
    "it ends at byte 100": bytes(100),
    r"of the kind GPT, expected an MBR": sector_of(at_450=b"\xee", at_510=b"\x55\xaa"),
    r"type 0x07 \(exFAT\), expected FAT32": sector_of(at_450=b"\x07", at_510=b"\x55\xaa"),
}


@pytest.mark.parametrize("told", OTHERS)
def test_what_is_no_fat32_is_refused_with_how_to_format(
    told: str, card_image: MakeImage, tmp_path: Path
) -> None:
    content = OTHERS[told]
    image = card_image(bits=16, size=20 * MEBIBYTE) if content is None else tmp_path / "other"
    if content is not None:
        image.write_bytes(content)
    before = image.read_bytes()
    with pytest.raises(CardError, match=told) as error:
        open_card(image)
    assert "\n" not in str(error.value)
    assert image.read_bytes() == before


def test_damaged_file_systems_are_one_line(card_image: MakeImage) -> None:
    image = card_image()
    prepare(ImageCard(image), 3)
    file = BytesIO(image.read_bytes()[: 8 * MEBIBYTE])
    spoilt = file.getbuffer()
    rng = random.Random(20)
    refused = 0
    for _ in range(300):
        places = {
            rng.choice((rng.randrange(90), 32 * 512 + rng.randrange(64), rng.randrange(2 << 20)))
            for _ in range(rng.randint(1, 4))
        }
        sound = {place: spoilt[place] for place in places}
        for place in places:
            spoilt[place] = rng.randrange(256)
        try:
            system = Fat32(file, "card")
            for entry in system.files():
                assert sum(piece.bytes for piece in system.pieces(entry)) == entry.bytes
        except CardError as error:
            refused += 1
            assert "\n" not in str(error) and len(str(error)) < 500
        for place, byte in sound.items():
            spoilt[place] = byte
    assert 20 < refused < 300
