"""`neuroflight log` list, fetch and erase as a user calls them, over TCP to a model of a board with logs."""

from __future__ import annotations

import json
import signal
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from neuroflight.cli.main import main
from neuroflight.flash.link.msp import Decoder, Message, encode
from neuroflight.toolchain.contract import LogError, LogState
from tests.flash.logs.log_model import LogBoard, log_board, log_of
from tests.forked import Forked

ROOT = Path(__file__).resolve().parents[2]
FIRST, LAST = log_of(5000, 1), log_of(9000, 2)
Serve = Callable[[LogBoard], str]


@pytest.fixture
def serve(tcp_server: Callable[[Callable[[bytes], bytes]], str]) -> Serve:
    """Put a board behind a TCP port; gives the port's name."""

    def start(board: LogBoard) -> str:
        decoder = Decoder()

        def answer(data: bytes) -> bytes:
            events = decoder.feed(data)
            return b"".join(encode(board.answer(event)) for event in events if isinstance(event, Message))

        return tcp_server(answer)

    return start


def log(capsys: pytest.CaptureFixture[str], *words: str | Path) -> tuple[int, str, str]:
    """Exit code and what was printed."""
    code = main(["board", "logs", *map(str, words)])
    told = capsys.readouterr()
    return code, told.out, told.err


def test_list_tells_the_device_in_words_and_its_logs(
    serve: Serve, capsys: pytest.CaptureFixture[str]
) -> None:
    port = serve(log_board(FIRST, LAST, dropped=17))
    code, told, _ = log(capsys, "list", "--port", port)
    assert code == 0
    for words in ("the SD card", "ready for the next flight", "17 control steps are missing", "LOG00002.BBL"):
        assert words in told
    facts = json.loads(log(capsys, "list", "--port", port, "--json")[1])
    assert facts["info"]["state"] == "ready" and [one["bytes"] for one in facts["logs"]] == [5000, 9000]


def test_list_tells_a_fault_and_that_a_log_is_being_written(
    serve: Serve, capsys: pytest.CaptureFixture[str]
) -> None:
    full = serve(log_board(log_state=LogState.FAULT, log_error=LogError.FRAGMENTED))
    code, told, _ = log(capsys, "list", "--port", full)
    assert (
        code == 0 and "at fault: the next flight is not logged; a file for logs does not lie in one" in told
    )
    flying = serve(log_board(FIRST, logging=True, armed=True, log_state=LogState.LOGGING))
    code, told, _ = log(capsys, "list", "--port", flying)
    assert code == 0 and "a log is being written" in told and "this log" in told


def test_the_last_log_is_fetched_or_those_that_are_named_or_all(
    serve: Serve, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    port = serve(log_board(FIRST, b"", LAST))
    code, told, _ = log(capsys, "fetch", "--port", port, "--out", tmp_path)
    assert code == 0 and told.startswith(f"log 3: {tmp_path / 'LOG00003.BBL'}, 9,000 bytes in ")
    assert (tmp_path / "LOG00003.BBL").read_bytes() == LAST
    code, told, _ = log(capsys, "fetch", "--port", port, "--out", tmp_path, "--all")
    assert code == 0 and "LOG00002.BBL is empty" in told and "LOG00003.BBL holds it already" in told
    assert (tmp_path / "LOG00001.BBL").read_bytes() == FIRST
    (fetched,) = json.loads(log(capsys, "fetch", "--port", port, "--out", tmp_path, "1", "--json")[1])
    assert (fetched["log"], fetched["path"]) == (1, str(tmp_path / "LOG00001.BBL")) and fetched["there"]
    code, _, line = log(capsys, "fetch", "--port", port, "--out", tmp_path, "4")
    assert code == 1 and "got log 4, expected 1 to 3" in line
    code, _, line = log(capsys, "fetch", "--port", port, "--out", tmp_path, "1", "--all")
    assert code == 1 and "expected one of them" in line
    assert sorted(path.name for path in tmp_path.iterdir()) == ["LOG00001.BBL", "LOG00003.BBL"]


def test_erasing_wants_copies_and_a_word(
    serve: Serve, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    board = log_board(FIRST, LAST)
    port = serve(board)
    assert log(capsys, "fetch", "--port", port, "--out", tmp_path, "1")[0] == 0
    code, _, line = log(capsys, "erase", "--port", port, "--copies", tmp_path, "--yes")
    assert code == 1 and f"log 2 is not in {tmp_path}, expected a copy" in line and line.count("\n") == 1
    assert log(capsys, "fetch", "--port", port, "--out", tmp_path, "--all")[0] == 0
    code, _, line = log(capsys, "erase", "--port", port, "--copies", tmp_path)
    assert code == 1 and "give --yes; nothing was erased" in line
    assert board.logs == [FIRST, LAST]
    code, told, _ = log(capsys, "erase", "--port", port, "--copies", tmp_path, "--yes", "--json")
    assert (code, board.logs) == (0, [])
    assert json.loads(told) == {"erased": ["LOG00001.BBL", "LOG00002.BBL"], "empty": 5}


def test_unfetched_logs_are_erased_when_that_is_said(
    serve: Serve, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    board = log_board(FIRST)
    words = ("--copies", tmp_path, "--unfetched", "--yes")
    code, told, _ = log(capsys, "erase", "--port", serve(board), *words)
    assert (code, board.logs) == (0, []) and told.startswith("1 logs erased")


def test_what_another_firmware_left_on_a_chip_is_erased_when_that_is_said(
    serve: Serve, capsys: pytest.CaptureFixture[str]
) -> None:
    board = log_board(log_state=LogState.FAULT, log_error=LogError.FOREIGN)
    port = serve(board)
    code, told, _ = log(capsys, "list", "--port", port)
    assert code == 0 and "the flash chip holds what another firmware wrote" in told
    code, _, line = log(capsys, "erase", "--port", port, "--yes")
    assert code == 1 and "erase --unfetched`; nothing was erased" in line and line.count("\n") == 1
    assert board.log_error is LogError.FOREIGN
    code, told, _ = log(capsys, "erase", "--port", port, "--unfetched", "--yes")
    assert code == 0 and told.startswith("0 logs erased")


def test_nothing_to_fetch_is_one_line(
    serve: Serve, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, told, line = log(capsys, "fetch", "--port", serve(log_board()), "--out", tmp_path)
    assert (code, told) == (1, "") and line.endswith("no log is kept there; nothing was written\n")
    assert list(tmp_path.iterdir()) == []


def test_an_interrupted_fetch_keeps_what_came_and_goes_on(
    serve: Serve, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    board = log_board(log_of(40_000))
    stalled = threading.Event()
    later = board.later

    def stall(place: int) -> bool:
        """From the middle on nothing is there yet."""
        if place < 5:
            return later(place)
        stalled.set()
        return True

    board.later = stall  # type: ignore[method-assign]
    port = serve(board)
    fetching = Forked("board", "logs", "fetch", "--port", port, "--out", str(tmp_path))
    assert stalled.wait(20)
    fetching.send_signal(signal.SIGTERM)
    _, told = fetching.communicate(timeout=20)
    assert fetching.returncode == 130 and told == "neuroflight: interrupted; what was finished is kept\n"
    part = (tmp_path / "LOG00001.BBL.part").read_bytes()
    assert len(part) > 4 * 4096 and board.logs[0].startswith(part)
    board.later = later  # type: ignore[method-assign]
    code, line, _ = log(capsys, "fetch", "--port", port, "--out", tmp_path)
    assert code == 0 and f"went on from byte {len(part):,}" in line
    assert (tmp_path / "LOG00001.BBL").read_bytes() == board.logs[0]
