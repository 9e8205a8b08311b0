"""Bytes of a log over a line that loses some, from a device that is slow, as it was written."""

from __future__ import annotations

import pytest

from neuroflight.flash.link.client import RefusedError
from neuroflight.flash.logs.reading import PATIENCE_S, WINDOW, LogReader, read_bytes
from neuroflight.toolchain.contract import Refusal
from neuroflight.toolchain.errors import LinkError
from tests.flash.image.board_model import ModelLine
from tests.flash.logs.log_model import PacedLine, card_board, client_of, log_board, log_of, losing

LOG = log_of(60_000)


def read_all(line: ModelLine, size: int = len(LOG)) -> bytes:
    return read_bytes(client_of(line), 0, 0, size, line.clock)


def test_a_log_is_read_whole_and_nothing_twice() -> None:
    board = log_board(LOG)
    assert read_all(ModelLine(board)) == LOG
    assert sorted(board.reads) == sorted(set(board.reads))
    assert len(board.reads) <= 3 * (len(LOG) // 512 + 1)


@pytest.mark.parametrize("size", [1, 40, 232, 233, 234, 466, 512, 513])
def test_ends_fall_anywhere(size: int) -> None:
    assert read_all(ModelLine(log_board(LOG[:size])), size) == LOG[:size]


def test_many_questions_are_on_their_way_at_once() -> None:
    line = ModelLine(log_board(LOG))
    most = 0
    reader = LogReader(client_of(line), 0, 0, len(LOG), line.clock)
    while reader.at < len(LOG):
        reader.read()
        most = max(most, len(line._coming))
    assert WINDOW - 1 <= most <= WINDOW


def test_a_part_is_read_from_the_middle() -> None:
    line = ModelLine(log_board(log_of(100, 2), LOG))
    assert read_bytes(client_of(line), 1, 12_345, 2048, line.clock) == LOG[12_345 : 12_345 + 2048]


@pytest.mark.parametrize("whole_sectors", [False, True])
@pytest.mark.parametrize("early", [0, 1, 3])
@pytest.mark.parametrize("share", [0.0, 0.05, 0.3])
def test_what_is_lost_or_too_early_is_asked_for_again(early: int, share: float, whole_sectors: bool) -> None:
    board = log_board(LOG, early=early, whole_sectors=whole_sectors)
    assert read_all(ModelLine(board, down=losing(share), up=losing(share, 4))) == LOG


def test_a_device_that_forgets_what_it_was_asked_before_still_gets_on() -> None:
    """It finds one piece at a time: a question for another one gives the first one up."""
    board = log_board(LOG)
    sought: list[int] = []
    ready: set[int] = set()

    def later(place: int) -> bool:
        if place in ready:
            return False
        ready.clear()
        if sought and sought[-1] == place:
            ready.add(place)
        sought[:] = [place]
        return True

    board.later = later  # type: ignore[method-assign]
    assert read_all(ModelLine(board)) == LOG


def test_a_device_that_never_answers_is_given_up_in_one_line() -> None:
    board = log_board(LOG, early=10**9)
    line = ModelLine(board)
    with pytest.raises(LinkError, match=r"no byte of the log came for 15 s, expected byte 0 of 60,000"):
        read_all(line)
    assert PATIENCE_S <= board.now < PATIENCE_S + 3


def test_a_refusal_ends_it_with_its_reason() -> None:
    with pytest.raises(RefusedError) as error:
        read_all(ModelLine(log_board(LOG, armed=True)))
    assert error.value.reason is Refusal.ARMED


def test_a_log_that_is_shorter_than_listed_is_told() -> None:
    with pytest.raises(LinkError, match=r"the log ends at byte 60,000, expected 60,001 as it was listed"):
        read_all(ModelLine(log_board(LOG)), len(LOG) + 1)


def test_requests_behind_it_get_their_own_answers() -> None:
    line = ModelLine(log_board(LOG))
    client = client_of(line)
    reader = LogReader(client, 0, 0, len(LOG), line.clock)
    reader.read()
    assert read_bytes(client, 0, 50_000, 300, line.clock) == LOG[50_000:50_300]


@pytest.mark.parametrize("latency_ms", [0.1, 1, 8])
def test_the_line_is_never_idle(latency_ms: float) -> None:
    """8 ms each way: a USB adapter that waits for more before it hands bytes on."""
    log = log_of(300_000)
    line = PacedLine(log_board(log), 921_600, latency_ms / 1000)
    assert read_all(line, len(log)) == log
    raw_s = len(log) * 10 / 921_600
    told_s = line.up_bytes * 10 / 921_600
    assert told_s < 1.1 * raw_s  # of what the answers' frames add
    assert line.clock() < 1.02 * told_s + 30 * latency_ms / 1000


@pytest.mark.parametrize("read_ms", [0.5, 1, 2])
@pytest.mark.parametrize("latency_ms", [0.1, 1])
def test_a_card_that_holds_one_sector_is_read_well_too(latency_ms: float, read_ms: float) -> None:
    log = log_of(100_000)
    line = PacedLine(card_board(log, read_s=read_ms / 1000), 921_600, latency_ms / 1000)
    assert read_all(line, len(log)) == log
    sectors = len(log) / 512
    in_turn_s = len(log) * 10 / 921_600 + sectors * (2 * latency_ms + read_ms) / 1000
    assert line.clock() < 1.2 * in_turn_s
