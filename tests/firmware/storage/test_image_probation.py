"""image_probation.c and the boot part's choice: an image's trial from start to start, losses of power."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from typing import Any

import pytest

from neuroflight.toolchain.contract import (
    FLASH_BANKS,
    IMAGE_PROBATION_MAX_MS,
    IMAGE_PROBATION_MS,
    IMAGE_STARTS_MAX,
    IMAGE_TAIL_BYTES,
)
from neuroflight.toolchain.image.bank_state import state
from tests.firmware.images import LEAST_BYTES, make_image

MakeChip = Callable[..., Any]
A, B, NONE = range(3)
STAYS, CONFIRM, REJECT = range(3)  # enum image_verdict
PERIOD_MS = 100  # of the storage task
RATE_HZ = 1000  # of the scripted policy
BOARD = b"HOST"
SMALL, LARGE = 1024, 100 * 1024  # bytes of an image
KINDS = range(5)  # of cuts: enum flash_cut
RUN_WELL = state(sequence=5, confirmed=True)
NEW = state(sequence=6, confirmed=False, written=True)
INSTALLED = b""


def image(bank: int, size: int = SMALL, *, wrong: bool = False) -> bytes:
    """An image of `size` bytes; wrong: one bit of it is."""
    content = bytearray(make_image(bank, size, bank=bank))
    content[-1] ^= wrong
    return bytes(content)


@dataclass
class Board:
    """What the boot part and the firmware's background make of a flash: a restart is a new boot."""

    chip: Any

    def put(self, bank: int, content: bytes, marks: bytes) -> None:
        region = FLASH_BANKS[bank]
        self.chip.fill(region.address, content)
        self.chip.fill(region.address + region.size - IMAGE_TAIL_BYTES, marks)

    def marks(self, bank: int) -> Any:
        return self.chip.core.lib.image_bank_marks(self.chip.flash, bank)

    def boot(self) -> int:
        """The boot part: the bank that it starts, its start counted."""
        core, flash = self.chip.core, self.chip.flash
        board = core.new("char[16]", BOARD)
        good = core.new("bool[2]", [core.lib.image_bank_whole(flash, bank, board) for bank in (A, B)])
        marks = core.new("struct image_bank_marks[2]", [self.marks(A), self.marks(B)])
        bank = int(core.lib.image_bank_choose(marks, good))
        if bank != NONE and not marks[bank].confirmed:
            core.lib.image_bank_count_start(flash, bank)
        return bank

    def start(self, bank: int) -> Any:
        """A trial of the image in that bank."""
        probation = self.chip.core.new("struct image_probation *")
        self.chip.core.lib.image_probation_init(probation, self.chip.flash, bank)
        return probation

    def step(self, probation: Any, ms: int, *, steps: int | None = None, policy: bool = True) -> int:
        """The verdict at `ms` after the start; steps: control steps so far, all of them unless told."""
        steps = ms * RATE_HZ // 1000 if steps is None else steps
        report = self.chip.core.new("struct image_report *", (policy, steps, ms))
        return int(self.chip.core.lib.image_probation_step(probation, report))

    def run(self, bank: int, *, policy: bool = True, seconds: float = 3.0) -> tuple[int, int]:
        """Let it run until a verdict is carried out: the verdict, and the time [ms]."""
        lib, probation = self.chip.core.lib, self.start(bank)
        for ms in range(PERIOD_MS, round(1000 * seconds), PERIOD_MS):
            verdict = self.step(probation, ms, policy=policy)
            if verdict == CONFIRM and lib.image_probation_confirm(probation):
                return verdict, ms
            if verdict == REJECT and lib.image_probation_reject(probation):
                return verdict, ms
        return STAYS, ms


@pytest.fixture
def board(chip: MakeChip) -> Board:
    return Board(chip())


@pytest.mark.parametrize("bank", [A, B])
@pytest.mark.parametrize("size", [LEAST_BYTES + 64, SMALL, LARGE, FLASH_BANKS[A].size - IMAGE_TAIL_BYTES])
def test_an_image_confirms_itself_when_it_has_run_well_for_long_enough(
    board: Board, bank: int, size: int
) -> None:
    board.put(bank, image(bank, size), NEW)
    assert board.run(bank) == (CONFIRM, IMAGE_PROBATION_MS)
    assert board.marks(bank).confirmed
    assert not board.chip.core.lib.image_probation_holds(board.start(bank))


def test_nothing_is_on_trial_when_the_bank_holds_no_image(board: Board) -> None:
    """The host program."""
    probation = board.start(A)
    assert all(board.step(probation, ms, policy=False) == STAYS for ms in range(100, 20_000, 100))
    assert not board.chip.core.lib.image_probation_holds(probation)
    assert not board.chip.core.lib.image_probation_spoilt(probation)
    assert board.chip.operations == 0


def test_it_numbers_itself_past_the_other_when_the_rom_installed_it(board: Board) -> None:
    board.put(A, image(A), RUN_WELL)
    board.put(B, image(B), INSTALLED)
    assert board.boot() == B
    assert board.run(B)[0] == CONFIRM
    assert (board.marks(B).sequence, board.marks(B).numbered, board.marks(B).installed) == (6, True, False)
    assert board.boot() == B


