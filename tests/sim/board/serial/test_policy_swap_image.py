"""The real image's policy swapped over its UART at 921600 baud, and power that goes at any moment of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from neuroflight.cli.board.policy import candidate_of
from neuroflight.flash.board.info import read_info
from neuroflight.flash.link import requests
from neuroflight.flash.link.messages import PolicySource
from neuroflight.flash.policy import revert as reverts
from neuroflight.flash.policy import swap as swaps
from neuroflight.flash.policy.candidate import Candidate
from neuroflight.flash.policy.slots import read_policies
from neuroflight.sim.board.debug.snapshot import Snapshot
from neuroflight.sim.board.peripherals.flash import Cut
from neuroflight.sim.board.serial.idle_board import IdleBoard, configured
from neuroflight.toolchain.contract import Msp
from tests.flash.image.emulated import BAUD
from tests.flash.policy.policies import another_policy
from tests.sim.board.serial.power import SHOWN, PowerBench

# The ordinary run cuts a slot's erase and one of its words in test_image_flash_power.py, and every operation
# of a slot in tests/firmware/storage/test_policy_slots.py.
pytestmark = pytest.mark.slow

SWAP_S = 5.0  # what a swap may take of emulated time, its restart included
FINAL = -1  # of the words of a blob: its first, which is programmed last and makes it valid


def candidates(shipped: Path, folder: Path) -> tuple[Candidate, Candidate]:
    return (
        candidate_of(another_policy(shipped, folder / "first.onnx", seed=1)),
        candidate_of(another_policy(shipped, folder / "second.onnx", seed=2)),
    )


class Bench(PowerBench):
    """An idle board at the end of a line, and two policies for it."""

    def __init__(self, flash: bytes, elf: Path, policies: tuple[Candidate, Candidate]) -> None:
        super().__init__(IdleBoard(flash, elf=elf))
        self.first, self.second = policies
        self.idle.boot()

    def swap(self, candidate: Candidate, progress: swaps.Progress = lambda done, total: None) -> PolicySource:
        """All of it, as the command does."""
        line = self.wired.for_swaps()
        client, place = swaps.write(self.wired.client(), candidate, line, progress)
        swaps.start(client, candidate, place, line).close()
        return place.source

    def cut_swap(self, candidate: Candidate, part: float, cut: Cut) -> None:
        """Power goes in a swap: at its erase, where `part` is 0, or at so much of its words."""
        words = candidate.size // 4
        self.cut_at(words if part == FINAL else round(part * words), cut)
        reply = self.frame(Msp.POLICY_SLOT_BEGIN, requests.slot_begin(candidate.size))
        if reply is not None:
            blob = candidate.blob(requests.slot_begun(reply))
            for offset in range(0, len(blob), requests.SLOT_BYTES_MAX):
                piece = blob[offset : offset + requests.SLOT_BYTES_MAX]
                if self.frame(Msp.POLICY_SLOT_WRITE, requests.slot_write(offset, piece)) is None:
                    break
            else:
                assert self.frame(Msp.POLICY_SLOT_END) is None, "power did not go"
        self.idle.boot()

    def cut_revert(self, cut: Cut) -> None:
        self.cut_at(0, cut)
        assert self.frame(Msp.POLICY_SLOT_REVERT) is None
        self.idle.boot()

    def flown(self) -> str:
        """The SHA-256 of the policy that is flown, which passed its self-test."""
        with self.wired.client() as client:
            info = read_info(client)
        assert info.policy is not None and info.policy.good
        assert not SHOWN & set(info.arming_reasons)
        return info.policy.sha256

    def revert(self) -> None:
        client = self.wired.client()
        flown, before = reverts.plan(read_policies(client), other_aircraft=False)
        reverts.revert(client)
        reverts.start(client, flown, before, self.wired.for_swaps()).close()


@dataclass(frozen=True)
class Kept:
    """A bench, and its states on the way to `first` in slot B; slot A has what was installed."""

    bench: Bench
    own: str  # SHA-256 of the installed policy
    empty: Snapshot
    written: Snapshot  # all but the end
    swapped: Snapshot
    swap_s: float  # of emulated time
    cut: dict[tuple[float, Cut], Snapshot] = field(default_factory=dict)  # booted after a swap cut so

    def after(self, part: float, cut: Cut) -> Bench:
        """From `swapped`, with the swap to `second` cut there."""
        if (part, cut) not in self.cut:
            bench = self.at(self.swapped)
            bench.cut_swap(bench.second, part, cut)
            self.cut[part, cut] = bench.take()
        return self.at(self.cut[part, cut])

    def at(self, snapshot: Snapshot) -> Bench:
        self.bench.restore(snapshot)
        return self.bench


@pytest.fixture(scope="module")
def kept(board_image: Path, shipped_policy: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Kept]:
    flash = configured(board_image.with_suffix(".bin").read_bytes(), board_image, {"msp_baud": BAUD})
    bench = Bench(flash, board_image, candidates(shipped_policy, tmp_path_factory.mktemp("policies")))
    written = []

    def progress(done: int, total: int) -> None:
        if done == total:
            written.append(bench.take())

    empty, began = bench.take(), bench.wired.seconds
    assert bench.swap(bench.first, progress) is PolicySource.SLOT_B
    swap_s = bench.wired.seconds - began
    own = candidate_of(shipped_policy).sha256
    yield Kept(bench, own, empty, written[0], bench.take(), swap_s)
    bench.idle.close()


def check_seconds(bench: Bench, slot: PolicySource, took: float) -> None:
    print(f"into {slot.name}: {took:.2f} s of emulated time")
    assert took < SWAP_S
    planned = swaps.seconds(bench.first.size, slot, BAUD, start=True)
    assert planned == pytest.approx(took, rel=0.4), "the plan tells about as much"


def test_a_swap_takes_less_than_five_seconds_when_the_line_is_fast(kept: Kept) -> None:
    bench = kept.at(kept.swapped)
    assert bench.flown() == bench.first.sha256
    check_seconds(bench, PolicySource.SLOT_B, kept.swap_s)


def test_the_smaller_sector_takes_less_than_five_seconds_when_it_is_its_turn(kept: Kept) -> None:
    bench = kept.at(kept.swapped)
    began = bench.wired.seconds
    assert bench.swap(bench.second) is PolicySource.SLOT_A
    check_seconds(bench, PolicySource.SLOT_A, bench.wired.seconds - began)
    assert bench.flown() == bench.second.sha256
    bench.revert()
    assert bench.flown() == bench.first.sha256


def test_the_old_policy_is_flown_when_power_goes_while_the_slot_is_erased(kept: Kept) -> None:
    bench = kept.at(kept.empty)
    bench.cut_swap(bench.first, 0, Cut.NOISE)
    assert bench.flown() == kept.own


@pytest.mark.parametrize("cut", Cut)
def test_an_old_or_the_new_policy_is_flown_when_power_goes_at_the_word_that_makes_it_valid(
    kept: Kept, cut: Cut
) -> None:
    bench = kept.at(kept.written)
    bench.cut_at(0, cut)
    assert bench.frame(Msp.POLICY_SLOT_END) is None
    bench.idle.boot()
    expected = {Cut.AFTER: {bench.first.sha256}, Cut.BEFORE: {kept.own}, Cut.NOISE: {kept.own}}
    assert bench.flown() in expected.get(cut, {bench.first.sha256, kept.own})


# --- And again in the recovery --------------------------------------------------------------------
FIRST = [
    *((0, cut) for cut in (Cut.AFTER, Cut.BETWEEN, Cut.NOISE)),
    *((part, cut) for part in (0.1, 0.95) for cut in (Cut.WORDS, Cut.NOISE)),
    *((FINAL, cut) for cut in Cut),
]
SECOND = [(0, Cut.NOISE), (0.6, Cut.BETWEEN), (FINAL, Cut.BETWEEN), (FINAL, Cut.NOISE)]
PAIRS = [(first, second) for first in FIRST for second in SECOND]


@pytest.mark.parametrize(("once", "again"), PAIRS)
def test_an_old_or_the_new_policy_is_flown_when_power_goes_in_a_swap_and_in_its_recovery(
    kept: Kept, once: tuple[float, Cut], again: tuple[float, Cut]
) -> None:
    """A sample: tests/firmware/storage cuts at every operation."""
    bench = kept.after(*once)
    if old_or_new(bench, once[0]) == bench.second.sha256:
        return  # it was whole: nothing is left to recover
    bench.cut_swap(bench.second, *again)
    if old_or_new(bench, again[0]) != bench.second.sha256:
        bench.swap(bench.second)
    assert bench.flown() == bench.second.sha256


def old_or_new(bench: Bench, part: float) -> str:
    """What is flown after a swap that was cut there: the new one only where all of it was in flash."""
    flown = bench.flown()
    assert flown in {bench.first.sha256} | ({bench.second.sha256} if part == FINAL else set())
    return flown


@pytest.mark.parametrize("cut", Cut)
def test_one_of_two_policies_is_flown_when_power_goes_in_a_revert_and_in_its_recovery(
    kept: Kept, cut: Cut
) -> None:
    bench = kept.at(kept.swapped)
    for _ in range(2):
        bench.cut_revert(cut)
        flown = bench.flown()
        assert flown in (bench.first.sha256, kept.own)
        if flown == kept.own:
            break
    if bench.flown() == bench.first.sha256:
        bench.revert()
    assert bench.flown() == kept.own


def test_the_command_goes_on_by_itself_when_power_goes_in_the_middle(kept: Kept) -> None:
    bench = kept.at(kept.swapped)
    bench.cut_at(2000, Cut.NOISE)
    resets = len(bench.engine.resets)
    assert bench.swap(bench.second) is PolicySource.SLOT_A
    assert bench.engine.resets[resets:] == ["power", "software"]
    assert bench.flown() == bench.second.sha256
