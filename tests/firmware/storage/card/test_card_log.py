"""card_log.c on the emulated card: a flight a file, read back, erased; slow, full, worn and noisy cards."""

from __future__ import annotations

import binascii
import random
from pathlib import Path
from typing import Any

import pytest

from neuroflight.sim.board.devices.sd_card import CardFault, CardTiming, registers
from neuroflight.sim.board.devices.sd_card.registers import crc7
from neuroflight.toolchain.contract import LogError, LogState
from tests.firmware.conftest import Core
from tests.firmware.storage.card.conftest import FILE_BYTES, LOGS, MakeRecorder
from tests.firmware.storage.card.images import check, content, make_image, places
from tests.firmware.storage.card.recorder import CYCLES_A_SECOND, DONE, FAILED, Recorder

RING = 16384
BLOCK = 512
SD_PENDING, SD_DONE = 0, 1  # enum sd_outcome
SD_NO_BLOCK = 0xFFFFFFFF


def some(count: int, seed: int = 1) -> bytes:
    """A log's bytes, none of whose sectors is blank; it ends with a 0, as logs do."""
    return random.Random(seed).randbytes(count - 2) + b"\n\0"


def flight(recorder: Recorder, data: bytes, rate: float = 125_000.0) -> None:
    assert recorder.begin() == DONE
    recorder.record(data, rate)
    assert recorder.end() == DONE


def test_checksums_equal_those_of_the_specification(scripted: Core) -> None:
    for count in (2, 5, 16, 512):
        data = some(count)
        assert scripted.lib.sd_crc7(data, count) == crc7(data)
        assert scripted.lib.sd_crc16(data, count) == binascii.crc_hqx(data, 0)


@pytest.mark.parametrize("count", [2, 511, 512, 513, 100_000])
def test_a_log_is_read_back_when_it_was_written(slot: MakeRecorder, empty_card: Path, count: int) -> None:
    recorder, data = slot(), some(count)
    recorder.known()
    assert recorder.status.empty == 2
    flight(recorder, data)
    assert recorder.state == LogState.READY
    recorder.known()
    assert (recorder.status.logs, recorder.status.empty) == (1, 1)
    assert (recorder.status.capacity_kb, recorder.status.free_kb) == (2048, 1024)
    assert recorder.entry(0) == (LOGS[0], count)
    assert recorder.read(0) == data
    assert recorder.entry(1) is None
    recorder.boot()
    recorder.known()
    assert recorder.entry(0) == (LOGS[0], count), "found again by what is in the file"
    recorder.close()
    path = recorder.card.image.path
    padded = data + bytes(-count % BLOCK)
    assert content(path, LOGS[0]) == padded + bytes(FILE_BYTES - len(padded))
    assert content(path, LOGS[1]) == bytes(FILE_BYTES)
    assert recorder.changed <= places(path, LOGS)
    check(path)


def test_no_step_starts_more_than_one_transfer(slot: MakeRecorder) -> None:
    recorder = slot()
    recorder.ready()
    flight(recorder, some(50_000))
    recorder.known()
    recorder.read(0)
    assert recorder.erase() == DONE
    assert recorder.most == 1


def test_each_flight_takes_the_next_file_until_the_card_is_full(slot: MakeRecorder) -> None:
    recorder = slot()
    recorder.ready()
    for seed in (1, 2):
        flight(recorder, some(5000, seed))
    assert recorder.state == LogState.FULL
    assert recorder.begin() == FAILED
    recorder.known()
    assert [recorder.read(i) for i in (0, 1)] == [some(5000, 1), some(5000, 2)]


def test_bytes_are_refused_when_the_file_is_full(slot: MakeRecorder, tmp_path: Path) -> None:
    recorder = slot(make_image(tmp_path / "small.img", {LOGS[0]: 20 * BLOCK + 100}))
    recorder.ready()
    assert recorder.begin() == DONE
    data, taken = some(30 * BLOCK), 0
    for _ in range(500):
        taken += recorder.write(data[taken : taken + 1000])
        recorder.step()
    assert taken == 20 * BLOCK, "whole sectors of the file"
    assert recorder.state == LogState.FULL
    assert recorder.end() == DONE
    recorder.known()
    assert recorder.read(0) == data[:taken]
    recorder.close()
    check(tmp_path / "small.img")


