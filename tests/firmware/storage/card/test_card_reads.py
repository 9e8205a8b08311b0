"""sd_card.c reads blocks one after another: one command for all of them, and what ends such a sequence."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

import pytest

from neuroflight.sim.board.devices.sd_card import CardFault
from tests.firmware.storage.card.conftest import LOGS, MakeRecorder
from tests.firmware.storage.card.recorder import Recorder

BLOCK, BLOCKS = 512, 64
PENDING, DONE, FAILED = range(3)  # enum sd_outcome
READ_SINGLE, READ_MULTIPLE, STOP = 17, 18, 12


class Reader:
    """The card of a recorder alone; `commands` are those that it was sent."""

    def __init__(self, recorder: Recorder) -> None:
        self.recorder, self.lib = recorder, recorder.lib
        recorder.known()
        self.card = recorder.core.ffi.addressof(recorder.log, "card")
        self.commands: list[int] = []
        protocol = recorder.card._protocol
        heard = protocol.command

        def noted(frame: bytes, at: int) -> None:
            self.commands.append(frame[0] & 0x3F)
            heard(frame, at)

        protocol.command = noted  # type: ignore[method-assign]

    def run(self, until: int) -> None:
        while self.card.outcome == until:
            self.recorder.cycle += 20_000
            self.lib.sd_card_step(self.card)

    def block(self, number: int, *, on: bool = True) -> bytes | None:
        """A block of the card; None: it could not be read."""
        while not self.lib.sd_card_free(self.card):
            self.recorder.cycle += 20_000
            self.lib.sd_card_step(self.card)
        (self.lib.sd_card_read_on if on else self.lib.sd_card_read)(self.card, number)
        self.run(PENDING)
        if self.card.outcome != DONE:
            return None
        assert self.card.held == number
        return bytes(self.recorder.core.ffi.buffer(self.card.data, BLOCK))

    def image(self, number: int) -> bytes:
        return bytes(self.recorder.card.image.read(number))

    def idle(self, seconds: float) -> None:
        end = self.recorder.cycle + round(seconds * 216e6)
        while self.recorder.cycle < end:
            self.recorder.cycle += 200_000
            self.lib.sd_card_step(self.card)


@pytest.fixture
def reader(slot: MakeRecorder) -> Reader:
    return Reader(slot())


def test_one_command_reads_all_blocks_when_each_follows_the_one_before(reader: Reader) -> None:
    began = reader.recorder.cycle
    for number in range(BLOCKS):
        assert reader.block(number) == reader.image(number)
    assert [c for c in reader.commands if c in (READ_SINGLE, READ_MULTIPLE, STOP)] == [READ_MULTIPLE]
    rate = BLOCKS * BLOCK / ((reader.recorder.cycle - began) / 216e6)
    print(f"{rate / 1e3:.0f} KB/s")
    assert rate > 600e3


def test_another_block_is_read_wherever_the_sequence_stands(reader: Reader) -> None:
    blocks = int(reader.card.blocks)
    rng = random.Random(3)
    for number in [0, 1, 5, 6, 7, 6, blocks - 2, blocks - 1, 0, *(rng.randrange(blocks) for _ in range(30))]:
        assert reader.block(number) == reader.image(number)
        assert reader.block(number, on=False) == reader.image(number)


def test_the_last_block_ends_a_sequence_before_it(reader: Reader) -> None:
    """A card that has no block left to prepare may say so to a command that has nothing to do with it."""
    blocks = int(reader.card.blocks)
    for number in range(blocks - 4, blocks):
        assert reader.block(number) == reader.image(number)
    read = [c for c in reader.commands if c in (READ_SINGLE, READ_MULTIPLE, STOP)]
    assert read == [READ_MULTIPLE, STOP, READ_SINGLE]


@pytest.mark.parametrize("rate", [0.02, 0.1])
def test_blocks_are_right_when_bits_turn_over_on_the_line(reader: Reader, rate: float) -> None:
    reader.recorder.card.schedule(CardFault.ERRORS, rate, cycle=reader.recorder.cycle)
    read = [reader.block(number) for number in range(BLOCKS)]
    for number, data in enumerate(read):
        assert data in (None, reader.image(number)), number
    assert read.count(None) <= BLOCKS // 8


def test_a_card_that_is_pulled_amid_a_sequence_is_missed_and_found_again(reader: Reader) -> None:
    assert reader.block(0) and reader.block(1)
    reader.recorder.card.schedule(CardFault.REMOVED, cycle=reader.recorder.cycle)
    assert reader.block(2) is None and reader.card.blocks == 0
    reader.recorder.card.schedule(CardFault.INSERTED, cycle=reader.recorder.cycle)
    reader.idle(2.0)
    assert reader.block(2) == reader.image(2)


def test_a_card_at_rest_is_looked_at_when_a_sequence_was_left_open(reader: Reader) -> None:
    assert reader.block(0)
    assert reader.card.reading
    reader.idle(1.2)
    assert not reader.card.reading and 13 in reader.commands
    assert reader.block(1) == reader.image(1)


def test_a_log_is_written_when_one_was_being_read(slot: MakeRecorder, empty_card: Path) -> None:
    recorder = slot()
    recorder.ready()
    data: Any = random.Random(1).randbytes(20_000) + b"\n\0"
    for number in range(2):
        assert recorder.begin() == 0
        recorder.record(data)
        assert recorder.end() == 0
        recorder.known()
        assert recorder.entry(number) == (LOGS[number], len(data))
        assert recorder.read(number) == data
        assert recorder.log.card.reading
