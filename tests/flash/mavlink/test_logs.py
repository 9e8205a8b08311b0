"""Log download through the gateway, with pymavlink as the ground station.

The firmware is the host program, its logs a model's: a line between the two answers what is about logs.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from neuroflight.flash.link.msp import Decoder, Message, encode
from neuroflight.flash.link.transport import Transport
from neuroflight.flash.mavlink.ground import Ground
from neuroflight.flash.mavlink.log_server import LogServer
from neuroflight.flash.mavlink.session import Options
from neuroflight.toolchain.contract import LogError, Msp
from tests.flash.logs.log_model import LOG_HANDLERS, LogBoard, PacedLine, client_of, log_board, log_of
from tests.flash.mavlink.conftest import Lockstep, MakeLockstep, Station

WATCHING = Options()
PACKET, ALL = 90, 0xFFFFFFFF
CHUNK = 512 * PACKET  # that QGroundControl asks for at once


class LineWithLogs:
    """A line that answers LOG_* from a model, and carries all else."""

    def __init__(self, line: Transport, board: LogBoard) -> None:
        self._line, self._board = line, board
        self._decoder = Decoder()
        self._answers: list[bytes] = []

    @property
    def name(self) -> str:
        return self._line.name

    def write(self, data: bytes) -> None:
        (message,) = self._decoder.feed(data)  # the client sends whole requests
        assert isinstance(message, Message)
        if message.command in LOG_HANDLERS:
            self._answers.append(encode(self._board.answer(message)))
        else:
            self._line.write(data)

    def read(self, timeout: float) -> bytes:
        return self._answers.pop(0) if self._answers else self._line.read(timeout)

    def close(self) -> None:
        self._line.close()


def gateway_of(lockstep: MakeLockstep, board: LogBoard, **more: Any) -> Lockstep:
    return lockstep(WATCHING, through=lambda line: LineWithLogs(line, board), **more)


def listed(gateway: Lockstep, first: int = 0, last: int = 0xFFFF) -> list[tuple[int, ...]]:
    gateway.station.forget()
    gateway.station.link.mav.log_request_list_send(1, 1, first, last)
    gateway.run(200)
    return [(m.id, m.num_logs, m.last_log_num, m.time_utc, m.size) for m in gateway.station.got("LOG_ENTRY")]


def packets(station: Station) -> list[Any]:
    """Those that came since; they are forgotten."""
    station.read()
    found = [message for message in station.inbox if message.get_type() == "LOG_DATA"]
    station.inbox = [message for message in station.inbox if message.get_type() != "LOG_DATA"]
    return found


def download(gateway: Lockstep, number: int, size: int, drop: Callable[[], bool] = lambda: False) -> bytes:
    """As QGroundControl does it: piece by piece; where nothing more comes, the first gap again."""
    station, data = gateway.station, bytearray()
    for start in range(0, size, CHUNK):
        count = min(CHUNK, size - start)
        missing = set(range(math.ceil(count / PACKET)))
        wanted = (start, count)
        for _ in range(200):
            station.link.mav.log_request_data_send(1, 1, number, *wanted)
            gateway.run(400, every_ms=5)
            data.extend(bytes(max(0, start + count - len(data))))
            for packet in packets(station):
                if drop():
                    continue
                assert packet.id == number and packet.ofs % PACKET == 0
                data[packet.ofs : packet.ofs + packet.count] = bytes(packet.data[: packet.count])
                missing.discard((packet.ofs - start) // PACKET)
            if not missing:
                break
            first = min(missing)
            last = next(k for k in range(first, 513) if k not in missing)
            wanted = (start + first * PACKET, (last - first) * PACKET)
        assert not missing
    station.link.mav.log_request_end_send(1, 1)
    gateway.settle()
    return bytes(data)


def test_several_logs_are_listed_with_their_sizes(lockstep: MakeLockstep) -> None:
    board = log_board(log_of(100), log_of(70_000), b"", early=2)
    gateway = gateway_of(lockstep, board)
    assert listed(gateway) == [(0, 3, 2, 0, 100), (1, 3, 2, 0, 70_000), (2, 3, 2, 0, 0)]
    assert listed(gateway, 1, 1) == [(1, 3, 2, 0, 70_000)]


def test_that_there_is_no_log_is_told(lockstep: MakeLockstep) -> None:
    assert listed(gateway_of(lockstep, log_board())) == [(0, 0, 0, 0, 0)]


def test_a_log_comes_over_whole(lockstep: MakeLockstep) -> None:
    sizes = (1, 90, 8990, CHUNK + 180)
    board = log_board(*(log_of(size, size) for size in sizes))
    gateway = gateway_of(lockstep, board)
    assert [told[4] for told in listed(gateway)] == list(sizes)
    for number, size in enumerate(sizes):
        assert download(gateway, number, size) == board.logs[number]


def test_gaps_are_sent_again(lockstep: MakeLockstep) -> None:
    rng = random.Random(8)
    board = log_board(log_of(12_345), early=1)
    gateway = gateway_of(lockstep, board)
    assert download(gateway, 0, 12_345, lambda: rng.random() < 0.1) == board.logs[0]


def test_all_of_a_log_may_be_asked_for_at_once_and_its_end_is_told(lockstep: MakeLockstep) -> None:
    board = log_board(log_of(90 * 40))
    gateway = gateway_of(lockstep, board)
    gateway.station.link.mav.log_request_data_send(1, 1, 0, 0, ALL)
    gateway.run(500, every_ms=5)
    got = packets(gateway.station)
    assert b"".join(bytes(packet.data[: packet.count]) for packet in got) == board.logs[0]
    gateway.station.link.mav.log_request_data_send(1, 1, 0, 90 * 40, ALL)
    gateway.run(100)
    assert [(packet.ofs, packet.count) for packet in packets(gateway.station)] == [(3600, 0)]


def test_telemetry_comes_as_ever_while_a_log_does(lockstep: MakeLockstep) -> None:
    board = log_board(log_of(2_000_000))
    gateway = gateway_of(lockstep, board)
    gateway.run(200)
    gateway.station.forget()
    gateway.station.link.mav.log_request_data_send(1, 1, 0, 0, ALL)
    gateway.run(2000, every_ms=5)
    assert len(gateway.station.got("LOG_DATA")) > 3000
    assert abs(len(gateway.station.got("ATTITUDE")) - 20) <= 1
    assert abs(len(gateway.station.got("HEARTBEAT")) - 2) <= 1
    gateway.station.link.mav.log_request_end_send(1, 1)
    gateway.settle()
    gateway.station.forget()
    gateway.run(200)
    assert not gateway.station.got("LOG_DATA")


def test_why_there_is_no_log_is_a_text(lockstep: MakeLockstep) -> None:
    board = log_board(log_of(500), logging=True)
    gateway = gateway_of(lockstep, board)
    assert listed(gateway) == [(0, 0, 0, 0, 0)]
    assert any("a log is being written" in text for text in gateway.station.texts())
    board.logging, board.armed = False, True
    gateway.station.link.mav.log_request_data_send(1, 1, 0, 0, 90)
    gateway.run(100)
    assert any("the motors are armed or under test: disarm" in text for text in gateway.station.texts())
    board.armed, board.has_logs = False, False
    assert listed(gateway) == [(0, 0, 0, 0, 0)]
    assert any("this firmware knows no logs" in text for text in gateway.station.texts())
    board.has_logs, board.log_error = True, LogError.NONE
    assert listed(gateway) == [(0, 1, 0, 0, 500)]
    gateway.station.link.mav.log_request_data_send(1, 1, 7, 0, 90)
    gateway.run(100)
    assert any("there is no such log any more" in text for text in gateway.station.texts())


def test_logs_are_not_erased_over_mavlink(lockstep: MakeLockstep) -> None:
    board = log_board(log_of(500))
    gateway = gateway_of(lockstep, board)
    gateway.station.link.mav.log_erase_send(1, 1)
    gateway.run(100)
    assert board.logs == [log_of(500)]
    assert any("erased by `neuroflight board logs erase`" in text for text in gateway.station.texts())


def test_one_peer_is_served_at_a_time(lockstep: MakeLockstep) -> None:
    board = log_board(log_of(50_000))
    gateway = gateway_of(lockstep, board, stations=2)
    first, second = gateway.stations
    first.link.mav.log_request_data_send(1, 1, 0, 0, 9000)
    gateway.settle()
    second.link.mav.log_request_data_send(1, 1, 0, 0, 9000)
    gateway.run(400, every_ms=5)
    assert sum(packet.count for packet in packets(first)) == 9000 and not packets(second)
    assert any("another peer is being served" in text for text in second.texts())
    first.link.mav.log_request_end_send(1, 1)
    gateway.settle()
    second.link.mav.log_request_data_send(1, 1, 0, 0, 9000)
    gateway.run(400, every_ms=5)
    assert sum(packet.count for packet in packets(second)) == 9000 and not packets(first)


class Counting:
    """A peer that counts the bytes of a log, and asks for them."""

    def __init__(self) -> None:
        self.got = 0
        self._parser = mavlink.MAVLink(None)

    def receive(self) -> None:
        return None

    def send(self, packet: bytes) -> None:
        message = self._parser.parse_char(packet)
        self.got += message.count


@pytest.mark.parametrize(
    ("baud", "latency_ms", "share", "wait_s"),
    [
        (921_600, 0.2, 0.85, 0.06),
        (921_600, 8, 0.7, 0.08),
        (115_200, 0.2, 0.85, 0.06),
        (115_200, 8, 0.65, 0.08),
    ],
)
def test_a_log_fills_the_line_and_other_answers_do_not_wait_long(
    baud: int, latency_ms: float, share: float, wait_s: float
) -> None:
    """share: of what the line could carry. wait_s: for the answer to another question, at most."""
    line = PacedLine(log_board(log_of(1_000_000)), baud, latency_ms / 1000)
    client = client_of(line)
    peer = Counting()
    ground = Ground([peer], 1, line.clock, lambda text: None)
    server = LogServer(client, ground, line.clock)
    request = mavlink.MAVLink_log_request_data_message(1, 1, 0, 0, ALL)
    server.handle((0, 255, 190), request)
    asked, waits = 0.0, []
    while line.clock() < 3.0:
        assert server.due is not None
        if line.clock() < server.due:
            line.board.now = server.due
        if line.clock() >= asked + 0.1:
            asked = line.clock()
            client.request(Msp.STATUS_EX)
            waits.append(line.clock() - asked)
        server.step(steered=False)
    assert max(waits) < wait_s
    assert peer.got > share * 3.0 * baud / 10