@pytest.mark.parametrize("erased", [0x00, 0xFF])
def test_all_files_are_empty_when_they_were_erased(slot: MakeRecorder, erased: int) -> None:
    recorder = slot(erased=erased)
    recorder.ready()
    for seed in (1, 2):
        flight(recorder, some(300_000, seed))
    assert recorder.erase() == DONE
    assert recorder.status.empty == 2
    assert recorder.status.logs == 0
    flight(recorder, some(700, 3))
    recorder.boot()
    recorder.known()
    assert recorder.read(0) == some(700, 3)
    recorder.close()
    path = recorder.card.image.path
    assert content(path, LOGS[1]) == bytes([erased]) * FILE_BYTES
    assert recorder.changed <= places(path, LOGS)
    check(path)


def test_a_log_is_on_the_card_within_a_second_when_little_is_written(slot: MakeRecorder) -> None:
    recorder, data = slot(), some(3000)
    recorder.ready()
    assert recorder.begin() == DONE
    history = recorder.record(data, rate=600.0)
    now = recorder.seconds
    recorder.card.power_off(recorder.cycle)
    recorder.close()
    sure = max(taken for at, taken in history if at <= now - 1.0)
    assert sure > 1500
    assert content(recorder.card.image.path, LOGS[0])[:sure] == data[:sure]


def test_nothing_is_lost_when_the_card_tidies_up(slot: MakeRecorder) -> None:
    """Pauses of 120 ms at the rate of a full log."""
    recorder, data = slot(timing=CardTiming(pause=(0.12, 0.12), pause_share=1 / 200)), some(400_000)
    recorder.ready()
    assert recorder.begin() == DONE
    recorder.record(data)
    assert recorder.end() == DONE
    assert recorder.seconds < 0.4 + 400_000 / 125_000 + 0.5, "the ring held what came meanwhile"
    recorder.known()
    assert recorder.read(0) == data


def test_bytes_are_refused_and_none_is_lost_when_the_card_stalls(slot: MakeRecorder) -> None:
    recorder, data = slot(), some(200_000)
    recorder.ready()
    recorder.card.schedule(CardFault.STALL, 0.5, write=100)
    assert recorder.begin() == DONE
    taken, refused, step = 0, 0, 32  # 128 KB/s
    while taken < len(data):
        got = recorder.write(data[taken : taken + step])
        taken += got
        assert recorder.state == LogState.LOGGING
        refused += got < step and taken < len(data)
        recorder.step()
    assert refused > 1000, "for some 370 ms of 500, which the ring does not hold"
    assert recorder.end() == DONE
    assert recorder.error == LogError.NONE
    recorder.known()
    assert recorder.read(0) == data
    assert recorder.most == 1


def test_the_log_is_given_up_when_a_write_takes_longer_than_a_second(slot: MakeRecorder) -> None:
    recorder = slot()
    recorder.ready()
    recorder.card.schedule(CardFault.STALL, 1.5, write=20)
    assert recorder.begin() == DONE
    assert recorder.write(some(RING)) == RING
    recorder.until(lambda: recorder.error == LogError.WRITE)
    assert recorder.write(b"more") == 0
    assert recorder.end() == FAILED
    recorder.ready()
    flight(recorder, some(1000))


def test_the_next_file_is_taken_when_the_first_ones_blocks_are_worn(slot: MakeRecorder) -> None:
    recorder = slot()
    recorder.ready()
    recorder.card.schedule(CardFault.WORN_FROM, min(places(recorder.card.image.path, LOGS[1:])), cycle=0)
    data = some(2000)
    flight(recorder, data)
    assert recorder.begin() == DONE
    assert recorder.write(data) == len(data)
    recorder.until(lambda: recorder.state == LogState.FAULT)
    assert recorder.error == LogError.WRITE
    assert recorder.write(data) == 0
    assert recorder.end() == FAILED
    assert recorder.begin() == FAILED, "it was the last one"
    assert recorder.error == LogError.WRITE
    assert recorder.read(0) == data


def test_a_log_is_whole_when_bits_turn_over_on_the_line(slot: MakeRecorder) -> None:
    recorder, data = slot(seed=5), some(200_000)
    recorder.ready()
    recorder.card.schedule(CardFault.ERRORS, 0.02, cycle=recorder.cycle)
    flight(recorder, data)
    recorder.known()
    assert recorder.read(0) == data
    assert recorder.refused > 3, "these were sent again"


