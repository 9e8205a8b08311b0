"""image_update.c: every refusal, what may be repeated, and which image a switch makes the boot start."""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from neuroflight.toolchain.contract import FLASH_BANKS, IMAGE_HEADER_OFFSET, Refusal, policy_header
from neuroflight.toolchain.image.bank_state import state
from neuroflight.toolchain.policy.blob import pack, parse
from tests.firmware.conftest import scripted_blob
from tests.firmware.images import HEADER_BYTES, LEAST_BYTES, MOST_BYTES, changed, crc_of, header_of
from tests.firmware.images import make_image as any_image
from tests.firmware.storage.bank_board import BankBoard, Held, confirmed
from tests.firmware.storage.test_policy_slots import BUILD, NONE, SLOT_A, SLOT_B, floats, like

MakeChip = Callable[..., Any]
MAGIC, LAYOUT, BOARD, BANK, SIZE, HEADER, CRC, SHA256 = range(-17, -25, -1)  # enum nf_err
BEFORE = 0  # kind of a cut: enum flash_cut
BLOB_MAGIC, BLOB_CRC, ARCHITECTURE = -7, -10, -13
POLICY = policy_header(pack(scripted_blob()))


def make_image(seed: int, size: int = LEAST_BYTES + 64, *, bank: int = 1) -> bytes:
    """An image that flies the scripted policy."""
    return any_image(seed, size, bank=bank, policy=POLICY)


OLD, OLDER, NEW = make_image(1, bank=0), make_image(2), make_image(3, 4000)


def digest(image: bytes) -> bytes:
    return hashlib.sha256(image).digest()


@pytest.fixture
def board(chip: MakeChip) -> BankBoard:
    """It runs bank A's image; bank B has one from before. Slot A has a policy that any of them flies."""
    chip_ = chip()
    chip_.core.lib.scripted_action = [0.0] * 4
    made = BankBoard(chip_, [confirmed(OLD, 7), confirmed(OLDER, 6)])
    made.slots.put(SLOT_A, made.slots.image)
    assert (made.boot().image, made.slots.slots.flown) == (OLD, SLOT_A)
    return made


def test_the_new_image_is_started_when_all_of_it_arrived_and_it_was_switched_to(board: BankBoard) -> None:
    assert board.begin(header_of(NEW)) == (Refusal.NONE, 0)
    assert board.arrive(NEW) == Refusal.NONE
    assert board.crc == crc_of(NEW)
    assert board.hash(0) == digest(OLD)
    assert board.hash(1) == digest(NEW)
    content = board.chip.content
    assert board.boot().image == OLD, "it has no number yet"
    board.chip.content = content
    assert board.switch(digest(NEW)) == Refusal.NONE
    assert board.sequence == 8
    assert board.boot().image == NEW
    marks = board.lib.image_bank_marks(board.chip.flash, 1)
    assert (marks.numbered, marks.confirmed, marks.starts) == (True, False, 0)
    assert board.settle()
    assert board.boot().image == NEW


def test_the_next_image_goes_into_the_other_bank_when_bank_b_runs(board: BankBoard) -> None:
    assert board.arrive(NEW) == Refusal.NONE
    assert board.switch(digest(NEW)) == Refusal.NONE
    assert board.boot().bank == 1
    assert board.begin(header_of(NEW)) == (Refusal.IMAGE, 0)
    assert board.why == BANK
    assert board.settle()
    newer = make_image(4, 3000, bank=0)
    assert board.arrive(newer) == Refusal.NONE
    assert board.switch(digest(newer)) == Refusal.NONE
    assert (board.sequence, board.boot().image) == (9, newer)


