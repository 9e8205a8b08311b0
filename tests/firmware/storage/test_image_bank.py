"""image_bank.c: what a bank's header and marks say, and which bank is started."""

from __future__ import annotations

import itertools
import struct
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from typing import Any

import pytest

from neuroflight.toolchain.contract import (
    FLASH_BANKS,
    IMAGE_NUMBER_ENTRIES,
    IMAGE_NUMBER_WORDS,
    IMAGE_STARTS_MAX,
    IMAGE_TAIL_BYTES,
)
from neuroflight.toolchain.image.bank_state import state
from tests.firmware.conftest import Core
from tests.firmware.images import LEAST_BYTES, MOST_BYTES, changed, header_of, make_image

MakeChip = Callable[..., Any]
NONE = 2  # as a bank
MAGIC, LAYOUT, BOARD, BANK, SIZE = range(-17, -22, -1)  # enum nf_err
NAME = b"HOST".ljust(24, b"\0")
TOP, HALF = 2**32 - 1, 2**31
BEFORE, AFTER, BETWEEN, WORDS, NOISE = KINDS = range(5)


@dataclass(frozen=True)
class Marks:
    """struct image_bank_marks."""

    installed: bool = False
    numbered: bool = False
    confirmed: bool = False
    rejected: bool = False
    sequence: int = 0
    starts: int = 0


class Banks:
    """The banks of a chip."""

    def __init__(self, chip: Any) -> None:
        self.chip, self.core, self.lib = chip, chip.core, chip.core.lib

    def put(self, bank: int, image: bytes, marks: bytes = b"") -> None:
        """Past all rules."""
        region = FLASH_BANKS[bank]
        tail = region.size - IMAGE_TAIL_BYTES
        whole = image.ljust(tail, b"\xff") + marks.ljust(IMAGE_TAIL_BYTES, b"\xff")
        self.chip.fill(region.address, whole)

    def marks(self, bank: int) -> Marks:
        told = self.lib.image_bank_marks(self.chip.flash, bank)
        return Marks(*(getattr(told, name) for name in asdict(Marks())))

    def number(self, bank: int) -> bool:
        return bool(self.lib.image_bank_number(self.chip.flash, bank))

    def whole(self, bank: int) -> bool:
        return bool(self.lib.image_bank_whole(self.chip.flash, bank, NAME))


@pytest.fixture
def banks(chip: MakeChip) -> Banks:
    """Empty ones."""
    return Banks(chip())


# --- The header -----------------------------------------------------------------------------------
def judge(core: Core, image: bytes, bank: int) -> int:
    header = core.new("struct nf_image_header *")
    core.ffi.memmove(header, header_of(image), len(header_of(image)))
    found = int(core.lib.image_bank_check(header, bank, NAME))
    assert core.lib.image_bank_fits(header, bank, NAME) == (found == 0)
    return found


@pytest.mark.parametrize("bank", [0, 1])
def test_a_header_fits_its_own_bank_and_board_alone(scripted: Core, bank: int) -> None:
    image = make_image(1, bank=bank)
    assert judge(scripted, image, bank) == 0
    assert judge(scripted, image, 1 - bank) == BANK
    assert judge(scripted, make_image(1, bank=bank, board="HOST2"), bank) == BOARD
    assert judge(scripted, make_image(1, bank=bank, board="HOS"), bank) == BOARD
    assert judge(scripted, make_image(1, bank=bank, board=""), bank) == BOARD
    assert judge(scripted, changed(image, "magic", b"NFPB"), bank) == MAGIC
    assert judge(scripted, changed(image, "magic", bytes(4)), bank) == MAGIC
    for layout in (0, 1, 2, 4, 0x103, 0xFFFF):
        assert judge(scripted, changed(image, "layout", struct.pack("<H", layout)), bank) == LAYOUT
    for number in (2, 0x80 | bank, 0xFF):
        assert judge(scripted, changed(image, "bank", bytes([number])), bank) == BANK


@pytest.mark.parametrize(
    ("size", "found"),
    [
        *((LEAST_BYTES, 0), (LEAST_BYTES + 4, 0), (MOST_BYTES, 0), (MOST_BYTES - 4, 0)),
        *((0, SIZE), (LEAST_BYTES - 4, SIZE), (LEAST_BYTES + 1, SIZE), (LEAST_BYTES + 2, SIZE)),
        *((MOST_BYTES + 4, SIZE), (0x20000, SIZE), (HALF, SIZE), (TOP - 3, SIZE), (TOP, SIZE)),
    ],
)
def test_a_header_is_refused_when_no_image_has_its_size(scripted: Core, size: int, found: int) -> None:
    assert judge(scripted, changed(make_image(1), "image_bytes", struct.pack("<I", size)), 1) == found