@pytest.mark.parametrize("policy", [True, False])
@pytest.mark.parametrize("wrong", [True, False])
def test_it_gives_way_when_policy_or_checksum_is_wrong(board: Board, policy: bool, wrong: bool) -> None:
    board.put(A, image(A), RUN_WELL)
    board.put(B, image(B, LARGE, wrong=wrong), NEW)
    verdict, ms = board.run(B, policy=policy)
    assert verdict == (CONFIRM if policy and not wrong else REJECT)
    assert ms <= IMAGE_PROBATION_MS
    assert board.marks(B).rejected == (verdict == REJECT)
    assert board.boot() == (B if verdict == CONFIRM else A)


REJECTED = RUN_WELL[:-8] + bytes(4) + RUN_WELL[-4:]
USED_UP = NEW[:-16] + bytes(8) + NEW[-8:]
assert len(REJECTED) == len(RUN_WELL) and IMAGE_STARTS_MAX == 2


@pytest.mark.parametrize("spoilt", [False, True], ids=["bad policy", "not whole"])
@pytest.mark.parametrize(
    ("content", "marks"),
    [
        (b"", b""),
        (image(A, wrong=True), RUN_WELL),
        (image(B), RUN_WELL),
        (image(A), bytes(4)),  # written by the firmware and never given a number
        (image(A), REJECTED),
        (image(A), USED_UP),
    ],
    ids=["nothing", "wrong checksum", "wrong bank", "no number", "rejected", "failed"],
)
def test_it_stays_however_bad_when_the_other_bank_has_nothing_better(
    board: Board, content: bytes, marks: bytes, spoilt: bool
) -> None:
    board.put(A, content, marks)
    board.put(B, image(B, wrong=spoilt), NEW)
    assert board.run(B, policy=spoilt, seconds=12.0)[0] == STAYS
    assert not board.marks(B).rejected and board.chip.core.lib.image_probation_holds(board.start(B))


def test_it_gives_way_when_it_has_not_run_well_in_time(board: Board) -> None:
    """Of its control steps hardly any come."""
    board.put(A, image(A), RUN_WELL)
    board.put(B, image(B), NEW)
    probation = board.start(B)
    verdicts = {ms: board.step(probation, ms, steps=ms // 100) for ms in range(100, 12_000, 100)}
    assert min(ms for ms, verdict in verdicts.items() if verdict == REJECT) == IMAGE_PROBATION_MAX_MS
    assert CONFIRM not in verdicts.values()


def test_a_silent_gyro_neither_confirms_nor_rejects_an_image(board: Board) -> None:
    board.put(A, image(A), RUN_WELL)
    board.put(B, image(B), NEW)
    probation = board.start(B)
    assert {board.step(probation, ms, steps=0) for ms in range(100, 60_000, 100)} == {STAYS}
    assert board.chip.core.lib.image_probation_holds(probation)
    later = {ms: board.step(probation, 60_000 + ms, steps=ms) for ms in range(100, 3000, 100)}
    assert min(ms for ms, verdict in later.items() if verdict == CONFIRM) == IMAGE_PROBATION_MS
    assert REJECT not in later.values()


def test_a_confirmed_image_says_so_when_flash_does_not_hold_it_whole(board: Board) -> None:
    board.put(A, image(A), RUN_WELL)
    board.put(B, image(B, LARGE, wrong=True), state(sequence=6, confirmed=True))
    probation, lib = board.start(B), board.chip.core.lib
    assert {board.step(probation, ms) for ms in range(100, 12_000, 100)} == {STAYS}
    assert lib.image_probation_spoilt(probation) and not lib.image_probation_holds(probation)
    assert board.chip.operations == 0


# --- Loss of power ------------------------------------------------------------------------------
def live(board: Board, policy: bool) -> None:
    """Start after start, until one goes on; image B's policy may be bad."""
    for _ in range(IMAGE_STARTS_MAX + 2):
        bank = board.boot()
        if bank == NONE or board.run(bank, policy=policy or bank == A)[0] != REJECT:
            return


CASES = {
    "update": ((image(A), RUN_WELL), (image(B), NEW)),
    "factory": ((image(A), INSTALLED), None),
    "by the ROM over another": ((image(A), INSTALLED), (image(B), RUN_WELL)),
}


@pytest.mark.parametrize("policy", [True, False])
@pytest.mark.parametrize("name", CASES)
def test_a_whole_image_flies_when_power_goes_at_any_mark_and_again_in_the_recovery(
    chip: MakeChip, name: str, policy: bool
) -> None:
    made = chip()
    board = Board(made)
    for bank, content in enumerate(CASES[name]):
        if content is not None:
            board.put(bank, *content)
    fresh, runs = made.content, 0
    made.content = fresh
    live(board, policy)
    most = made.operations
    assert most >= 2
    for first, kind, second, again in product(range(most), KINDS, range(most + 1), KINDS):
        made.content = fresh
        for at, how in ((first, kind), (second, again)):
            made.cut(at, how, seed=runs)
            live(board, policy)
            made.power_on()
        live(board, policy)
        bank, runs = board.boot(), runs + 1
        assert bank == board.boot() != NONE
        assert board.marks(bank).confirmed and board.marks(bank).numbered and not board.marks(bank).rejected
        assert bank == A or (policy and name == "update") or name == "by the ROM over another"
    print(f"{name}, policy {'good' if policy else 'bad'}: {most} marks, {runs} pairs of cuts")