# --- Begin ----------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("header", "why"),
    [
        (bytes(HEADER_BYTES), MAGIC),
        (b"\xff" * HEADER_BYTES, MAGIC),
        (header_of(changed(NEW, "magic", b"NFPB")), MAGIC),
        (header_of(changed(NEW, "layout", b"\1\0")), LAYOUT),
        (header_of(changed(NEW, "board", b"MATEKF722\0")), BOARD),
        (header_of(make_image(3, bank=0)), BANK),
        (header_of(changed(NEW, "bank", b"\2")), BANK),
        (header_of(changed(NEW, "image_bytes", struct.pack("<I", MOST_BYTES + 4))), SIZE),
        (header_of(changed(NEW, "image_bytes", struct.pack("<I", 1001))), SIZE),
        (header_of(changed(NEW, "image_bytes", bytes(4))), SIZE),
    ],
)
def test_nothing_is_erased_when_the_header_does_not_fit(board: BankBoard, header: bytes, why: int) -> None:
    before = board.chip.content
    assert board.begin(header)[0] == Refusal.IMAGE
    assert board.why == why
    assert board.write(0, bytes(8)) == board.end() == Refusal.ORDER
    assert (board.chip.content, board.chip.operations) == (before, 0)


@pytest.mark.parametrize("kind", range(5))
def test_the_old_image_is_none_when_its_erasing_was_interrupted(board: BankBoard, kind: int) -> None:
    board.chip.cut(1, kind, 3)
    assert board.begin(header_of(NEW))[0] == Refusal.FLASH
    assert board.boot().image == OLD
    assert board.hash(1) == MAGIC, "whatever else of it is left"
    if kind == BEFORE:  # all of it, but for the magic, which went before the erasing
        gone = OLDER[:IMAGE_HEADER_OFFSET] + bytes(4) + OLDER[IMAGE_HEADER_OFFSET + 4 :]
        assert board.chip.region(FLASH_BANKS[1])[: len(OLDER)] == gone
    assert board.arrive(NEW) == Refusal.NONE


def test_an_update_goes_on_where_it_was_when_the_same_image_is_begun_again(board: BankBoard) -> None:
    assert board.begin(header_of(NEW)) == (Refusal.NONE, 0)
    assert board.write(0, NEW[:400]) == Refusal.NONE
    operations = board.chip.operations
    assert board.begin(header_of(NEW)) == (Refusal.NONE, 400)
    assert board.begin(header_of(make_image(3, bank=0))) == (Refusal.IMAGE, 400), "a wrong one ends nothing"
    assert board.chip.operations == operations
    assert board.arrive(NEW) == Refusal.NONE
    assert board.begin(header_of(NEW)) == (Refusal.NONE, len(NEW)), "also when all of it is there"
    assert board.end() == Refusal.NONE
    other = make_image(9)
    assert board.begin(header_of(other)) == (Refusal.NONE, 0)
    assert board.chip.region(FLASH_BANKS[1])[:4000] == b"\xff" * 4000
    assert board.arrive(other) == Refusal.NONE


def test_an_update_begins_anew_when_the_board_was_started_meanwhile(board: BankBoard) -> None:
    assert board.begin(header_of(NEW)) == (Refusal.NONE, 0)
    assert board.write(0, NEW[:400]) == Refusal.NONE
    assert board.boot().image == OLD
    assert board.write(400, NEW[400:800]) == Refusal.ORDER
    assert board.end() == Refusal.ORDER
    assert board.begin(header_of(NEW)) == (Refusal.NONE, 0)
    assert board.arrive(NEW) == Refusal.NONE


def test_the_image_to_go_back_to_stays_until_the_running_one_has_run_well(board: BankBoard) -> None:
    assert board.arrive(NEW) == Refusal.NONE
    assert board.switch(digest(NEW)) == Refusal.NONE
    assert board.boot().image == NEW
    next_one = make_image(4, 3000, bank=0)
    before = board.chip.content
    assert board.arrive(next_one) == Refusal.ORDER
    assert (board.chip.content, board.chip.operations) == (before, 0)
    assert board.lib.image_bank_reject(board.chip.flash, 0)
    assert board.arrive(next_one) == Refusal.NONE, "it is not gone back to"
    board.chip.content = before
    board.boot()
    board.chip.fill(FLASH_BANKS[0].address + 100, b"\0")
    assert board.arrive(next_one) == Refusal.NONE, "it cannot be gone back to"
    board.chip.content = before
    board.boot()
    assert board.settle()
    assert board.arrive(next_one) == Refusal.NONE
    assert board.switch(digest(next_one)) == Refusal.NONE
    assert board.boot().image == next_one