def test_an_image_is_whole_unless_any_of_its_words_is_another(banks: Banks) -> None:
    b, image = banks, make_image(5)
    b.put(1, image)
    assert b.whole(1)
    for at in range(0, len(image), 4):
        b.put(1, image[:at] + bytes([image[at] ^ 0x10]) + image[at + 1 :])
        assert not b.whole(1), at
    b.put(1, image + b"\0")
    assert b.whole(1), "what is behind its end is none of it"


def test_an_image_is_judged_with_its_first_bytes_from_elsewhere(banks: Banks) -> None:
    b, image = banks, make_image(5)
    b.put(1, b"\xff" * 8 + image[8:])
    header = b.core.new("struct nf_image_header *")
    b.core.ffi.memmove(header, header_of(image), len(header_of(image)))
    behind = b.lib.image_bank_whole_behind
    assert behind(b.chip.flash, 1, header, image[:8], 8)
    assert not behind(b.chip.flash, 1, header, image[:4], 4)
    assert not behind(b.chip.flash, 1, header, image[:7] + b"!", 8)


# --- Which one is started -------------------------------------------------------------------------
def kinds_of_marks() -> Iterator[Marks]:
    """All combinations that flash can have, the numbers apart: confirmed only if numbered."""
    for rejected, starts in itertools.product((False, True), range(IMAGE_STARTS_MAX + 1)):
        for installed in (False, True):
            yield Marks(installed=installed, rejected=rejected, starts=starts)
        for confirmed in (False, True):
            yield Marks(numbered=True, confirmed=confirmed, rejected=rejected, starts=starts)


PAIRS_OF_NUMBERS = [
    (1, 1),
    (1, 2),
    (2, 1),
    (TOP, 0),
    (0, TOP),
    (0, HALF),
    (HALF, 0),
    (5, HALF + 4),
    (5, HALF + 6),
]


def should_start(marks: tuple[Marks, Marks], good: tuple[bool, bool]) -> int:
    """What image_bank.h says, in other words: by a rank of three, and the numbers among equals."""

    def rank(bank: int) -> tuple[bool, bool]:
        it = marks[bank]
        failed = it.rejected or (it.starts == IMAGE_STARTS_MAX and not it.confirmed)
        return not failed, it.installed

    able = [bank for bank in (0, 1) if good[bank] and (marks[bank].installed or marks[bank].numbered)]
    if len(able) < 2:
        return able[0] if able else NONE
    if rank(0) != rank(1):
        return 0 if rank(0) > rank(1) else 1
    ahead = (marks[1].sequence - marks[0].sequence) % 2**32
    return int(not marks[0].installed and 0 < ahead < HALF)


def test_the_bank_is_the_right_one_whatever_the_marks_are(scripted: Core) -> None:
    both, good = scripted.new("struct image_bank_marks[2]"), scripted.new("bool[2]")
    tried = 0
    for a, b in itertools.product(list(kinds_of_marks()), repeat=2):
        for numbers in PAIRS_OF_NUMBERS:
            marks = (replace(a, sequence=numbers[0]), replace(b, sequence=numbers[1]))
            both[0], both[1] = asdict(marks[0]), asdict(marks[1])
            for flags in itertools.product((False, True), (False, True)):
                good[0:2] = flags
                assert scripted.lib.image_bank_choose(both, good) == should_start(marks, flags), (
                    marks,
                    flags,
                )
                tried += 1
    assert tried == 24 * 24 * len(PAIRS_OF_NUMBERS) * 4


# --- Marks ----------------------------------------------------------------------------------------
@pytest.mark.parametrize("bank", [0, 1])
def test_marks_are_what_the_toolchain_writes(banks: Banks, bank: int) -> None:
    b, image = banks, make_image(1, bank=bank)
    b.put(bank, image)
    assert b.marks(bank) == Marks(installed=True)
    for sequence, confirmed, written in itertools.product((0, 1, 77, TOP), (False, True), (False, True)):
        b.put(bank, image, state(sequence=sequence, confirmed=confirmed, written=written))
        assert b.marks(bank) == Marks(numbered=True, sequence=sequence, confirmed=confirmed)


def test_an_image_is_not_confirmed_when_it_has_no_number(banks: Banks) -> None:
    banks.put(0, make_image(1, bank=0))
    assert banks.lib.image_bank_confirm(banks.chip.flash, 0)
    assert not banks.marks(0).confirmed, "what an interrupted erase leaves of an old image may look so"
    assert banks.number(0)
    assert banks.marks(0) == Marks(numbered=True, sequence=1, confirmed=True)


@pytest.mark.parametrize("bank", [0, 1])
def test_a_mark_stands_when_it_is_made_and_made_again(banks: Banks, bank: int) -> None:
    flash = banks.chip.flash
    assert banks.number(bank)
    for starts in (1, 2):
        assert banks.lib.image_bank_count_start(flash, bank)
        assert banks.marks(bank) == Marks(numbered=True, sequence=1, starts=starts)
    operations = banks.chip.operations
    assert banks.lib.image_bank_count_start(flash, bank), "there is no place for more, nor need"
    assert banks.number(bank), "it keeps the one it has"
    assert banks.chip.operations == operations
    for _ in range(2):
        assert banks.lib.image_bank_confirm(flash, bank)
        assert banks.marks(bank) == Marks(numbered=True, sequence=1, starts=2, confirmed=True)
    for _ in range(2):
        assert banks.lib.image_bank_reject(flash, bank)
        assert banks.marks(bank) == Marks(numbered=True, sequence=1, starts=2, confirmed=True, rejected=True)
    assert banks.chip.operations == operations + 2
    assert banks.marks(1 - bank) == Marks(installed=True), "the other bank's are its own"


