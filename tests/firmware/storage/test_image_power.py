"""Power goes at any operation of an image's flash, a policy's swap or its revert, and again in the recovery.

A story is what a sender does: it looks at what runs and goes on from there until all is as it wants, so
that the same story, told again, is the recovery. After every cut a whole image runs, the old one or the
new one, with its own policy, which passed its self-test; the new ones only after the operation that decides.
"""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
import pytest

from neuroflight.toolchain.contract import Refusal
from neuroflight.toolchain.policy.blob import pack
from tests.firmware.images import build_of
from tests.firmware.storage.bank_board import BankBoard, Held, Started, confirmed, small_image
from tests.firmware.storage.test_policy_slots import SLOT_A, SLOT_B, floats, like

MakeChip = Callable[..., Any]
BEFORE, AFTER, BETWEEN, WORDS, NOISE = KINDS = range(5)
OLD_POLICY, NEW_POLICY, NO_POLICY = floats(4, 0.5), floats(9, 0.25), b""
Cut = tuple[int, int]  # operation, kind


@dataclass(frozen=True)
class State:
    """What runs."""

    image: bytes
    policy: bytes


class Story(ABC):
    """What a sender wants of a board, and how it gets there."""

    def __init__(self, chip: Any, held: list[Held]) -> None:
        self.board = BankBoard(chip, held)
        self.decided = -1  # operations when the decision had been made; -1: not in this telling
        self.refusal = int(Refusal.NONE)

    @property
    @abstractmethod
    def old(self) -> State:
        """Before."""

    @property
    @abstractmethod
    def new(self) -> State:
        """As wanted."""

    @abstractmethod
    def act(self, started: Started) -> bool:
        """From there on; returns whether nothing is left to do. Operations are counted from the boot."""

    def boot(self) -> State:
        """Power comes."""
        started = self.board.boot()
        return State(started.image, started.weights)

    def tell(self, cut: Cut | None = None) -> bool:
        """The story from a boot on; power goes at the operation `cut` from there."""
        self.decided, self.refusal = -1, int(Refusal.NONE)
        started = self.board.boot()
        if cut is not None:
            self.board.chip.cut(cut[0], cut[1], 5 * cut[0] + cut[1])
        return self.act(started)


class FlashStory(Story):
    """An image into the spare bank, its policy, the switch, and the new image's first run."""

    def __init__(
        self, chip: Any, *, running: int, installed: bool, keep: bool = False, slot: int = SLOT_A
    ) -> None:
        self.images = small_image(1, running), small_image(3, 1 - running)
        spare = Held() if installed else confirmed(small_image(2, 1 - running), 6)
        own = Held(self.images[0]) if installed else confirmed(self.images[0], 7)
        super().__init__(chip, [own, spare] if running == 0 else [spare, own])
        self.keep = keep
        self.board.slots.put(
            slot, like(self.board.slots.image, 4, 4, 0.5, build=bytes(8) if keep else build_of(1))
        )
        self.board.slots.put(1 - slot, like(self.board.slots.image, 3, 3, 0.5, build=build_of(2)))

    @property
    def old(self) -> State:
        return State(self.images[0], OLD_POLICY)

    @property
    def new(self) -> State:
        return State(self.images[1], OLD_POLICY if self.keep else NEW_POLICY)

    def act(self, started: Started) -> bool:
        board, image = self.board, self.images[1]
        if started.image != image:
            if self.keep:
                self.refusal = board.arrive(image)
                if self.refusal == Refusal.NONE:
                    self.refusal = board.switch(hashlib.sha256(image).digest())
            else:
                self.refusal = board.install(image, 9, 0.25)
            if self.refusal != Refusal.NONE:
                return False
            self.decided = board.chip.operations
            self.restart()
        return board.settle()

    def restart(self) -> None:
        """A restart keeps the power on: the operations and the cut to come go on being counted."""
        model = self.board.core.new("struct flash_model *")
        model[0] = self.board.chip.model[0]
        assert self.boot() == self.new
        model.running = self.board.running
        self.board.chip.model[0] = model[0]


class SwapStory(Story):
    """A policy into the slot that is not flown."""

    def __init__(self, chip: Any, held: tuple[int, int]) -> None:
        super().__init__(chip, [confirmed(small_image(1, 0), 7), Held()])
        for slot, sequence in enumerate(held):
            if sequence:
                weights = (4.0, 0.5) if sequence == max(held) else (3.0, 0.5)
                self.board.slots.put(slot, like(self.board.slots.image, sequence, *weights))
        self.before = OLD_POLICY if any(held) else NO_POLICY

    @property
    def old(self) -> State:
        return State(small_image(1, 0), self.before)

    @property
    def new(self) -> State:
        return State(small_image(1, 0), NEW_POLICY)

    def act(self, started: Started) -> bool:
        slots = self.board.slots
        if started.weights != NEW_POLICY:
            self.refusal = slots.update(pack(like(slots.image, slots.next_sequence, 9, 0.25)))
            if self.refusal != Refusal.NONE:
                return False
            self.decided = self.board.chip.operations
        return True


class RevertStory(Story):
    """From a policy back to the one before."""

    def __init__(self, chip: Any) -> None:
        super().__init__(chip, [confirmed(small_image(1, 0), 7), Held()])
        self.board.slots.put(SLOT_B, like(self.board.slots.image, 5, 4, 0.5))
        self.board.slots.put(SLOT_A, like(self.board.slots.image, 4, 9, 0.25, build=build_of(1)))

    @property
    def old(self) -> State:
        return State(small_image(1, 0), OLD_POLICY)

    @property
    def new(self) -> State:
        return State(small_image(1, 0), NEW_POLICY)

    def act(self, started: Started) -> bool:
        if started.weights == OLD_POLICY:
            self.refusal = int(self.board.lib.policy_slots_revert(self.board.slots.slots))
            if self.refusal != Refusal.NONE:
                return False
            self.decided = self.board.chip.operations
        return True


