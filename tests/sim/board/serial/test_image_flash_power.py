"""Power that goes at any moment of an image flash over UART1, and again while that is repeated."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from neuroflight.flash.board.info import read_info
from neuroflight.flash.image.files import Image, read_images
from neuroflight.flash.image.messages import (
    DATA_BYTES_MAX,
    Banks,
    image_info,
    image_write,
    number,
)
from neuroflight.flash.link import requests
from neuroflight.flash.policy.slots import read_policies
from neuroflight.sim.board.debug.snapshot import Snapshot
from neuroflight.sim.board.peripherals.flash import Cut
from neuroflight.sim.board.serial.idle_board import IdleBoard, configured
from neuroflight.toolchain.contract import (
    FLASH_BANKS,
    FLASH_BASE,
    FLASH_POLICY_SLOTS,
    IMAGE_PROBATION_MS,
    IMAGE_TAIL_BYTES,
    Msp,
    bound_policy,
    image_header,
)
from neuroflight.toolchain.image.bank_state import state
from tests.flash.image.conftest import stamped
from tests.flash.image.emulated import BAUD
from tests.sim.board.serial.power import SHOWN, PowerBench

A, B = range(2)
WRITTEN = bytes(4)  # the marks of an image that arrived and was not switched to


@dataclass(frozen=True)
class Stage:
    """Something of an update; `operations` of flash belong to it."""

    name: str
    operations: int = 0
    block: int | None = None  # of the body: which one is sent

    def __str__(self) -> str:
        return self.name if self.block is None else f"{self.name}{self.block}"


BEGIN = Stage("begin", 3)  # the old image's header, the sector, the mark that the firmware writes
END = Stage("end")
SLOT_BEGIN = Stage("slot_begin", 1)  # the slot that is not flown
SLOT_END = Stage("slot_end", 1)  # the policy's first word makes it one
SWITCH = Stage("switch", 2)  # the number and its complement, which makes it one
RESTART = Stage("restart", 26)  # the boot part counts the start, the image logs it
CONFIRM = Stage("confirm", 1)
BLOCK_WORDS = DATA_BYTES_MAX // 4
SLOT_WORDS = requests.SLOT_BYTES_MAX // 4
SAMPLED = (0, 100)  # blocks


def block(number: int) -> Stage:
    return Stage("block", BLOCK_WORDS, number)


def policy_block(number: int) -> Stage:
    """The first one's first word waits for the end."""
    return Stage("policy", SLOT_WORDS - (number == 0), number)


def built(image: bytes, build: bytes) -> Image:
    """The same as if it were of another build."""
    data = stamped(image, build=build)
    header = image_header(data)
    assert header is not None
    return Image(header, data)


