"""Power cuts in any program or erase: older logs stay whole, the last one up to its last page."""

from __future__ import annotations

import random

import pytest

from neuroflight.toolchain.contract import LogState
from tests.firmware.storage.flash_chip.conftest import MakeRecorder, Recorder
from tests.firmware.storage.flash_chip.test_flash_log import BLOCK, PAYLOAD, flight, some
from tests.firmware.storage.recorder import DONE, PowerCut
from tests.sampling import sampled

GOOD = 6  # blocks of a chip that is used
OLD = some(70_000, 1)


def used_chip(board: MakeRecorder, kind: str, seed: int) -> Recorder:
    """A chip that holds one log, which begins near the end of the ring."""
    recorder = board(kind, seed=seed)
    for block in range(recorder.chip.kind.blocks):
        if block >= GOOD and recorder.chip.kind.nand:
            recorder.chip.mark_bad(block)
    recorder.ready()
    flight(recorder, OLD, 1_000_000.0)
    return recorder


def restart(recorder: Recorder) -> None:
    recorder.chip.power_on(recorder.cycle)
    recorder._error = None
    recorder._busy_until = 0
    recorder._selected = False
    recorder.boot()
    recorder.scanned()


def cut_a_flight(board: MakeRecorder, kind: str, operation: int, seed: int) -> None:
    recorder = used_chip(board, kind, seed)
    nand = recorder.chip.kind.nand
    data = some(BLOCK[nand] + 20_000, 2)
    recorder.chip.cut_at(recorder.chip.operations + operation)
    with pytest.raises(PowerCut):
        flight(recorder, data, 1_000_000.0)
    sure = recorder.log.written
    restart(recorder)
    assert recorder.state == LogState.READY
    assert recorder.read(0, 2000) == OLD
    torn = operation == 1
    assert recorder.status.logs in ((1, 2) if torn else (2,))
    if recorder.status.logs == 2:
        _, size = recorder.entry(1) or ("", -1)
        assert size in (sure, min(sure + PAYLOAD[nand], len(data))), (
            "all whole pages, and the one that was torn if it is whole"
        )
        assert recorder.read(1, 2000) == data[:size]
    flight(recorder, some(3000, 3), 1_000_000.0)
    restart(recorder)
    assert recorder.read(0, 2000) == OLD
    assert recorder.read(recorder.status.logs - 1) == some(3000, 3)


def operations(kind: str) -> int:
    """How many a flight of cut_a_flight has."""
    nand = kind.startswith("W25N")
    return 2 + -(-BLOCK[nand] // PAYLOAD[nand]) + -(-20_000 // PAYLOAD[nand])


@pytest.mark.parametrize("kind", ["W25Q80", "W25N01G"])
@pytest.mark.parametrize(
    "operation", sampled([1, 2, 3, "block", "first of block", "last"], 2, "block", "last")
)
def test_logs_are_whole_when_the_power_goes_in_flight(
    board: MakeRecorder, kind: str, operation: int | str
) -> None:
    last = operations(kind)
    pages = 63 if kind.startswith("W25N") else 255
    number = {"block": 2 + pages, "first of block": 3 + pages, "last": last}.get(str(operation), operation)
    for seed in range(3):
        cut_a_flight(board, kind, int(number), seed)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["W25Q80", "W25N01G"])
def test_logs_are_whole_when_the_power_goes_at_any_operation_of_a_flight(
    board: MakeRecorder, kind: str
) -> None:
    for operation in range(1, operations(kind) + 1):
        cut_a_flight(board, kind, operation, operation)


def cut_an_erasing(board: MakeRecorder, recorder: Recorder, cuts: list[int]) -> None:
    """Cuts at these operations of the erasing, then of its continuation."""
    for i, cut in enumerate(cuts):
        recorder.chip.cut_at(recorder.chip.operations + cut)
        with pytest.raises(PowerCut):
            if i == 0:
                recorder.erase()
            recorder.scanned()
        if i + 1 < len(cuts):
            recorder.chip.power_on(recorder.cycle)
            recorder._error, recorder._busy_until, recorder._selected = None, 0, False
            recorder.boot()
    restart(recorder)


@pytest.mark.parametrize("kind", ["W25Q80", "W25N01G"])
@pytest.mark.parametrize(
    "cuts", sampled([[1], [2], [3], [4], [5], [2, 1], [2, 2], [3, 3], [4, 5, 2]], [1], [4, 5, 2])
)
def test_an_erasing_is_finished_when_the_power_has_cut_it_short(
    board: MakeRecorder, kind: str, cuts: list[int]
) -> None:
    recorder = used_chip(board, kind, sum(cuts))
    flight(recorder, some(2 * BLOCK[recorder.chip.kind.nand], 3), 1_000_000.0)
    cut_an_erasing(board, recorder, cuts)
    if recorder.status.logs:
        assert cuts == [1], "the mark was torn: nothing has begun"
        assert recorder.read(0, 2000) == OLD
        assert recorder.erase() == DONE
    data = some(3 * BLOCK[recorder.chip.kind.nand], 5)
    flight(recorder, data, 1_000_000.0)
    restart(recorder)
    assert recorder.read(0, 2000) == data


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["W25Q80", "W25N01G"])
def test_random_histories_keep_what_they_should(board: MakeRecorder, kind: str) -> None:
    for seed in range(150):
        history(board, kind, seed)


@pytest.mark.parametrize("kind", sampled(["W25Q80", "W25N01G"], "W25N01G"))
def test_some_random_histories_keep_what_they_should(board: MakeRecorder, kind: str) -> None:
    for seed in range(1000, 1003):
        history(board, kind, seed)


def history(board: MakeRecorder, kind: str, seed: int) -> None:
    """Flights, erasings and power cuts in any order; the logs are known at any time."""
    chance = random.Random(seed)
    recorder = used_chip(board, kind, seed)
    nand = recorder.chip.kind.nand
    logs = [OLD]
    for step in range(10):
        if chance.random() < 0.6:
            recorder.chip.cut_at(recorder.chip.operations + chance.randrange(1, chance.choice((6, 60, 600))))
        data = some(chance.randrange(2, 2 * BLOCK[nand]), 100 + step)
        try:
            if recorder.state == LogState.FULL or chance.random() < 0.2:
                kind_of_step = "erase"
                assert recorder.erase() == DONE
                logs = []
            else:
                kind_of_step = "fly"
                assert recorder.begin() == DONE
                taken = 0
                while taken < len(data) and recorder.state == LogState.LOGGING:
                    taken += recorder.write(data[taken : taken + 400])
                    recorder.step()
                assert recorder.end() == DONE
                logs.append(data[:taken])
        except PowerCut:
            sure = int(recorder.log.written)
            marked = recorder.log.stage > 1
            restart(recorder)
            if kind_of_step == "fly":
                left = [data[:size] for size in (sure, sure + PAYLOAD[nand], len(data))]
                if recorder.status.logs > len(logs):
                    logs.append(recorder.read(len(logs), 2000))
                    assert logs[-1] in left
                else:
                    assert not sure
            elif recorder.status.logs == 0:
                logs = []
            else:
                assert not marked
        assert recorder.status.logs == len(logs)
        assert [recorder.read(i, 2000) for i in range(len(logs))] == logs
        if chance.random() < 0.3:
            restart(recorder)
            assert [recorder.read(i, 2000) for i in range(len(logs))] == logs
        recorder.chip._cuts.clear()