STORIES: dict[str, Callable[[Any], Story]] = {
    "image": lambda chip: FlashStory(chip, running=0, installed=False),
    "image-kept-policy": lambda chip: FlashStory(chip, running=0, installed=False, keep=True),
    "image-into-bank-a": lambda chip: FlashStory(chip, running=1, installed=False, slot=SLOT_B),
    "image-after-the-rom": lambda chip: FlashStory(chip, running=0, installed=True),
    "swap-into-empty-slots": lambda chip: SwapStory(chip, (0, 0)),
    "swap": lambda chip: SwapStory(chip, (3, 4)),
    "swap-into-slot-a": lambda chip: SwapStory(chip, (4, 5)),
    "revert": RevertStory,
}


@pytest.fixture(params=STORIES)
def story(chip: MakeChip, request: pytest.FixtureRequest) -> Story:
    """Each of them."""
    made = chip()
    made.core.lib.scripted_action = [0.0] * 4
    return STORIES[request.param](made)


def length(story: Story, content: bytes) -> int:
    """Operations of the story that begins with that flash, when power stays."""
    story.board.chip.content = content
    assert story.tell()
    operations = int(story.board.chip.operations)
    assert story.boot() == story.new
    story.board.chip.content = content
    return operations


def every_cut(operations: int) -> Iterator[Cut]:
    """Each operation with each kind."""
    return product(range(operations), KINDS)


def near_an_end(at: int, operations: int) -> bool:
    """Whether it is one of the operations that make marks, or that begin."""
    return at < 4 or at >= operations - 12


def some_cuts(operations: int, count: int, seed: int) -> list[Cut]:
    """All around the ends, where all the marks are made, and others in between; with one kind or all."""
    ends = [at for at in range(operations) if near_an_end(at, operations)]
    rng = np.random.default_rng(seed)
    between = rng.integers(0, operations, count)
    kinds = rng.integers(0, len(KINDS), count)
    return [*product(ends, KINDS), *((int(at), int(kind)) for at, kind in zip(between, kinds, strict=True))]


def by_turns(operations: int, number: int) -> Iterator[Cut]:
    """All around the ends with each kind, each operation in between with one, another for each `number`."""
    for at in range(operations):
        yield from product(
            [at], KINDS if near_an_end(at, operations) else [KINDS[(at + number) % len(KINDS)]]
        )


def strike(story: Story, content: bytes, cut: Cut, allowed: set[State]) -> State:
    """Power goes, and comes. Returns what runs then."""
    story.board.chip.content = content
    assert not story.tell(cut), cut
    assert story.board.chip.model.dark, "nobody but power refused"
    found = story.boot()
    assert found in allowed, cut
    return found


def finish(story: Story) -> None:
    """The sender tries again, and power stays."""
    assert story.tell(), f"refused as {story.refusal}"
    assert story.boot() == story.new


def test_the_old_or_the_new_runs_when_power_goes_once(story: Story) -> None:
    once(story, some_cuts(length(story, story.board.chip.content), 60, 1))


@pytest.mark.slow
def test_the_old_or_the_new_runs_when_power_goes_once_at_any_operation(story: Story) -> None:
    once(story, every_cut(length(story, story.board.chip.content)))


def once(story: Story, cuts: Iterable[Cut]) -> None:
    content = story.board.chip.content
    story.board.chip.content = content
    assert story.boot() == story.old
    assert story.tell()
    last = story.decided - 1  # the operation that decides
    story.board.chip.content = content
    for cut in cuts:
        found = strike(story, content, cut, {story.old, story.new})
        if cut[0] != last:
            assert found == (story.old if cut[0] < last else story.new), cut
        elif cut[1] in (BEFORE, AFTER):
            assert found == (story.new if cut[1] == AFTER else story.old), cut
        finish(story)


def twice(story: Story, cuts: Iterable[Cut], again: Callable[[int, int], Iterable[Cut]]) -> int:
    """A second cut in the recovery from each; returns how many were tried.

    What leaves the same flash as another first cut has the same recovery, and is tried once.
    """
    first_content, tried, met = story.board.chip.content, 0, set()
    for number, cut in enumerate(cuts):
        strike(story, first_content, cut, {story.old, story.new})
        torn = story.board.chip.content
        if hash(torn) in met:
            continue
        met.add(hash(torn))
        operations = length(story, torn)
        for second in again(operations, number):
            strike(story, torn, second, {story.old, story.new})
            finish(story)
            tried += 1
    return tried


def test_the_old_or_the_new_runs_when_power_goes_again_during_the_recovery(story: Story) -> None:
    operations = length(story, story.board.chip.content)
    chosen = np.random.default_rng(4).choice(len(some_cuts(operations, 40, 2)), 20)
    cuts = [some_cuts(operations, 40, 2)[int(index)] for index in chosen]

    def again(operations: int, seed: int) -> list[Cut]:
        some = some_cuts(operations, 40, seed) if operations else []
        rng = np.random.default_rng(seed)
        return [some[int(index)] for index in rng.choice(len(some), min(8, len(some)))] if some else []

    assert twice(story, cuts, again) > 0


@pytest.mark.slow
def test_the_old_or_the_new_runs_when_power_goes_again_at_any_operation_of_the_recovery(
    story: Story, record_property: Callable[[str, object], None]
) -> None:
    operations = length(story, story.board.chip.content)
    tried = twice(story, every_cut(operations), by_turns)
    record_property("second cuts", tried)
    print(f"{operations} operations, {tried} second cuts")
    assert tried > 0