def test_a_card_with_bad_lines_is_found_and_none_is_believed(slot: MakeRecorder) -> None:
    for seed in range(10):
        recorder = slot(seed=seed)
        recorder.card.schedule(CardFault.ERRORS, 0.1, cycle=0)
        recorder.until(lambda r=recorder: r.state == LogState.READY, 30.0)  # type: ignore[misc]
        recorder.known()
        assert (recorder.status.empty, recorder.status.capacity_kb) == (2, 2048)
        recorder.close()


def test_a_slow_card_is_only_slow(slot: MakeRecorder) -> None:
    recorder, data = slot(), some(20_000)
    recorder.ready()
    recorder.card.schedule(CardFault.SLOW, 50.0, cycle=recorder.cycle)
    flight(recorder, data)
    recorder.known()
    assert recorder.read(0) == data


def test_a_card_comes_up_when_the_board_is_reset_within_a_block(slot: MakeRecorder) -> None:
    """The reset cuts a transfer off at any byte: the card waits for the rest of the block."""
    for seed in range(20):
        recorder = slot()
        recorder.ready()
        assert recorder.begin() == DONE
        assert recorder.write(some(10_000)) == 10_000
        recorder.step(20 + seed)
        start, chance = recorder.cycle, random.Random(seed)
        recorder.card.exchange(  # a command or a part of a block, whatever the card waits for
            b"\xff\xfc" + chance.randbytes(chance.randrange(1, 500)),
            start, 128, 13.5e6, 3, selected=True, transaction=recorder._transaction,
        )  # fmt: skip
        recorder.boot()
        recorder.cycle = start + CYCLES_A_SECOND // 5
        recorder.until(lambda r=recorder: r.state == LogState.READY, 3.0)  # type: ignore[misc]
        recorder.close()


def test_reading_ends_where_the_log_does_when_more_is_asked_for(slot: MakeRecorder) -> None:
    recorder, data = slot(), some(1000)
    recorder.ready()
    flight(recorder, data)
    recorder.known()
    assert recorder.read_at(0, 990) == data[990:]
    assert recorder.read_at(0, 1000) == b""
    assert recorder.read_at(0, 0xFFFFFFFF) == b""
    assert recorder.read_at(0, 500) == data[500:512], "up to the sector's end"


def job(recorder: Recorder, card: Any) -> None:
    """Until the card has done what it was asked."""
    recorder.until(lambda: card.outcome != SD_PENDING)
    assert card.outcome == SD_DONE


def test_a_block_that_was_read_is_not_taken_for_the_cards_when_it_was_written_since(
    slot: MakeRecorder, empty_card: Path
) -> None:
    recorder = slot()
    recorder.known()
    lib, card = recorder.lib, recorder.core.ffi.addressof(recorder.log, "card")
    places_of_logs = sorted(places(empty_card, LOGS))
    block, other = places_of_logs[0], places_of_logs[1]
    written = recorder.core.new("uint8_t[512]", some(512))
    recorder.until(lambda: lib.sd_card_free(card))
    lib.sd_card_read(card, block)
    job(recorder, card)
    assert card.held == block and bytes(card.data[0:512]) == bytes(512)
    for target, held in ((other, block), (block, SD_NO_BLOCK)):
        lib.sd_card_write(card, target, written)
        job(recorder, card)
        assert card.held == held
        lib.sd_card_finish(card)
        job(recorder, card)
    lib.sd_card_read(card, block)
    job(recorder, card)
    assert card.held == block and bytes(card.data[0:512]) == some(512)


@pytest.mark.parametrize(
    ("blocks", "known"),
    [(0x3FFFFF << 10, 0x3FFFFF << 10), (0x400000 << 10, SD_NO_BLOCK)],
    ids=["below", "2TiB"],
)
def test_a_card_of_2_tib_has_as_many_blocks_as_a_word_can_say(
    slot: MakeRecorder, monkeypatch: pytest.MonkeyPatch, blocks: int, known: int
) -> None:
    told = registers.csd(blocks)
    monkeypatch.setattr(registers, "csd", lambda _: told)
    recorder = slot()
    recorder.until(lambda: recorder.log.card.blocks != 0)
    assert recorder.log.card.blocks == known