# --- Write ----------------------------------------------------------------------------------------
def test_a_block_is_refused_when_it_is_none_or_not_the_next(board: BankBoard) -> None:
    assert board.write(0, NEW[:8]) == Refusal.ORDER
    assert board.begin(header_of(NEW)) == (Refusal.NONE, 0)
    assert board.write(0, NEW[:256]) == Refusal.NONE
    operations = board.chip.operations
    for offset, data in ((0, b""), (256, NEW[256:257]), (256, NEW[256:258]), (256, NEW[256:263])):
        assert board.write(offset, data) == Refusal.PAYLOAD
    for offset in (len(NEW), len(NEW) - 4, 2**32 - 4, 2**32 - 8, 2**31):
        assert board.write(offset, bytes(8)) == Refusal.PAYLOAD, offset
    for offset in (4, 252, 260, 512, len(NEW) - 8, 255, 257):
        assert board.write(offset, NEW[offset : offset + 8]) == Refusal.ORDER, offset
    assert board.chip.operations == operations
    assert board.write(256, NEW[256:512]) == Refusal.NONE


def test_the_last_block_may_be_repeated_and_no_other(board: BankBoard) -> None:
    assert board.begin(header_of(NEW)) == (Refusal.NONE, 0)
    for offset in range(0, len(NEW), 400):
        for _ in range(3):
            assert board.write(offset, NEW[offset : offset + 400]) == Refusal.NONE
        assert board.write(offset, bytes(400)) == Refusal.ORDER, "other bytes are no repetition"
        if offset:
            assert board.write(offset - 400, NEW[offset - 400 : offset]) == Refusal.ORDER
    assert board.end() == Refusal.NONE
    assert board.write(3600, NEW[3600:]) == Refusal.NONE, "a late one harms nothing"


def test_an_update_has_to_be_begun_anew_when_flash_refuses(board: BankBoard) -> None:
    for at in (0, 1, 2, 3, 40):  # the magic, the erasing, the claim, words
        board.boot()
        board.chip.cut(at, 0, 1)
        assert board.arrive(NEW) == Refusal.FLASH
        assert board.write(0, NEW[:8]) == board.end() == Refusal.ORDER
    board.boot()
    assert board.arrive(NEW) == Refusal.NONE


# --- End ------------------------------------------------------------------------------------------
def test_an_image_is_refused_when_bytes_are_missing(board: BankBoard) -> None:
    assert board.end() == Refusal.ORDER
    assert board.begin(header_of(NEW)) == (Refusal.NONE, 0)
    for offset in range(0, len(NEW), 400):
        assert board.end() == Refusal.ORDER
        assert board.write(offset, NEW[offset : offset + 400]) == Refusal.NONE
    for _ in range(3):
        assert board.end() == Refusal.NONE
        assert board.crc == crc_of(NEW)


def flipped(image: bytes, at: int) -> bytes:
    return image[:at] + bytes([image[at] ^ 1]) + image[at + 1 :]


@pytest.mark.parametrize(
    ("sent", "why"),
    [
        *((flipped(NEW, 0), CRC), (flipped(NEW, 511), CRC), (flipped(NEW, len(NEW) - 1), CRC)),
        *(
            pytest.param(flipped(NEW, at), HEADER, marks=() if at % 8 == 0 else pytest.mark.slow)
            for at in range(IMAGE_HEADER_OFFSET, IMAGE_HEADER_OFFSET + HEADER_BYTES)
        ),
        (flipped(NEW, IMAGE_HEADER_OFFSET + HEADER_BYTES), CRC),
        (make_image(4, len(NEW)), HEADER),
    ],
)
def test_an_image_is_refused_when_other_bytes_were_sent_than_told(
    board: BankBoard, sent: bytes, why: int
) -> None:
    assert board.begin(header_of(NEW)) == (Refusal.NONE, 0)
    for offset in range(0, len(sent), 400):
        assert board.write(offset, sent[offset : offset + 400]) == Refusal.NONE
    assert board.end() == Refusal.IMAGE
    assert board.why == why
    assert board.end() == Refusal.ORDER, "it has to be begun anew"
    assert board.switch(digest(NEW)) == Refusal.IMAGE
    assert board.boot().image == OLD
    assert board.arrive(NEW) == Refusal.NONE


