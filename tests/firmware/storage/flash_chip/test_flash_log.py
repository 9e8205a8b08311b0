"""flash_log.c on the emulated chips: a flight a log, read back, erased; full, foreign and worn chips."""

from __future__ import annotations

import dataclasses
import random
import struct
import zlib

import pytest

from neuroflight.sim.board.devices.flash_chip import KINDS
from neuroflight.toolchain.contract import LogError, LogState
from tests.firmware.storage.flash_chip.conftest import MakeRecorder, Recorder
from tests.firmware.storage.flash_chip.reading import BODY, HEAD
from tests.firmware.storage.recorder import CYCLES_A_SECOND, DONE, FAILED
from tests.sampling import sampled

PAYLOAD = {False: 250, True: 2042}
BLOCK = {False: 255 * 250, True: 63 * 2042}


def some(count: int, seed: int = 1) -> bytes:
    """A log's bytes."""
    return random.Random(seed).randbytes(count - 2) + b"\n\0"


def flight(recorder: Recorder, data: bytes, rate: float = 125_000.0) -> None:
    assert recorder.begin() == DONE
    recorder.record(data, rate)
    assert recorder.end() == DONE


@pytest.mark.parametrize("kind", sampled(KINDS, "W25Q256", "M25P16", "W25M512", "W25N01G"))
def test_a_log_is_read_back_when_it_was_written(board: MakeRecorder, kind: str) -> None:
    recorder, data = board(kind), some(BLOCK[KINDS[kind].nand] + 3000)
    recorder.ready()
    assert recorder.status.logs == 0
    nand = recorder.chip.kind.nand
    assert recorder.status.empty == recorder.chip.kind.blocks - 1
    assert recorder.status.capacity_kb == (recorder.chip.kind.blocks - 1) * (BLOCK[nand] // 16) // 64
    flight(recorder, data)
    assert recorder.state == LogState.READY
    assert recorder.entry(0) == ("LOG00001.BBL", len(data))
    assert recorder.read(0) == data
    assert recorder.entry(1) is None
    recorder.boot()
    recorder.ready()
    assert recorder.entry(0) == ("LOG00001.BBL", len(data)), "found again by what is on the chip"
    assert recorder.read(0) == data
    flight(recorder, some(3000, 2))
    assert recorder.read(1) == some(3000, 2)
    assert recorder.read(0) == data


@pytest.mark.parametrize("kind", sampled(["W25Q16", "W25N01G"], "W25Q16"))
@pytest.mark.parametrize("extra", [-1, 0, 1])
@pytest.mark.parametrize("of", ["page", "block"])
def test_a_log_of_whole_pages_and_blocks_ends_where_it_ended(
    board: MakeRecorder, kind: str, of: str, extra: int
) -> None:
    recorder = board(kind)
    recorder.ready()
    size = {"page": PAYLOAD, "block": BLOCK}[of][recorder.chip.kind.nand]
    data = some(size + extra)
    flight(recorder, data, 500_000.0)
    recorder.boot()
    recorder.ready()
    assert recorder.entry(0) == ("LOG00001.BBL", len(data))
    assert recorder.read(0) == data


def few_blocks(board: MakeRecorder, kind: str, good: int = 16) -> Recorder:
    """A chip with so many usable blocks: NAND's others are marked as bad."""
    recorder = board(kind)
    if recorder.chip.kind.nand:
        for block in range(good, recorder.chip.kind.blocks):
            recorder.chip.mark_bad(block)
    recorder.ready()
    assert recorder.status.empty == good - 1
    return recorder


@pytest.mark.parametrize("kind", sampled(["W25Q80", "W25N01G"], "W25N01G"))
def test_the_chip_is_full_when_one_block_is_left_and_empty_when_it_was_erased(
    board: MakeRecorder, kind: str
) -> None:
    good = {"W25Q80": 16, "W25N01G": 7}[kind]
    recorder = few_blocks(board, kind, good)
    block = BLOCK[recorder.chip.kind.nand]
    logs = [some(2 * block + 100, seed) for seed in range((good - 4) // 3)]
    for log in logs:
        flight(recorder, log, 500_000.0)
    assert recorder.status.empty == 3
    assert recorder.begin() == DONE
    last, taken = some(4 * block), 0
    for _ in range(40_000):
        taken += recorder.write(last[taken : taken + 1000])
        recorder.step()
        if recorder.state == LogState.FULL:
            break
    assert taken == 3 * block, "all blocks but the one for the mark"
    assert recorder.end() == DONE
    assert (recorder.state, recorder.status.free_kb) == (LogState.FULL, 0)
    assert recorder.begin() == FAILED
    recorder.boot()
    recorder.scanned()
    assert recorder.state == LogState.FULL
    assert [recorder.read(i, 2000) for i in range(len(logs) + 1)] == [*logs, last[:taken]]
    erases = sum(recorder.chip.memory.erases.values())
    assert recorder.erase() == DONE
    assert sum(recorder.chip.memory.erases.values()) == erases + good - 1, "what was blank is left alone"
    assert (recorder.state, recorder.status.logs, recorder.status.empty) == (LogState.READY, 0, good - 2)
    assert recorder.erase() == DONE, "there is nothing to erase"
    assert sum(recorder.chip.memory.erases.values()) == erases + good - 1


def test_all_blocks_wear_alike_when_logs_are_written_and_erased(board: MakeRecorder) -> None:
    recorder = board("W25Q80")
    recorder.ready()
    for seed in range(1, 50):
        flight(recorder, some(300, seed), 500_000.0)
        assert recorder.entry(0) == (f"LOG{recorder.log.sequence:05}.BBL", 300)
        assert recorder.erase() == DONE
    wear = [recorder.chip.memory.erases.get(block, 0) for block in range(16)]
    assert max(wear) - min(wear) <= 1


@pytest.mark.parametrize("kind", sampled(["W25Q80", "W25M02G"], "W25Q80"))
def test_a_log_may_lie_over_the_end_of_the_chip(board: MakeRecorder, kind: str) -> None:
    recorder = few_blocks(board, kind)
    block = BLOCK[recorder.chip.kind.nand]
    flight(recorder, some(12 * block), 1_000_000.0)
    assert recorder.erase() == DONE
    logs = [some(2 * block + 5, 2), some(6 * block, 3), some(100, 4)]
    for log in logs:
        flight(recorder, log, 1_000_000.0)
    for _ in range(2):
        assert [recorder.read(i, 2000) for i in range(3)] == logs
        recorder.boot()
        recorder.ready()


def put_record(recorder: Recorder, block: int, sequence: int, kind: int, *, torn: bool = False) -> None:
    """A block begins with that record; torn: a bit of its sum is not what it should be."""
    memory = recorder.chip.memory
    record = struct.pack("<4sIHH", b"NFLG", sequence, kind, 0)
    record += struct.pack("<I", zlib.crc32(record) ^ torn)
    memory.put(block * memory.kind.pages, record.ljust(memory.kind.whole_page, b"\xff"))


def test_a_block_of_an_older_log_at_the_begin_is_no_part_of_one_over_the_end(
    board: MakeRecorder,
) -> None:
    """A block that could not be erased."""
    recorder = few_blocks(board, "W25Q80")
    flight(recorder, some(12 * BLOCK[False]), 1_000_000.0)
    assert recorder.erase() == DONE
    put_record(recorder, 0, 1, BODY)
    data = some(3 * BLOCK[False] + 100)
    for _ in range(2):
        recorder.boot()
        recorder.ready()
        if not recorder.status.logs:
            flight(recorder, data, 1_000_000.0)
        assert recorder.read(0) == data


def test_a_torn_record_is_no_log(board: MakeRecorder) -> None:
    recorder = board("W25Q80")
    recorder.ready()
    flight(recorder, some(1000))
    put_record(recorder, 1, 2, HEAD, torn=True)
    recorder.boot()
    recorder.ready()
    assert (recorder.status.logs, recorder.status.empty) == (1, 13)
    flight(recorder, some(1000, 2))
    assert recorder.read(1) == some(1000, 2)


@pytest.mark.parametrize("kind", ["W25Q80", "W25N01G"])
@pytest.mark.parametrize("where", sampled([0, 3, 15], 3))
def test_what_another_firmware_left_stays_until_the_pilot_erases(
    board: MakeRecorder, kind: str, where: int
) -> None:
    recorder = board(kind)
    chip, chance = recorder.chip, random.Random(4)
    page = where * chip.kind.pages
    chip.memory.put(page, chance.randbytes(chip.kind.page_bytes).ljust(chip.kind.whole_page, b"\xff"))
    recorder.scanned()
    assert (recorder.state, recorder.error) == (LogState.FAULT, LogError.FOREIGN)
    assert recorder.begin() == FAILED
    assert recorder.status.free_kb == recorder.status.logs == 0
    assert not chip.operations
    assert recorder.erase() == DONE
    assert (recorder.state, recorder.error) == (LogState.READY, LogError.NONE)
    assert len(chip.memory.erases) == chip.kind.blocks, "blocks that begin blank may not be"
    flight(recorder, some(1000))
    recorder.boot()
    recorder.ready()
    assert recorder.read(0) == some(1000)


def test_bad_blocks_are_passed_over_and_remembered(board: MakeRecorder) -> None:
    recorder = board("W25N01G")
    chip = recorder.chip
    for block in (0, 2, 3, 1023):
        chip.mark_bad(block)
    recorder.ready()
    assert recorder.status.empty == 1019
    chip.wear_out(5)
    data = some(3 * BLOCK[True] + 100)
    flight(recorder, data, 1_000_000.0)
    assert recorder.read(0, 2000) == data
    used = [block for block in range(10) if chip.memory.read(block * 64 + 1) != chip.memory.blank]
    assert used == [1, 4, 6, 7]
    chip.dies[0].worn.clear()
    assert recorder.read(0, 2000) == data
    recorder.boot()
    recorder.ready()
    assert recorder.read(0, 2000) == data
    chip.wear_out(6)
    assert recorder.erase() == DONE
    assert recorder.state == LogState.READY
    chip.dies[0].worn.clear()
    recorder.boot()
    recorder.ready()
    assert recorder.status.empty == 1019 - 3, "the mark, and blocks 5 and 6"
    assert [block for block in range(10) if chip.memory.read(block * 64)[2048] == 0] == [0, 2, 3, 5, 6]


def test_the_flight_goes_on_in_a_new_log_when_a_block_wears_out(board: MakeRecorder) -> None:
    recorder, data = board("W25N01G"), some(200_000)
    recorder.ready()
    assert recorder.begin() == DONE
    recorder.record(data[:20_000])
    recorder.chip.wear_out(0)
    taken = 20_000
    while recorder.state == LogState.LOGGING:
        taken += recorder.write(data[taken : taken + 100])
        recorder.step()
    assert (recorder.state, recorder.error) == (LogState.FAULT, LogError.WRITE)
    assert recorder.end() == FAILED
    flight(recorder, some(5000, 2))
    assert recorder.error == LogError.NONE
    name, size = recorder.entry(0) or ("", 0)
    assert (name, size % PAYLOAD[True]) == ("LOG00001.BBL", 0)
    assert size > 16_000
    assert recorder.read(0) == data[:size]
    assert recorder.read(1) == some(5000, 2)


def test_a_nor_chip_that_takes_nothing_is_left_alone_after_a_few_tries(board: MakeRecorder) -> None:
    recorder = board("W25Q80")
    for block in range(16):
        recorder.chip.wear_out(block)
    recorder.ready()
    assert recorder.begin() == DONE
    for _ in range(4000):
        recorder.write(bytes(50))
        recorder.step()
    assert (recorder.state, recorder.error) == (LogState.FAULT, LogError.WRITE)
    assert recorder.end() == FAILED
    assert recorder.begin() == FAILED
    assert recorder.chip.operations == 4


@pytest.mark.parametrize("kind", ["W25Q80", "W25N01G"])
def test_a_chip_that_does_not_hear_its_write_enable_is_not_written(board: MakeRecorder, kind: str) -> None:
    """It would be an error of the emulated chip."""
    recorder = board(kind)
    recorder.ready()
    exchange = recorder.chip.exchange
    recorder.chip.exchange = lambda sent, *more, **named: exchange(  # type: ignore[method-assign]
        b"\x05" if sent == b"\x06" else sent, *more, **named
    )
    assert recorder.begin() == DONE
    for _ in range(2000):
        recorder.write(bytes(50))
        recorder.step()
    assert (recorder.state, recorder.error) == (LogState.FAULT, LogError.WRITE)
    assert recorder.chip.operations == 0


@pytest.mark.parametrize("where", ["every block", "also spare bytes"])
def test_a_chip_full_of_anything_is_known_in_bounded_time(board: MakeRecorder, where: str) -> None:
    chance, kind = random.Random(7), "W25Q128" if where == "every block" else "W25N02K"
    recorder = board(kind)
    memory = recorder.chip.memory
    for block in range(memory.kind.blocks):
        memory.put(block * memory.kind.pages, chance.randbytes(memory.kind.whole_page))
    begun = recorder.seconds
    recorder.scanned()
    assert recorder.state in (LogState.FAULT, LogState.FULL)
    assert recorder.seconds - begun < (0.3 if kind == "W25Q128" else 3.0)
    assert recorder.most <= 8
    assert recorder.begin() == FAILED


@pytest.mark.parametrize("kind", ["W25Q80", "MX25L128", "W25Q256"])
def test_blocks_that_were_protected_are_no_longer(board: MakeRecorder, kind: str) -> None:
    recorder = board(kind)
    for die in recorder.chip.dies:
        die.protection = 0x1C
        die.power_on()
    recorder.ready()
    flight(recorder, some(1000))
    assert recorder.read(0) == some(1000)


def test_a_page_that_cannot_be_mended_does_not_keep_the_rest_from_being_read(board: MakeRecorder) -> None:
    recorder, data = board("W25N01G"), some(50_000)
    recorder.ready()
    flight(recorder, data)
    recorder.chip.decay(7)
    assert recorder.entry(0) == ("LOG00001.BBL", len(data))
    assert recorder.read(0) == data


@pytest.mark.parametrize("kind", ["W25Q80", "W25N01G"])
def test_a_peer_that_asks_for_several_places_in_turn_gets_them_all(board: MakeRecorder, kind: str) -> None:
    recorder, data = board(kind), some(2 * BLOCK[kind == "W25N01G"] + 5000)
    recorder.ready()
    flight(recorder, data, 1_000_000.0)
    recorder.entry(0)
    buffer, count = recorder.core.new("uint8_t[]", 230), recorder.core.new("size_t *")
    wanted = list(range(0, len(data), 230))
    asked, rounds = wanted[:12], 0
    wanted = wanted[12:]
    while asked:
        offset = asked.pop(0)
        count[0] = 230
        answer = int(recorder.device.read(recorder.device.context, 0, offset, buffer, count))
        if answer == DONE:
            assert bytes(buffer[0 : count[0]]) == data[offset : offset + count[0]]
            asked += wanted[:1]
            wanted = wanted[1:]
        else:
            asked.append(offset)
        recorder.step()
        rounds += 1
    assert rounds < 4 * len(data) / 230


def test_a_chip_that_is_absent_or_not_known_is_told(board: MakeRecorder) -> None:
    recorder = board()
    recorder.chip.power_off(0)
    recorder.scanned()
    assert (recorder.state, recorder.error) == (LogState.ABSENT, LogError.NO_CARD)
    recorder.chip.power_on(recorder.cycle)
    recorder.until(lambda: recorder.state == LogState.READY)
    other = board(dataclasses.replace(KINDS["W25Q16"], identity=b"\x12\x34\x15"))
    other.scanned()
    assert (other.state, other.error) == (LogState.FAULT, LogError.CHIP)


@pytest.mark.parametrize(
    ("kind", "rate"), [("W25Q128", 200_000.0), ("M25P16", 125_000.0), ("W25N01G", 250_000.0)]
)
def test_nothing_is_lost_at_one_round_a_millisecond(board: MakeRecorder, kind: str, rate: float) -> None:
    recorder, data = board(kind), some(100_000)
    recorder.ready()
    recorder.round = CYCLES_A_SECOND // 1000
    assert recorder.begin() == DONE
    history = recorder.record(data, rate)
    late = [int((at - history[0][0]) * rate) - taken for at, taken in history]
    assert max(late) < 0.001 * rate + 1, "all that came was taken at once"
    assert recorder.end() == DONE
    assert recorder.read(0) == data