class Bench(PowerBench):
    """An idle board that runs bank A's image with the policy in slot A, and gets other ones."""

    def __init__(self, idle: IdleBoard, old: Image, new: Image, policy: bytes) -> None:
        """policy: the new image's, with the number that is due."""
        super().__init__(idle)
        self.old, self.new, self.policy = old, new, policy
        self.blocks = [block(number) for number in range(-(-len(new.data) // DATA_BYTES_MAX))]
        self.policy_blocks = [
            policy_block(number) for number in range(-(-len(policy) // requests.SLOT_BYTES_MAX))
        ]

    def carry_out(self, stage: Stage) -> bool:
        """One stage. Returns whether power stayed all the time."""
        resets = len(self.engine.resets)
        if stage == BEGIN:
            return self.frame(Msp.IMAGE_BEGIN, self.new.header.raw) is not None
        if stage == END:
            reply = self.frame(Msp.IMAGE_END)
            return reply is not None and number(Msp.IMAGE_END, reply) == self.new.header.crc
        if stage == SWITCH:
            return self.frame(Msp.IMAGE_SWITCH, self.new.sha256) is not None
        if stage == SLOT_BEGIN:
            reply = self.frame(Msp.POLICY_SLOT_BEGIN, requests.slot_begin(len(self.policy)))
            assert reply is None or requests.slot_begun(reply) == 1
            return reply is not None
        if stage == SLOT_END:
            return self.frame(Msp.POLICY_SLOT_END) is not None
        if stage.name == "policy" and stage.block is not None:
            at = stage.block * requests.SLOT_BYTES_MAX
            piece = self.policy[at : at + requests.SLOT_BYTES_MAX]
            return self.frame(Msp.POLICY_SLOT_WRITE, requests.slot_write(at, piece)) is not None
        if stage.block is not None:
            at = stage.block * DATA_BYTES_MAX
            data = self.new.data[at : at + DATA_BYTES_MAX]
            return self.frame(Msp.IMAGE_WRITE, image_write(at, data)) is not None
        if stage == RESTART:
            if self.frame(Msp.REBOOT) is None:
                return False
            self.wired.sleep(0.01)
            assert self.engine.resets[resets:] in (["software"], ["software", "power"])
            self.idle.boot()
        else:
            self.wired.sleep(IMAGE_PROBATION_MS / 1000 + 0.3)
        return "power" not in self.engine.resets[resets:]

    def left(self) -> list[Stage]:
        """What is left to do until the new image has confirmed itself."""
        banks = self.banks()
        if banks.running == A:
            policy = (SLOT_BEGIN, *self.policy_blocks, SLOT_END)
            return [BEGIN, *self.blocks, END, *policy, SWITCH, RESTART, CONFIRM]
        return [] if banks.now.confirmed else [CONFIRM]

    def update(self) -> dict[Stage, tuple[Snapshot, int]]:
        """All of that. Returns, of the stages that are cut, the state before and the operations they took."""
        kept = {}
        for stage in self.left():
            sampled = stage.operations > 0 and (stage.block is None or stage.block in SAMPLED)
            before = self.take() if sampled else None
            operations = self.flash.operations
            assert self.carry_out(stage), stage
            if before is not None:
                kept[stage] = before, self.flash.operations - operations
        assert self.banks().now.confirmed and self.running() is self.new
        return kept

    # --- What it looks at ---------------------------------------------------------------------------
    def banks(self) -> Banks:
        reply = self.frame(Msp.IMAGE_INFO)
        assert reply is not None
        return image_info(reply)

    def running(self) -> Image:
        """The whole image that runs with its own policy, which passed its self-test."""
        with self.wired.client() as client:
            info = read_info(client)
            flown = read_policies(client).flown
        assert info.policy is not None and info.policy.good
        assert not SHOWN & set(info.arming_reasons)
        region, image = FLASH_BANKS[self.banks().running], (self.old, self.new)[self.banks().running]
        assert self.engine.memory(region.address, len(image.data)) == image.data
        assert flown is not None and flown.build == image.header.build.hex()
        return image

    def cut(self, stage: Stage, operation: int, cut: Cut) -> Image:
        """Power goes in that operation of the stage, which is the next one, and comes back: what runs."""
        resets = len(self.engine.resets)
        self.cut_at(operation, cut)
        assert not self.carry_out(stage), "power did not go"
        assert self.engine.resets[resets:].count("power") == 1
        self.idle.boot()
        runs = self.running()
        assert runs is self.old or stage in (SWITCH, RESTART, CONFIRM)
        return runs

    def at(self, snapshot: Snapshot) -> Bench:
        self.restore(snapshot)
        return self


def with_bank_b(flash: bytes, image: Image, marks: bytes) -> bytes:
    region = FLASH_BANKS[B]
    at = region.address - FLASH_BASE
    bank = image.data.ljust(region.size - IMAGE_TAIL_BYTES, b"\xff") + marks.ljust(IMAGE_TAIL_BYTES, b"\xff")
    return flash[:at] + bank + flash[at + region.size :]


def with_slot_b(flash: bytes, policy: bytes) -> bytes:
    at = FLASH_POLICY_SLOTS[B].address - FLASH_BASE
    return flash[:at] + policy + flash[at + len(policy) :]


class Kept:
    """A bench, and its states before stages of one update: each is reached once."""

    def __init__(self, bench: Bench, states: dict[Stage, Snapshot]) -> None:
        policy = [SLOT_BEGIN, *bench.policy_blocks, SLOT_END]
        self.bench, self.order = bench, [BEGIN, block(0), *policy, SWITCH, RESTART, CONFIRM]
        self.states = states

    def ready_for(self, stage: Stage) -> Bench:
        """One of the stages that need no block sent before."""
        if stage not in self.states:
            end = self.order.index(stage)
            begin = max(at for at in range(end) if self.order[at] in self.states)
            self.bench.at(self.states[self.order[begin]])
            for at in range(begin, end):
                assert self.bench.carry_out(self.order[at])
                self.note(at + 1)
        return self.bench.at(self.states[stage])

    def note(self, at: int) -> None:
        """The bench has done all stages before number `at`."""
        if at < len(self.order):
            self.states.setdefault(self.order[at], self.bench.take())


@pytest.fixture(scope="module")
def kept(board_image: Path) -> Iterator[Kept]:
    file = read_images(board_image.with_suffix(".nfi"))
    (old, other), policy = file.images, file.policy
    assert policy is not None
    flash = configured(board_image.with_suffix(".bin").read_bytes(), board_image, {"msp_baud": BAUD})
    older, new = built(other.data, b"olderone"), built(other.data, b"newbuild")
    idle = IdleBoard(with_bank_b(flash, older, state(sequence=0, confirmed=True)))
    bench = Bench(idle, old, new, bound_policy(policy.data, b"newbuild", 1))
    idle.boot()
    states = {BEGIN: bench.take()}
    arrived = with_bank_b(flash, new, WRITTEN)
    for stage, content in ((SLOT_BEGIN, arrived), (SWITCH, with_slot_b(arrived, bench.policy))):
        idle.board.engine.set_memory(FLASH_BASE, content)
        idle.board.reset()
        idle.boot()
        states[stage] = bench.take()
    yield Kept(bench, states)
    idle.close()


# --- Once -------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "stage",
    [
        *(pytest.param(stage, marks=pytest.mark.slow) for stage in (BEGIN, SLOT_BEGIN, policy_block(0))),
        pytest.param(SLOT_END, marks=pytest.mark.slow),  # behind all the blocks
        *(block(0), SWITCH, RESTART, CONFIRM),
    ],
    ids=str,
)
def test_a_stage_takes_as_many_operations_as_are_cut(kept: Kept, stage: Stage) -> None:
    bench = kept.ready_for(stage)
    operations = bench.flash.operations
    assert bench.carry_out(stage)
    assert bench.flash.operations == operations + stage.operations
    kept.note(kept.order.index(stage) + 1)


ONCE = [
    *((BEGIN, at) for at in range(BEGIN.operations)),
    *((block(0), at) for at in (0, 1, 60, BLOCK_WORDS - 1)),
    (SLOT_BEGIN, 0),
    *((policy_block(0), at) for at in (0, 1, 60, SLOT_WORDS - 2)),
    (SLOT_END, 0),
    *((SWITCH, at) for at in range(SWITCH.operations)),
    *((RESTART, at) for at in range(RESTART.operations)),
    (CONFIRM, 0),
]
SAMPLE = {  # of the ordinary run: tests/firmware/storage cuts at every operation
    (BEGIN, 1, Cut.NOISE),
    (block(0), 60, Cut.NOISE),
    (SLOT_BEGIN, 0, Cut.NOISE),
    (policy_block(0), 60, Cut.WORDS),
    (SWITCH, 0, Cut.NOISE),
    (SWITCH, 1, Cut.AFTER),
    (RESTART, 0, Cut.BETWEEN),
    (CONFIRM, 0, Cut.NOISE),
}


@pytest.mark.parametrize(
    ("stage", "operation", "cut"),
    [
        pytest.param(
            *(stage, at, cut),
            marks=[] if (stage, at, cut) in SAMPLE else pytest.mark.slow,
            id=f"{stage}-{at}-{cut.name.lower()}",
        )
        for stage, at in ONCE
        for cut in Cut
    ],
)
def test_a_whole_image_runs_when_power_goes(kept: Kept, stage: Stage, operation: int, cut: Cut) -> None:
    bench = kept.ready_for(stage)
    runs = bench.cut(stage, operation, cut)
    if stage == SWITCH and operation < SWITCH.operations - 1:
        assert runs is bench.old, "a number counts when its last word stands"
    if (stage, cut) == (CONFIRM, Cut.AFTER):
        assert runs is bench.new and bench.banks().now.confirmed


@pytest.mark.slow
def test_the_switch_is_done_again_when_it_was_cut_twice(kept: Kept) -> None:
    bench = kept.ready_for(SWITCH)
    for operation in (1, 0):
        assert bench.cut(SWITCH, operation, Cut.NOISE) is bench.old
    for stage in (SWITCH, RESTART, CONFIRM):
        assert bench.carry_out(stage)
    assert bench.running() is bench.new and bench.banks().now.confirmed


# --- And again in the recovery, which is the whole update ---------------------------------------------
FIRST = [
    *((BEGIN, at, cut) for at in range(BEGIN.operations) for cut in (Cut.BETWEEN, Cut.NOISE)),
    (block(0), 60, Cut.NOISE),
    *((SWITCH, at, cut) for at in range(SWITCH.operations) for cut in (Cut.BETWEEN, Cut.NOISE)),
    (SWITCH, 1, Cut.AFTER),
    (SLOT_BEGIN, 0, Cut.NOISE),
    (policy_block(0), 60, Cut.NOISE),
    *((SLOT_END, 0, cut) for cut in (Cut.BETWEEN, Cut.AFTER)),
    *((RESTART, 0, cut) for cut in (Cut.AFTER, Cut.NOISE)),
    (RESTART, 12, Cut.NOISE),
    *((CONFIRM, 0, cut) for cut in (Cut.BEFORE, Cut.BETWEEN, Cut.NOISE)),
]
SECOND = [
    *((BEGIN, at, Cut.NOISE) for at in range(BEGIN.operations)),
    *((block(number), 60, Cut.NOISE) for number in SAMPLED),
    (SLOT_BEGIN, 0, Cut.NOISE),
    (policy_block(0), 60, Cut.NOISE),
    (SLOT_END, 0, Cut.NOISE),
    *((SWITCH, at, Cut.NOISE) for at in (0, 1)),
    (SWITCH, 1, Cut.BETWEEN),
    *((RESTART, 0, cut) for cut in (Cut.AFTER, Cut.BETWEEN)),
    *((CONFIRM, 0, cut) for cut in (Cut.BEFORE, Cut.NOISE)),
]


@pytest.mark.slow
@pytest.mark.parametrize("first", FIRST, ids=[f"{stage}-{at}-{cut.name.lower()}" for stage, at, cut in FIRST])
def test_a_whole_image_runs_when_power_goes_in_the_recovery_and_a_retry_ends_well(
    kept: Kept, first: tuple[Stage, int, Cut]
) -> None:
    """A sample: tests/firmware/storage cuts at every operation, once and again."""
    bench = kept.ready_for(first[0])
    bench.cut(*first)
    stages, pairs = bench.update(), 0
    for stage, at, cut in SECOND:
        before, operations = stages.get(stage, (None, 0))
        if before is not None and at < operations:
            bench.at(before).cut(stage, at, cut)
            pairs += 1
    print(f"{pairs} pairs")
    assert pairs > 0
    bench.update()
