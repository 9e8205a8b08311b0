"""Logs into files: pulled cables, files that are there already, logs that cannot be had."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

import pytest

from neuroflight.flash.logs.catalogue import Wait, erase, read_entries, read_info, settled_info
from neuroflight.flash.logs.fetch import Fetched, fetch
from neuroflight.flash.logs.messages import LogEntry
from neuroflight.toolchain.contract import LogError, LogState
from neuroflight.toolchain.errors import LinkError
from tests.flash.image.board_model import ModelLine
from tests.flash.logs.log_model import Cable, LogBoard, client_of, log_board, log_of, wait_of

LOG = log_of(30_000)


def entries(line: ModelLine) -> list[LogEntry]:
    client = client_of(line)
    return read_entries(client, read_info(client), wait_of(line))


def get(board: LogBoard, folder: Path, index: int = 0, bytes_left: int | None = None) -> Fetched:
    """Fetch over a new cable, which may be pulled."""
    line = Cable(board)
    log = entries(line)[index]
    line.bytes_left = bytes_left
    return fetch(client_of(line), log, folder, line.clock, lambda _: None)


def test_a_log_comes_over_as_it_is(tmp_path: Path) -> None:
    board = log_board(log_of(700, 5), LOG, early=2)
    done = get(board, tmp_path / "new", 1)
    assert done == Fetched(tmp_path / "new" / "LOG00002.BBL", there=False, resumed=0)
    assert done.path.read_bytes() == LOG
    assert list(done.path.parent.iterdir()) == [done.path]


@pytest.mark.parametrize("seed", range(12))
def test_fetching_goes_on_where_the_cable_was_pulled(seed: int, tmp_path: Path) -> None:
    rng = random.Random(seed)
    board = log_board(LOG)
    pulled, resumed = 0, -1
    while True:
        try:
            done = get(board, tmp_path, bytes_left=rng.randint(6000, 12_000))
            break
        except LinkError as error:
            assert "the line is gone" in str(error)
            pulled += 1
            parts = list(tmp_path.iterdir())
            assert all(part.name == "LOG00001.BBL.part" for part in parts)
            if parts:
                there = parts[0].read_bytes()
                assert LOG.startswith(there) and len(there) > resumed
                resumed = len(there)
    assert pulled and done.resumed == resumed > 0
    assert done.path.read_bytes() == LOG
    assert list(tmp_path.iterdir()) == [done.path]


@pytest.mark.parametrize("spoilt", ["start", "end", "other log", "too long", "empty"])
def test_a_part_that_is_none_of_this_log_is_read_anew(spoilt: str, tmp_path: Path) -> None:
    parts = {
        "start": b"?" + LOG[1:9000],
        "end": LOG[:8999] + b"?" + bytes([LOG[9000] ^ 1]),
        "other log": log_of(9000, 7),
        "too long": LOG + b"more",
        "empty": b"",
    }
    (tmp_path / "LOG00001.BBL.part").write_bytes(parts[spoilt])
    done = get(log_board(LOG), tmp_path)
    assert done.resumed == 0 and done.path.read_bytes() == LOG


def test_files_that_are_there_are_kept(tmp_path: Path) -> None:
    old = tmp_path / "LOG00001.BBL"
    old.write_bytes(log_of(len(LOG), 9))  # of another card, by chance as long
    second = get(log_board(LOG), tmp_path)
    assert second.path == tmp_path / "LOG00001-2.BBL" and second.path.read_bytes() == LOG
    assert old.read_bytes() == log_of(len(LOG), 9)
    again = get(log_board(LOG), tmp_path)
    assert again == Fetched(second.path, there=True, resumed=0)
    third = get(log_board(log_of(500, 4)), tmp_path)
    assert third.path.name == "LOG00001-3.BBL"


def test_a_name_that_leads_elsewhere_is_refused(tmp_path: Path) -> None:
    line = ModelLine(log_board(LOG))
    for name in ("../x.BBL", "/etc/x", "a/b", "", ".."):
        with pytest.raises(LinkError, match=r"expected an 8\.3 name"):
            fetch(client_of(line), LogEntry(0, name, 10), tmp_path / "out", line.clock, lambda _: None)
    assert list(tmp_path.iterdir()) == []


FACTS: dict[str, dict[str, Any]] = {
    "a log is being written": {"logging": True},
    "the device is still being looked at": {"log_state": LogState.STARTING},
    "no card answers: put one in": {"log_error": LogError.NO_CARD, "log_state": LogState.FAULT},
    "this firmware knows no logs, it is older": {"has_logs": False},
}


@pytest.mark.parametrize("told", FACTS)
def test_why_no_log_can_be_had_is_one_line(told: str) -> None:
    logs = () if "card" in told else (LOG,)
    with pytest.raises(LinkError, match=told) as error:
        entries(ModelLine(log_board(*logs, **FACTS[told])))
    assert "\n" not in str(error.value)


def test_an_armed_aircraft_gives_no_log() -> None:
    with pytest.raises(LinkError, match="the motors are armed or under test: disarm"):
        entries(ModelLine(log_board(LOG, armed=True)))


def test_arming_in_the_middle_ends_it_and_keeps_what_came(tmp_path: Path) -> None:
    board = log_board(LOG)
    line = ModelLine(board)
    log = entries(line)[0]

    def arm(done: int) -> None:
        board.armed = done > 10_000

    with pytest.raises(LinkError, match="disarm, then try again"):
        fetch(client_of(line), log, tmp_path, line.clock, arm)
    board.armed = False
    done = get(board, tmp_path)
    assert done.resumed > 10_000 and done.path.read_bytes() == LOG


def test_a_card_that_is_being_looked_at_is_waited_for() -> None:
    board = log_board(log_state=LogState.STARTING)
    line = ModelLine(board)

    def sleep(seconds: float) -> None:
        board.advance(seconds)
        if board.now > 1.0:
            board.log_state, board.looking = LogState.READY, True  # with the first empty file
        if board.now > 2.0:
            board.looking, board.logs = False, [LOG]

    assert settled_info(client_of(line), Wait(line.clock, sleep)).logs == 1
    board.log_state = LogState.STARTING
    assert settled_info(client_of(line), wait_of(line)).state is LogState.STARTING


def test_erasing_takes_as_long_as_it_takes() -> None:
    board = log_board(LOG, early=50)
    line = ModelLine(board)
    erase(client_of(line), wait_of(line))
    assert board.logs == []
    assert entries(line) == []