# --- Hash and switch ------------------------------------------------------------------------------
def test_no_hash_is_told_when_a_bank_has_no_image(board: BankBoard) -> None:
    assert board.begin(header_of(NEW)) == (Refusal.NONE, 0)
    assert board.hash(1) == MAGIC
    assert board.hash(0) == digest(OLD)
    board.chip.fill(FLASH_BANKS[1].address, changed(NEW, "image_bytes", struct.pack("<I", 2**31)))
    assert board.hash(1) == SIZE


def test_nothing_is_switched_when_it_is_not_the_image_of_that_hash(board: BankBoard) -> None:
    assert board.switch(digest(NEW)) == Refusal.IMAGE
    assert board.why == SHA256
    assert board.arrive(NEW) == Refusal.NONE
    operations = board.chip.operations
    for told in (digest(OLD), bytes(32), flipped(digest(NEW), 0), flipped(digest(NEW), 31)):
        assert board.switch(told) == Refusal.IMAGE
        assert board.why == SHA256
    board.chip.fill(FLASH_BANKS[1].address + 100, b"\0")
    damaged = board.chip.region(FLASH_BANKS[1])[: len(NEW)]
    assert board.switch(digest(damaged)) == Refusal.IMAGE, "told or not, it is not whole"
    assert board.why == CRC
    assert board.chip.operations == operations
    assert board.boot().image == OLD


def test_a_switch_changes_nothing_when_it_is_repeated(board: BankBoard) -> None:
    assert board.arrive(NEW) == Refusal.NONE
    assert board.switch(digest(NEW)) == Refusal.NONE
    operations = board.chip.operations
    for _ in range(3):
        assert board.switch(digest(NEW)) == Refusal.NONE
        assert board.sequence == 8
    assert board.chip.operations == operations


def test_a_switch_is_taken_back_when_an_image_is_begun_again(board: BankBoard) -> None:
    assert board.arrive(NEW) == Refusal.NONE
    assert board.switch(digest(NEW)) == Refusal.NONE
    assert board.begin(header_of(NEW)) == (Refusal.NONE, 0)
    assert board.boot().image == OLD
    assert board.arrive(NEW) == Refusal.NONE
    assert board.switch(digest(NEW)) == Refusal.NONE
    assert board.boot().image == NEW


def test_a_switch_needs_no_update_when_the_image_is_there_already(board: BankBoard) -> None:
    assert board.arrive(NEW) == Refusal.NONE
    assert board.boot().image == OLD
    assert board.switch(digest(NEW)) == Refusal.NONE
    assert board.boot().image == NEW


def test_an_older_image_is_not_switched_to_as_it_has_its_number(board: BankBoard) -> None:
    assert board.switch(digest(OLDER)) == Refusal.ORDER
    assert board.chip.operations == 0
    assert board.arrive(OLDER) == Refusal.NONE, "it has to be written anew"
    assert board.switch(digest(OLDER)) == Refusal.NONE
    assert board.boot().image == OLDER


def test_a_failed_image_is_not_switched_to_until_it_is_written_anew(board: BankBoard) -> None:
    assert board.arrive(NEW) == Refusal.NONE
    assert board.switch(digest(NEW)) == Refusal.NONE
    for _ in range(2):
        assert board.boot().image == NEW
        assert board.lib.image_bank_count_start(board.chip.flash, 1)
    assert board.boot().image == OLD, "the third start is the old one's"
    assert board.switch(digest(NEW)) == Refusal.ORDER
    assert board.arrive(NEW) == Refusal.NONE
    assert board.switch(digest(NEW)) == Refusal.NONE
    assert board.boot().image == NEW
    assert board.lib.image_bank_reject(board.chip.flash, 1)
    assert board.boot().image == OLD


