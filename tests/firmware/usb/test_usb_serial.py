"""The serial port (CDC-ACM): bytes both ways, odd hosts, and when a peer has gone."""

from __future__ import annotations

import itertools
import struct

import pytest

from tests.firmware.usb.conftest import SerialDevice
from tests.firmware.usb.scripted_bus import (
    CLASS,
    CLEAR_FEATURE,
    ENDPOINT,
    IN,
    INTERFACE,
    SET_CONFIGURATION,
    SET_FEATURE,
    Answer,
)

DATA, NOTICE = 1, 2
SET_CODING, GET_CODING, SET_LINES = 0x20, 0x21, 0x22
READY, CARRIER = 1, 2
GOOD, LOST, NEW = range(3)  # enum serial_news
RING, SEND = 1024, 1024


@pytest.fixture
def port(serial: SerialDevice) -> SerialDevice:
    """A port that a host has configured; nobody has it open."""
    serial.bus.enumerate()
    assert serial.look() == NEW and serial.look() == GOOD
    return serial


def lines(port: SerialDevice, state: int) -> bytes | Answer:
    return port.bus.ask(CLASS | INTERFACE, SET_LINES, state)


def coding(port: SerialDevice) -> bytes | Answer:
    return port.bus.ask(IN | CLASS | INTERFACE, GET_CODING, 0, 0, 7)


@pytest.mark.parametrize("baud", [0, 1, 300, 1200, 115200, 921600, 12_000_000, 0xFFFFFFFF])
def test_any_rate_is_taken_and_told_when_a_host_sets_it(port: SerialDevice, baud: int) -> None:
    for stop, parity, bits in itertools.product(range(3), range(5), (5, 6, 7, 8, 16)):
        told = struct.pack("<IBBB", baud, stop, parity, bits)
        assert port.bus.tell(CLASS | INTERFACE, SET_CODING, 0, 0, told) is None
        assert coding(port) == told
    assert port.look() == GOOD, "the peer stays"


def test_a_coding_that_is_none_is_refused_and_the_last_one_stays(port: SerialDevice) -> None:
    assert coding(port) == struct.pack("<IBBB", 115200, 0, 0, 8)
    for wrong in ((3, 0, 8), (0, 5, 8), (0, 0, 4), (0, 0, 9), (0, 0, 0)):
        data = struct.pack("<IBBB", 9600, *wrong)
        assert port.bus.tell(CLASS | INTERFACE, SET_CODING, 0, 0, data) is Answer.STALL
    for length in (1, 6, 8):
        assert port.bus.tell(CLASS | INTERFACE, SET_CODING, 0, 0, bytes(length)) is Answer.STALL
    assert coding(port) == struct.pack("<IBBB", 115200, 0, 0, 8)


@pytest.mark.parametrize("ready", [0, READY])
def test_bytes_come_in_order_and_once_whether_a_host_says_it_is_ready_or_not(
    port: SerialDevice, ready: int
) -> None:
    lines(port, ready)
    port.look()
    sent = bytes(range(256)) * 9
    heard = b""
    for at in range(0, len(sent), 60):
        while port.bus.give(DATA, sent[at : at + 60]) is Answer.NAK:
            port.look()
            heard += port.said()
            port.line.send(port.line.context)
    port.look()
    assert heard + port.said() == sent


def test_what_came_is_read_only_once_it_was_looked_at(port: SerialDevice) -> None:
    port.bus.give(DATA, b"abc")
    assert port.line.waiting(port.line.context) == 0 and port.said() == b""
    port.look()
    assert port.line.waiting(port.line.context) == 3 and port.said() == b"abc"


def test_a_host_that_floods_waits_when_nobody_reads(port: SerialDevice) -> None:
    taken = 0
    while port.bus.give(DATA, bytes(64)) is None:
        taken += 64
        port.look()
        port.line.send(port.line.context)
        assert taken <= RING
    assert taken == RING
    port.look()
    assert len(port.said()) == RING, "nothing is lost"
    port.line.send(port.line.context)
    assert port.bus.give(DATA, b"more") is None


