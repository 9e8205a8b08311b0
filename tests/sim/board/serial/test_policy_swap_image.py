"""The real image's policy swapped over its UART at 921600 baud, and power that goes at any moment of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from neuroflight.cli.board.policy import candidate_of
from neuroflight.flash.board.info import read_info
from neuroflight.flash.link import requests
from neuroflight.flash.link.client import Client
from neuroflight.flash.link.messages import PolicySource
from neuroflight.flash.link.msp import Decoder, Message, encode, request
from neuroflight.flash.policy import revert as reverts
from neuroflight.flash.policy import swap as swaps
from neuroflight.flash.policy.candidate import Candidate
from neuroflight.flash.policy.slots import read_policies
from neuroflight.sim.board.core.context import TIME_HZ
from neuroflight.sim.board.debug.snapshot import Snapshot, restore_snapshot, take_snapshot
from neuroflight.sim.board.peripherals.flash import Cut
from neuroflight.sim.board.peripherals.usart import Format
from neuroflight.sim.board.serial.bridge import LineTransport, UartLine
from neuroflight.sim.board.serial.idle_board import IdleBoard, configured
from neuroflight.toolchain.contract import Msp
from tests.flash.policies import another_policy

BAUD = 921_600
SWAP_S = 5.0  # what a swap may take of emulated time, its restart included
EXCHANGE_S = 3.0  # a request's: more than an erase and a restart
STEP = TIME_HZ // 10_000
FINAL = -1  # of the words of a blob: its first, which is programmed last and makes it valid
SHOWN = frozenset({"POLICY_BAD", "FAULT"})


def candidates(shipped: Path, folder: Path) -> tuple[Candidate, Candidate]:
    return (
        candidate_of(another_policy(shipped, folder / "first.onnx", seed=1)),
        candidate_of(another_policy(shipped, folder / "second.onnx", seed=2)),
    )


class Bench:
    """An idle board at the end of a line, and two policies for it."""

    def __init__(self, flash: bytes, elf: Path, policies: tuple[Candidate, Candidate]) -> None:
        self.idle = IdleBoard(flash, elf=elf)
        self.first, self.second = policies
        self.idle.boot()

    def transport(self) -> LineTransport:
        return LineTransport(UartLine(self.idle.board, format=Format(BAUD)), self.idle.run_to)

    def client(self) -> Client:
        line = self.transport()
        return Client(line, line.clock)

    @property
    def seconds(self) -> float:
        return self.idle.board.cycle / TIME_HZ

    def line(self) -> swaps.Board:
        return swaps.Board(
            self.transport,
            lambda: self.seconds,
            lambda seconds: self.idle.run_to(self.idle.board.cycle + round(seconds * TIME_HZ)),
        )

    def swap(self, candidate: Candidate, progress: swaps.Progress = lambda done, total: None) -> PolicySource:
        """All of it, as the command does."""
        line = self.line()
        client, place = swaps.write(self.client(), candidate, line, progress)
        swaps.start(client, candidate, place, line).close()
        return place.source

    # --- With power that goes -------------------------------------------------------------------
    def frame(self, command: Msp, payload: bytes = b"") -> bytes | None:
        """The reply to a request; None: power went."""
        resets, line, decoder = len(self.idle.board.engine.resets), UartLine(self.idle.board), Decoder()
        line.format = Format(BAUD)
        line.send(encode(request(command, payload)))
        end = self.idle.board.cycle + round(EXCHANGE_S * TIME_HZ)
        while self.idle.board.cycle < end:
            self.idle.run_to(self.idle.board.cycle + STEP)
            if len(self.idle.board.engine.resets) > resets:
                assert self.idle.board.engine.resets[resets:] == ["power"]
                return None
            for event in decoder.feed(line.take()):
                assert isinstance(event, Message)
                assert event.direction.name == "REPLY", event
                return event.payload
        raise AssertionError(f"no answer to {command.name}")

    def cut_swap(self, candidate: Candidate, part: float, cut: Cut) -> None:
        """Power goes in a swap: at its erase, where `part` is 0, or at so much of its words."""
        flash = self.idle.board.hardware.flash
        words = candidate.size // 4
        at = words if part == FINAL else round(part * words)
        flash.cut_at, flash.cut = flash.operations + at, cut
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
        flash = self.idle.board.hardware.flash
        flash.cut_at, flash.cut = flash.operations, cut
        assert self.frame(Msp.POLICY_SLOT_REVERT) is None
        self.idle.boot()

    def flown(self) -> str:
        """The SHA-256 of the policy that is flown, which passed its self-test."""
        with self.client() as client:
            info = read_info(client)
        assert info.policy is not None and info.policy.good
        assert not SHOWN & set(info.arming_reasons)
        return info.policy.sha256

    def revert(self) -> None:
        client = self.client()
        flown, before = reverts.plan(read_policies(client), other_aircraft=False)
        reverts.revert(client)
        reverts.start(client, flown, before, self.line()).close()


@dataclass(frozen=True)
class Kept:
    """A bench, and its states on the way to `first` in slot B; slot A has what was installed."""

    bench: Bench
    own: str  # SHA-256 of the installed policy
    empty: Snapshot
    written: Snapshot  # all but the end
    swapped: Snapshot
    swap_s: float  # of emulated time
    cut: dict[tuple[float, Cut], Snapshot] = field(
        default_factory=dict
    )  # booted after a swap that was cut so

    def after(self, part: float, cut: Cut) -> Bench:
        """From `swapped`, with the swap to `second` cut there."""
        if (part, cut) not in self.cut:
            bench = self.at(self.swapped)
            bench.cut_swap(bench.second, part, cut)
            self.cut[part, cut] = take_snapshot(bench.idle.board.engine)
        return self.at(self.cut[part, cut])

    def at(self, snapshot: Snapshot) -> Bench:
        restore_snapshot(self.bench.idle.board.engine, snapshot)
        return self.bench


@pytest.fixture(scope="module")
def kept(board_image: Path, shipped_policy: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Kept]:
    flash = configured(board_image.with_suffix(".bin").read_bytes(), board_image, {"msp_baud": BAUD})
    bench = Bench(flash, board_image, candidates(shipped_policy, tmp_path_factory.mktemp("policies")))
    engine, written = bench.idle.board.engine, []

    def progress(done: int, total: int) -> None:
        if done == total:
            written.append(take_snapshot(engine))

    empty, began = take_snapshot(engine), bench.seconds
    assert bench.swap(bench.first, progress) is PolicySource.SLOT_B
    swap_s = bench.seconds - began
    own = candidate_of(shipped_policy).sha256
    yield Kept(bench, own, empty, written[0], take_snapshot(engine), swap_s)
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


@pytest.mark.slow
def test_the_smaller_sector_takes_less_than_five_seconds_when_it_is_its_turn(kept: Kept) -> None:
    bench = kept.at(kept.swapped)
    began = bench.seconds
    assert bench.swap(bench.second) is PolicySource.SLOT_A
    check_seconds(bench, PolicySource.SLOT_A, bench.seconds - began)
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
    flash = bench.idle.board.hardware.flash
    flash.cut_at, flash.cut = flash.operations, cut
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


@pytest.mark.slow
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


@pytest.mark.parametrize(
    "cut", [pytest.param(cut, marks=[] if cut is Cut.NOISE else pytest.mark.slow) for cut in Cut]
)
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


@pytest.mark.slow
def test_the_command_goes_on_by_itself_when_power_goes_in_the_middle(kept: Kept) -> None:
    bench = kept.at(kept.swapped)
    flash = bench.idle.board.hardware.flash
    flash.cut_at, flash.cut = flash.operations + 2000, Cut.NOISE
    resets = len(bench.idle.board.engine.resets)
    assert bench.swap(bench.second) is PolicySource.SLOT_A
    assert bench.idle.board.engine.resets[resets:] == ["power", "software"]
    assert bench.flown() == bench.second.sha256