@pytest.mark.parametrize("spare", ["erased", "written", "installed"])
def test_a_switch_counts_when_the_rom_has_installed_what_runs(chip: MakeChip, spare: str) -> None:
    made = chip()
    made.core.lib.scripted_action = [0.0] * 4
    unproven = Held(OLDER, state(sequence=3, confirmed=False, written=True))
    held = {"erased": Held(), "written": unproven, "installed": Held(NEW)}
    b = BankBoard(made, [Held(OLD), held[spare]])
    b.slots.put(SLOT_A, b.slots.image)
    assert b.boot().image == OLD
    if spare != "installed":
        assert b.arrive(NEW) == Refusal.NONE
    assert b.switch(digest(NEW)) == Refusal.NONE
    assert b.sequence == 2
    assert b.boot().image == NEW


# --- An image and its policy ----------------------------------------------------------------------
def put_policies(board: BankBoard, a: int | None, b: int | None, **changes: Any) -> None:
    for slot, sequence in ((SLOT_A, a), (SLOT_B, b)):
        board.slots.put(slot, b"\xff" * 4)
        if sequence is not None:
            board.slots.put(slot, like(board.slots.image, sequence, sequence % 1000, 0.5, **changes))


@pytest.mark.parametrize(("a", "b"), [(5, None), (None, 5), (4, 5), (5, 4), (2**32 - 1, 0), (2**31, None)])
def test_each_image_flies_its_own_policy_when_it_came_with_one(
    board: BankBoard, a: int | None, b: int | None
) -> None:
    put_policies(board, a, b)
    old = board.boot()
    assert board.install(NEW, 9, 0.25) == Refusal.NONE
    assert board.slots.slots.found[1 - old.flown] == BUILD, "the running image does not fly it"
    new = board.boot()
    assert (new.image, new.weights, new.flown) == (NEW, floats(9, 0.25), 1 - old.flown)
    assert board.lib.image_bank_reject(board.chip.flash, 1)
    assert board.boot() == old, "which goes back to its own"
    assert board.install(NEW, 7, 0.25) == Refusal.NONE
    assert board.boot().weights == floats(7, 0.25)
    assert board.settle()
    newer = make_image(4, 3000, bank=0)
    assert board.install(newer, 8, 0.5) == Refusal.NONE
    assert (board.boot().image, board.boot().weights) == (newer, floats(8, 0.5))


def test_a_new_image_flies_the_policy_of_before_when_it_is_for_any_and_none_came(board: BankBoard) -> None:
    put_policies(board, 4, 5)
    assert board.boot().flown == SLOT_B
    assert board.arrive(NEW) == Refusal.NONE
    assert board.switch(digest(NEW)) == Refusal.NONE
    started = board.boot()
    assert (started.image, started.flown) == (NEW, SLOT_B)


OTHER_CODE = changed(NEW, "architecture_hash", struct.pack("<I", 5))


@pytest.mark.parametrize(
    ("image", "change", "why"),
    [
        (NEW, {"architecture_hash": 5}, ARCHITECTURE),
        (NEW, {"build": b"whatever"}, BUILD),
        (OTHER_CODE, {}, ARCHITECTURE),
        (OTHER_CODE, {"control_rate_hz": 500}, -11),
        (OTHER_CODE, {"filters_hash": 1}, -12),
        (OTHER_CODE, {"idle": 0.0}, ARCHITECTURE),
    ],
)
def test_a_policy_is_refused_when_it_does_not_fit_the_image_that_it_came_with(
    board: BankBoard, image: bytes, change: dict[str, Any], why: int
) -> None:
    assert board.arrive(image) == Refusal.NONE
    policy = parse(board.policy_of(image, 9, 0.25, sequence=1))
    data = pack(replace(policy, **change))
    assert board.slots.begin(len(data)) == Refusal.NONE
    assert board.slots.write(0, data) == Refusal.NONE
    assert board.slots.end() == (Refusal.BLOB, why)
    fits = pack(replace(policy, architecture_hash=5)) if image is OTHER_CODE else pack(policy)
    assert board.slots.update(fits) == Refusal.NONE
    assert board.switch(digest(image)) == Refusal.NONE