def test_an_image_that_was_written_is_not_started_until_it_has_a_number(banks: Banks) -> None:
    assert banks.lib.image_bank_claim(banks.chip.flash, 1)
    assert banks.marks(1) == Marks()
    assert banks.number(1)
    assert banks.marks(1) == Marks(numbered=True, sequence=1)


@pytest.mark.parametrize(("other", "sequence"), [(None, 1), (1, 2), (HALF, HALF + 1), (TOP, 0)])
def test_a_number_is_newer_than_the_other_banks(banks: Banks, other: int | None, sequence: int) -> None:
    if other is not None:
        banks.put(0, make_image(1, bank=0), state(sequence=other, confirmed=True))
    assert banks.number(1)
    assert banks.marks(1) == Marks(numbered=True, sequence=sequence)


@pytest.mark.parametrize("other", [None, 1, HALF, TOP - 1, TOP])
def test_a_number_is_there_or_not_when_power_goes(banks: Banks, other: int | None) -> None:
    """And the next try succeeds: also one after so many that each spoilt a place."""
    if other is not None:
        banks.put(0, make_image(1, bank=0), state(sequence=other, confirmed=True))
    before = banks.chip.content
    assert banks.number(1)
    wanted = banks.marks(1)
    for at, kind, seed in itertools.product(range(2), KINDS, range(8)):
        banks.chip.content = before
        for spoilt in range(IMAGE_NUMBER_ENTRIES - 1):
            if banks.marks(1).numbered:
                break
            banks.chip.cut(at, kind, seed + 8 * spoilt)
            assert not banks.number(1)
            banks.chip.power_on()
            assert banks.marks(1) in (Marks(installed=True), wanted), (at, kind, seed)
            counts = at == 1 or wanted.sequence == 0  # whose second word is as erased
            assert counts or not banks.marks(1).numbered, "its last word makes it count"
        assert banks.number(1)
        assert banks.marks(1) == wanted


def test_no_number_is_had_when_all_places_are_spoilt(banks: Banks) -> None:
    for _ in range(IMAGE_NUMBER_ENTRIES):
        assert not banks.marks(1).numbered
        place = FLASH_BANKS[1].address + FLASH_BANKS[1].size - IMAGE_TAIL_BYTES
        banks.chip.fill(place + 4, bytes(4 * IMAGE_NUMBER_WORDS * IMAGE_NUMBER_ENTRIES))
    assert not banks.number(1)


def test_no_bits_pass_for_a_number_that_were_programmed_in_part(banks: Banks) -> None:
    """Every single bit of every word on its way, for numbers whose words have few zeros."""
    place = FLASH_BANKS[1].address + FLASH_BANKS[1].size - IMAGE_TAIL_BYTES + 4
    for sequence in (0, 1, 2, 5, 0xFEFFFFFF, HALF - 1, HALF, TOP - 1, TOP):
        entry = (sequence, sequence ^ TOP)
        for step, bit in itertools.product(range(2), range(32)):
            if entry[step] >> bit & 1:
                continue  # that bit is not programmed
            for other in (TOP ^ 1 << bit, entry[step] ^ 1 << bit):  # no other bit is, or all others are
                torn = [*entry[:step], other, *[TOP] * (1 - step)]
                if tuple(torn) == entry:
                    continue
                banks.chip.fill(place, struct.pack("<2I", *torn))
                assert not banks.marks(1).numbered, (sequence, step, bit)


@pytest.mark.parametrize("name", ["claim", "confirm", "reject", "count_start"])
def test_a_mark_can_be_made_again_when_power_goes(chip: MakeChip, name: str) -> None:
    def make(b: Banks) -> bool:
        return bool(getattr(b.lib, f"image_bank_{name}")(b.chip.flash, 1))

    for kind, seed in itertools.product(KINDS, range(8)):
        b = Banks(chip())
        b.put(1, make_image(1), state(sequence=3, confirmed=False))
        before = b.marks(1)
        b.chip.cut(0, kind, seed)
        assert not make(b)
        b.chip.power_on()
        torn = b.marks(1)
        assert (
            replace(torn, **{name: before.__dict__[name] for name in ("confirmed", "rejected", "starts")})
            == before
        )
        assert make(b)
        after = b.marks(1)
        assert (after.confirmed, after.rejected) == (name == "confirm", name == "reject")
        assert after.starts in ((1, 2) if name == "count_start" else (0,))