@pytest.mark.parametrize("first", [1, 10, 63])
def test_what_a_host_sends_has_room_when_packets_are_short(port: SerialDevice, first: int) -> None:
    sent = bytes(first)
    assert port.bus.give(DATA, sent) is None
    while port.bus.give(DATA, packet := bytes([len(sent) % 251]) * 64) is None:
        sent += packet
    port.look()
    assert port.said() == sent


def test_a_reply_goes_out_whole_and_its_end_is_seen(port: SerialDevice) -> None:
    for size in (1, 63, 64, 65, 128, 511, 512, 513, 1024):
        words = bytes(i % 251 for i in range(size))
        port.say(words)
        assert port.line.sending(port.line.context)
        packets = []
        while isinstance(packet := port.bus.take(DATA), bytes):
            packets.append(packet)
        assert b"".join(packets) == words
        assert len(packets[-1]) < 64, "a host's read ends"
        assert not port.line.sending(port.line.context) and port.room() == SEND


def test_a_host_that_never_reads_stops_the_port_alone(port: SerialDevice) -> None:
    port.say(bytes(SEND))
    assert port.room() < SEND and port.line.sending(port.line.context)
    for _ in range(5):
        port.line.send(port.line.context)
        port.look()
    assert port.room() < SEND
    assert port.bus.give(DATA, b"x") is None and coding(port) != Answer.STALL
    assert len(port.bus.read(DATA)) == SEND and port.room() == SEND


def gone(port: SerialDevice) -> None:
    """Nothing of the last peer's is left, and the port was told so, once."""
    assert port.look() == NEW and port.look() == GOOD
    assert port.said() == b""
    assert port.bus.take(DATA) is Answer.NAK
    assert not port.line.sending(port.line.context)


def busy(port: SerialDevice) -> None:
    """A peer that has sent something, and reads no reply."""
    assert lines(port, READY | CARRIER) == b""
    port.look()
    port.bus.give(DATA, b"half a requ")
    port.say(bytes(700))


def test_the_peer_has_gone_when_it_drops_dtr(port: SerialDevice) -> None:
    busy(port)
    assert lines(port, CARRIER) == b""
    gone(port)
    port.say(b"ok")
    assert port.bus.read(DATA) == b"ok", "the next one is served"


def test_another_one_is_there_when_dtr_rises(port: SerialDevice) -> None:
    port.bus.give(DATA, b"from before")
    port.say(b"unread")
    assert lines(port, READY) == b""
    gone(port)
    assert lines(port, READY | CARRIER) == b"" and port.look() == GOOD, "RTS alone changes nothing"


@pytest.mark.parametrize("how", ["reset", "unconfigured", "configured anew", "suspended"])
def test_the_peer_has_gone_when_the_bus_ends(port: SerialDevice, how: str) -> None:
    busy(port)
    if how == "reset":
        port.bus.reset()
    elif how == "suspended":
        port.bus.suspend()
    else:
        assert port.bus.ask(0, SET_CONFIGURATION, int(how == "configured anew")) == b""
    gone(port)
    if how != "configured anew":
        assert port.room() == 0, "nobody would read"
    if how == "suspended":
        port.bus.suspend(False)
        assert port.look() == GOOD
    else:
        port.bus.enumerate()
    port.say(b"ok")
    assert port.bus.read(DATA) == b"ok"
    assert port.bus.give(DATA, b"again") is None


def test_it_goes_on_when_a_host_halts_its_endpoints_and_ends_that(port: SerialDevice) -> None:
    port.say(b"reply")
    for endpoint in (DATA, DATA | IN):
        assert port.bus.ask(ENDPOINT, SET_FEATURE, 0, endpoint) == b""
    assert port.bus.take(DATA) is Answer.STALL and port.bus.give(DATA, b"x") is Answer.STALL
    for endpoint in (DATA, DATA | IN):
        assert port.bus.ask(ENDPOINT, CLEAR_FEATURE, 0, endpoint) == b""
    assert port.bus.read(DATA) == b"reply" and port.bus.give(DATA, b"x") is None


def test_nothing_is_told_by_the_endpoint_of_notices(port: SerialDevice) -> None:
    busy(port)
    assert port.bus.take(NOTICE) is Answer.NAK