def test_a_policy_of_the_other_image_is_refused_when_that_is_not_there(board: BankBoard) -> None:
    data = board.policy_of(NEW, 9, 0.25, sequence=1)
    assert board.slots.update(data) == Refusal.BLOB, "the spare bank holds an older one"
    assert board.slots.update(board.policy_of(OLDER, 9, 0.25, sequence=1)) == Refusal.NONE
    assert board.begin(header_of(NEW)) == (Refusal.NONE, 0)
    assert board.slots.update(data) == Refusal.BLOB, "nor is any of it"


@pytest.mark.parametrize("image", [NEW, OTHER_CODE])
def test_nothing_is_switched_to_an_image_before_a_slot_holds_its_policy(
    board: BankBoard, image: bytes
) -> None:
    put_policies(board, 5, None, build=b"theother")
    assert board.boot().flown == NONE
    assert board.arrive(image) == Refusal.NONE
    own = parse(board.policy_of(image, 9, 0.25, sequence=6))
    hashed = 5 if image is OTHER_CODE else own.architecture_hash
    fits = pack(replace(own, architecture_hash=hashed))
    operations = board.chip.operations
    for held, why in (
        (b"\xff" * 4, BUILD),  # what the other slot holds
        (pack(replace(own, architecture_hash=hashed + 1)), ARCHITECTURE),
        (fits[:-1] + bytes([fits[-1] ^ 1]), BLOB_CRC),
        (bytes(4), BUILD),
    ):
        board.slots.put(SLOT_B, held)
        assert board.switch(digest(image)) == Refusal.BLOB
        assert board.why == why
    board.slots.put(SLOT_A, bytes(4))
    assert (board.switch(digest(image)), board.why) == (Refusal.BLOB, BLOB_MAGIC)
    assert board.chip.operations == operations
    assert board.boot().image == OLD
    board.slots.put(SLOT_B, fits)
    assert board.switch(digest(image)) == Refusal.NONE
    assert (board.boot().image, board.boot().weights) == (image, floats(9, 0.25))


def test_both_policies_are_held_from_the_switch_until_the_new_image_has_run_well(board: BankBoard) -> None:
    assert not board.holds_slots
    assert board.arrive(NEW) == Refusal.NONE
    assert not board.holds_slots, "it is not started"
    assert board.switch(digest(NEW)) == Refusal.NONE
    assert board.holds_slots, "it is started next"
    assert board.boot().image == NEW
    assert board.holds_slots, "the board may go back"
    content = board.chip.content
    assert board.settle()
    assert not board.holds_slots
    board.chip.content = content
    assert board.lib.image_bank_reject(board.chip.flash, 1)
    assert board.boot().image == OLD
    assert not board.holds_slots, "it has gone back"
    board.chip.content = content
    board.boot()
    board.chip.fill(FLASH_BANKS[0].address + 100, b"\0")
    assert not board.holds_slots, "it cannot go back to what is damaged"


# --- Going back to the policy before --------------------------------------------------------------
def revert(board: BankBoard) -> int:
    return int(board.lib.policy_slots_revert(board.slots.slots))


@pytest.mark.parametrize(("a", "b", "then"), [(4, 5, SLOT_A), (5, 4, SLOT_B)])
def test_the_policy_before_is_flown_when_it_is_gone_back_to(
    board: BankBoard, a: int | None, b: int | None, then: int
) -> None:
    put_policies(board, a, b)
    assert board.boot().weights == floats(5, 0.5)
    for _ in range(3):
        assert revert(board) == Refusal.NONE, "it may be repeated"
        assert board.chip.operations == 1
    assert board.slots.begin(1000) == Refusal.ORDER, "it would erase what is flown next"
    started = board.boot()
    assert started.flown == then
    assert started.weights == floats(4, 0.5)
    assert board.slots.update(pack(like(board.slots.image, board.slots.next_sequence, 8, 8))) == Refusal.NONE
    assert board.boot().weights == floats(8, 8)


