"""A serial line of the board with the real image behind it: clients in this program and in others."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import serial

from neuroflight.flash.link import messages
from neuroflight.flash.link.client import Client
from neuroflight.flash.link.msp import encode, request
from neuroflight.sim.board.board import Board
from neuroflight.sim.board.core.context import TIME_HZ
from neuroflight.sim.board.debug.snapshot import Snapshot, restore_snapshot, take_snapshot
from neuroflight.sim.board.peripherals.usart import Format
from neuroflight.sim.board.serial.bridge import (
    READ_MAX,
    SLICE,
    Bridge,
    LineTransport,
    PtyEnd,
    TcpEnd,
    UartLine,
)
from neuroflight.toolchain.contract import MSP_VARIANT_BETAFLIGHT, Msp
from neuroflight.toolchain.errors import LinkError

BOOT_S = 0.4
QUESTION = encode(request(Msp.API_VERSION))
ANSWER = b"$M>\x03\x01\x00\x01\x2f\x2c"
MILLISECOND = TIME_HZ // 1000


@pytest.fixture(scope="module")
def booted(board_image: Path) -> Iterator[tuple[Board, Snapshot]]:
    board = Board(board_image.with_suffix(".bin").read_bytes(), elf=board_image)
    board.run(BOOT_S)
    yield board, take_snapshot(board.engine)
    board.close()


@pytest.fixture
def board(booted: tuple[Board, Snapshot]) -> Board:
    """The real image, shortly after its boot."""
    restore_snapshot(booted[0].engine, booted[1])
    return booted[0]


def ask(line: UartLine) -> Client:
    transport = LineTransport(line)
    return Client(transport, transport.clock)


def test_the_image_answers_our_client_when_both_speak_the_same(board: Board) -> None:
    line = UartLine(board)
    with ask(line) as client:
        assert messages.fc_variant(client.request(Msp.FC_VARIANT)) == MSP_VARIANT_BETAFLIGHT
    assert (line.refused, line.framing_errors) == (0, 0)


def test_bytes_take_their_time_when_they_go_over_the_line(board: Board) -> None:
    line, begin = UartLine(board), board.cycle
    byte = 10 * TIME_HZ // 115200
    assert line.send(QUESTION) == begin + len(QUESTION) * byte
    assert (line.pending, line.room(3 * byte)) == (len(QUESTION), 0)
    board.run_to(begin + len(QUESTION) * byte - byte // 100)  # the core ends the instruction that it is at
    assert line.pending == 1
    board.run_to(board.cycle + 10 * MILLISECOND)
    assert line.take() == ANSWER
    assert line.last_heard is not None
    assert line.last_heard >= begin + (len(QUESTION) + len(ANSWER)) * byte


def test_a_conversation_is_repeated_to_the_cycle_when_it_is_held_again(
    board: Board, booted: tuple[Board, Snapshot]
) -> None:
    seen = []
    for _ in range(2):
        restore_snapshot(board.engine, booted[1])
        line = UartLine(board)
        with ask(line) as client:
            payload = client.request(Msp.STATUS_EX)
        seen.append((payload, board.cycle, line.last_heard, board.engine.trace_hash))
    assert seen[0] == seen[1]


@pytest.mark.parametrize("baud", [57600, 230400])
def test_there_is_silence_when_the_client_speaks_at_another_speed(board: Board, baud: int) -> None:
    line = UartLine(board, format=Format(baud))
    begin = board.cycle
    with ask(line) as client, pytest.raises(LinkError, match="silence, expected a reply to MSP API_VERSION"):
        client.request(Msp.API_VERSION, timeout=0.05, retries=0)
    assert line.refused == len(QUESTION)
    assert board.cycle - begin == pytest.approx(0.05 * TIME_HZ, abs=1)


def test_the_answer_is_no_answer_when_the_listener_runs_at_another_speed(board: Board) -> None:
    line = UartLine(board)
    line.send(QUESTION)
    board.run_to(board.cycle + len(QUESTION) * line.format.byte_cycles)
    line.format = Format(57600)  # from here on
    board.run_to(board.cycle + 10 * MILLISECOND)
    assert (line.take(), line.framing_errors) == (b"", len(ANSWER))


def test_it_says_so_when_the_line_was_closed_or_there_is_none(board: Board) -> None:
    transport = LineTransport(UartLine(board))
    transport.close()
    with pytest.raises(LinkError, match="USART1 of the emulated board: the line was closed"):
        transport.write(QUESTION)
    with pytest.raises(ValueError, match="a line on 'UART9', expected one of USART1, "):
        UartLine(board, "UART9")


def test_it_says_so_when_another_line_has_taken_its_place(board: Board) -> None:
    first = ask(UartLine(board))
    with ask(UartLine(board)) as second:
        assert second.request(Msp.FC_VARIANT) == b"BTFL"
    with pytest.raises(LinkError, match="another line has taken its place, expected one at a time"):
        first.request(Msp.FC_VARIANT)


def run(board: Board, bridge: Bridge, seconds: float) -> None:
    """As whoever runs the board does."""
    end = board.cycle + round(seconds * TIME_HZ)
    while board.cycle < end:
        bridge.exchange(SLICE)
        board.run_to(board.cycle + SLICE)
    bridge.exchange(SLICE)


def test_a_program_is_answered_when_it_opens_the_pseudo_terminal(board: Board) -> None:
    end = PtyEnd()
    bridge = Bridge(UartLine(board), end)
    with serial.Serial(end.name, timeout=5) as program:
        program.write(QUESTION)
        run(board, bridge, 0.01)
        assert program.read(len(ANSWER)) == ANSWER
        assert program.in_waiting == 0
    with serial.Serial(end.name, timeout=5) as another:
        another.write(QUESTION)
        run(board, bridge, 0.01)
        assert another.read(len(ANSWER)) == ANSWER
    bridge.close()
    bridge.close()


def test_a_second_program_is_turned_away_and_a_later_one_served_when_it_is_tcp(board: Board) -> None:
    end = TcpEnd()
    bridge = Bridge(UartLine(board), end)

    def call() -> socket.socket:
        return socket.create_connection(("127.0.0.1", end.port), 5.0)

    with call() as first, call() as second:
        first.sendall(QUESTION)
        run(board, bridge, 0.01)
        assert first.recv(100) == ANSWER
        assert second.recv(100) == b""
    run(board, bridge, 0.01)
    with call() as third:
        third.sendall(QUESTION)
        run(board, bridge, 0.01)
        assert third.recv(100) == ANSWER
    bridge.close()


def test_the_next_program_is_served_when_the_one_before_went_unnoticed(board: Board) -> None:
    end = TcpEnd()
    bridge = Bridge(UartLine(board), end)
    with socket.create_connection(("127.0.0.1", end.port), 5.0) as first:
        first.sendall(QUESTION)
        run(board, bridge, 0.01)
        assert first.recv(100) == ANSWER
        first.sendall(QUESTION)  # and does not wait for the answer
    with socket.create_connection(("127.0.0.1", end.port), 5.0) as second:
        run(board, bridge, 0.01)
        second.sendall(QUESTION)
        run(board, bridge, 0.01)
        assert second.recv(100).endswith(ANSWER)
    bridge.close()


def test_the_next_program_is_served_soon_when_the_one_before_left_much_unread() -> None:
    """What was sent and never taken would keep the line for minutes: 115200 baud carry 11 kB a second."""
    end = TcpEnd()
    with socket.create_connection(("127.0.0.1", end.port), 5.0) as first:
        assert end.receive(1) == b""
        first.setblocking(False)
        sent = first.send(bytes(1 << 20))
        assert sent > READ_MAX
    with socket.create_connection(("127.0.0.1", end.port), 5.0) as second:
        second.sendall(QUESTION)
        taken = 0
        while (data := end.receive(64)) != QUESTION:
            taken += len(data)
            assert set(data) == {0}
    assert 0 < taken <= READ_MAX
    end.close()


def test_a_sender_has_to_wait_when_it_is_faster_than_the_line(board: Board) -> None:
    end = PtyEnd()
    bridge = Bridge(UartLine(board), end)
    program = os.open(end.name, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    sent = os.write(program, bytes(4000))
    for _ in range(100):  # 10 ms, in which 115 bytes go over the line
        bridge.exchange(SLICE)
        assert bridge.line.pending <= 3
        board.run_to(board.cycle + SLICE)
    taken = sent - len(_drain(end))
    assert 115 <= taken <= 118
    os.close(program)
    bridge.close()


def test_old_bytes_are_kept_to_a_bound_when_nobody_reads(board: Board) -> None:
    class Deaf(TcpEnd):
        def send(self, data: bytes) -> int:
            return 0

    bridge = Bridge(UartLine(board), Deaf())
    hear: Callable[[int], None] = board.hardware.usarts["USART1"].on_sent
    for _ in range(70_000):
        hear(0x55)
    bridge.exchange(SLICE)
    assert bridge.lost == 70_000 - 65_536
    bridge.close()


def test_it_says_so_when_the_port_is_taken() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(LinkError, match=rf"TCP port {taken.getsockname()[1]}: .*, expected a free port"):
            TcpEnd(taken.getsockname()[1])


def _drain(end: PtyEnd) -> bytes:
    data = b""
    while more := end.receive(4096):
        data += more
    return data


# --- The chip's ROM ----------------------------------------------------------------------------------
def test_a_bridge_has_parity_while_the_rom_runs_and_none_behind_it(board_image: Path) -> None:
    """Its other end knows no parity."""
    board = Board(board_image.with_suffix(".bin").read_bytes(), boot_button=True)
    end = PtyEnd()
    bridge = Bridge(UartLine(board, format=Format(115_200)), end)
    program = os.open(end.path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)

    def answer(question: bytes) -> bytes:
        os.write(program, question)
        for _ in range(20):
            bridge.exchange(MILLISECOND)
            board.run_to(board.cycle + MILLISECOND)
        bridge.exchange(MILLISECOND)
        try:
            return os.read(program, 100)
        except BlockingIOError:
            return b""

    try:
        board.run(0.001)
        assert answer(b"\x7f") == b"\x79"
        assert bridge.line.format.parity == "E"
        board.hold_boot_button(False)
        board.reset()
        board.run(BOOT_S)
        assert answer(QUESTION) == ANSWER
        assert bridge.line.format == Format(115_200)
    finally:
        os.close(program)
        bridge.close()
        board.close()