@pytest.mark.parametrize(
    "before",
    [
        None,
        {"build": b"another1"},
        {"architecture_hash": 1},
        {"selftest_action": np.ones((3, 4), np.float32)},
    ],
)
@pytest.mark.parametrize("flown", [SLOT_A, SLOT_B])
def test_nothing_is_gone_back_to_when_the_other_slot_holds_nothing_for_this_image(
    board: BankBoard, flown: int, before: dict[str, Any] | None
) -> None:
    put_policies(board, None, None)
    board.slots.put(flown, like(board.slots.image, 5, 5, 0.5))
    if before is not None:
        board.slots.put(1 - flown, like(board.slots.image, 6, 4, 0.5, **before))
    assert board.boot().flown == flown
    assert revert(board) == Refusal.ORDER
    assert board.chip.operations == 0
    board.slots.put(flown, bytes(4))
    assert board.boot().flown == NONE
    assert revert(board) == Refusal.ORDER, "nor where none flies"


def test_nothing_is_gone_back_to_when_another_policy_waits_for_the_restart(board: BankBoard) -> None:
    put_policies(board, 4, 5)
    board.boot()
    assert board.slots.update(pack(like(board.slots.image, 6, 8, 8))) == Refusal.NONE
    operations = board.chip.operations
    assert revert(board) == Refusal.ORDER
    assert board.chip.operations == operations
    assert board.boot().weights == floats(8, 8)
    assert revert(board) == Refusal.NONE
    assert board.boot().weights == floats(5, 0.5)


def test_nothing_is_gone_back_to_when_an_update_is_under_way(board: BankBoard) -> None:
    put_policies(board, 4, 5)
    board.boot()
    new = pack(like(board.slots.image, 6, 8, 8))
    assert board.slots.begin(len(new)) == Refusal.NONE
    assert revert(board) == Refusal.ORDER, "the slot that it would go back to is erased"
    assert board.slots.write(0, new) == Refusal.NONE, "the update goes on"
    assert board.slots.end() == (Refusal.NONE, 0)
    assert board.boot().weights == floats(8, 8)


def test_flash_is_told_to_have_refused_when_it_cannot_be_gone_back(board: BankBoard) -> None:
    put_policies(board, 4, 5)
    board.boot()
    board.chip.cut(0, 0, 1)
    assert revert(board) == Refusal.FLASH
    assert board.boot().weights == floats(5, 0.5)


# --- What a slot holds ----------------------------------------------------------------------------
def test_a_slot_tells_what_it_holds_now(board: BankBoard) -> None:
    header = board.core.new("struct nf_policy_blob_header *")

    def info(source: int) -> tuple[int, int, int]:
        found = board.lib.policy_slots_info(board.slots.slots, source, header)
        return int(found), int(header.sequence), int(header.control_rate_hz)

    put_policies(board, 4, 5)
    board.slots.put(SLOT_B, like(board.slots.image, 5, control_rate_hz=500))
    board.boot()
    assert [info(source) for source in range(2)] == [(0, 4, 1000), (-11, 5, 500)]
    assert board.slots.begin(1000) == Refusal.NONE
    assert info(SLOT_B) == (BLOB_MAGIC, 0, 0)
    board.slots.put(SLOT_B, flipped(pack(like(board.slots.image, 5)), 300))
    assert info(SLOT_B) == (-10, 0, 0), "a damaged header is not told"
    board.slots.put(SLOT_B, like(board.slots.image, 9, selftest_action=board.slots.image.selftest_action + 1))
    assert board.boot().flown == SLOT_A
    assert info(SLOT_B) == (-5, 9, 1000)
    board.slots.put(SLOT_B, like(board.slots.image, 3))
    board.boot()
    assert revert(board) == Refusal.NONE
    assert info(SLOT_A) == (BLOB_MAGIC, 0, 0)
