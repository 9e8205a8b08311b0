"""Where packets may go to and come from, and that no bytes of a stranger raise anything."""

from __future__ import annotations

import random
import socket
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from neuroflight.flash.mavlink.endpoint import DATAGRAM_MAX, MESSAGES_MAX, UdpPeer, Wire, parse, parse_address
from neuroflight.toolchain.errors import LinkError

ENCODER = mavlink.MAVLink(None, 255, 190)
PING = bytes(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(ENCODER))
SET = bytes(mavlink.MAVLink_param_set_message(1, 1, b"roll_expo", 0.5, 9).pack(ENCODER))


def kinds(packet: bytes) -> list[str]:
    return [message.get_type() for message in parse(packet)]


@pytest.mark.parametrize("text", ["udp:127.0.0.1:14550", "udp:localhost:1", "udp:[::1]:65535"])
def test_an_address_of_this_computer_is_taken(text: str) -> None:
    assert parse_address(text).loopback


@pytest.mark.parametrize("text", ["udp:192.0.2.1:14550", "udp:0.0.0.0:14550", "udp:[2001:db8::1]:14550"])
def test_another_computer_needs_permission(text: str) -> None:
    with pytest.raises(LinkError, match="--allow-remote"):
        parse_address(text)
    assert not parse_address(text, remote=True).loopback


@pytest.mark.parametrize(
    "text",
    [
        *("", "udp", "udp:", "udp:127.0.0.1", "udp:127.0.0.1:", "udp:127.0.0.1:0", "udp:127.0.0.1:65536"),
        *("tcp:127.0.0.1:14550", "udp::14550", "udp:127.0.0.1:1e3", "udp:a\nb:1", "udp:h\0st:1", "14550"),
        *("udp:127.0.0.1:99999999999999999999", "udp:no.such.host.invalid:14550", f"udp:{'x' * 300}:1"),
    ],
)
def test_another_text_is_refused_by_one_line(text: str) -> None:
    with pytest.raises(LinkError) as error:
        parse_address(text)
    assert "\n" not in str(error.value) and "expected" in str(error.value)


def test_only_the_peer_is_heard() -> None:
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger,
    ):
        station.bind(("127.0.0.1", 0))
        peer = UdpPeer(parse_address(f"udp:127.0.0.1:{station.getsockname()[1]}"))
        try:
            peer.send(b"hello")
            _, there = station.recvfrom(100)
            stranger.sendto(b"from elsewhere", there)
            station.sendto(b"from the station", there)
            assert peer.receive() == b"from the station"
            assert peer.receive() is None
            station.sendto(b"x" * (DATAGRAM_MAX + 1), there)
            assert peer.receive() == b"x" * DATAGRAM_MAX
        finally:
            peer.close()


def test_nothing_happens_when_nobody_listens_and_a_later_peer_is_heard() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station:
        station.bind(("127.0.0.1", 0))
        number = station.getsockname()[1]
    peer = UdpPeer(parse_address(f"udp:127.0.0.1:{number}"))
    try:
        for _ in range(3):
            peer.send(b"into the void")
            assert peer.receive() is None
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station:
            station.bind(("127.0.0.1", number))
            peer.send(b"hello")
            _, there = station.recvfrom(100)
            station.sendto(b"here", there)
            assert peer.receive() == b"here"
    finally:
        peer.close()


def test_a_port_that_the_system_gave_to_both_ends_is_left_to_the_peer(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Which port a socket gets is the system's choice: here the first one gets the peer's."""
    sockets: list[socket.socket] = []

    class Unlucky(socket.socket):
        def connect(self, place: Any) -> None:
            if not sockets:
                self.bind(place)
            sockets.append(self)
            super().connect(place)

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station:
        station.bind(("127.0.0.1", 0))
        number = station.getsockname()[1]
    monkeypatch.setattr("neuroflight.flash.mavlink.endpoint.socket.socket", Unlucky)
    peer = UdpPeer(parse_address(f"udp:127.0.0.1:{number}"))
    monkeypatch.undo()
    try:
        assert len(sockets) == 2 and sockets[0].fileno() == -1
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station:
            station.bind(("127.0.0.1", number))
            peer.send(b"hello")
            packet, there = station.recvfrom(100)
            assert packet == b"hello" and there[1] != number
            station.sendto(b"here", there)
            assert peer.receive() == b"here"
    finally:
        peer.close()


class Line:
    """A Peer that keeps what is sent."""

    def __init__(self) -> None:
        self.sent: list[bytes] = []

    def receive(self) -> bytes | None:
        return None

    def send(self, packet: bytes) -> None:
        self.sent.append(packet)


def test_packets_of_a_line_are_numbered_one_after_the_other() -> None:
    line = Line()
    wire = Wire(line, 7)
    for _ in range(300):
        wire.send(mavlink.MAVLink_heartbeat_message(2, 0, 0, 0, 4, 3))
    read = [message for packet in line.sent for message in parse(packet)]
    assert [message.get_seq() for message in read] == [n % 256 for n in range(300)]
    assert {(m.get_srcSystem(), m.get_srcComponent()) for m in read} == {(7, 1)}
    assert {packet[0] for packet in line.sent} == {0xFD}  # MAVLink 2


def test_messages_are_read_wherever_they_stand_in_a_packet() -> None:
    assert kinds(PING + SET) == ["HEARTBEAT", "PARAM_SET"]
    assert kinds(b"garbage" + PING + b"\xfe\x00" + SET) == ["HEARTBEAT"]  # a false length swallows the rest
    assert kinds(SET) == ["PARAM_SET"]  # and ends with its packet


def test_a_message_is_none_when_a_bit_of_it_is_wrong() -> None:
    for index in range(len(SET)):
        for bit in range(8):
            changed = bytearray(SET)
            changed[index] ^= 1 << bit
            assert "PARAM_SET" not in kinds(bytes(changed))


def test_a_packet_tells_no_more_messages_than_its_limit() -> None:
    assert len(kinds(PING * (MESSAGES_MAX + 10))) == MESSAGES_MAX


def test_nothing_is_raised_whatever_comes() -> None:
    chance = random.Random(19)
    numbers = list(mavlink.mavlink_map)
    for _ in range(3000):
        noise = bytearray(chance.randbytes(chance.randrange(0, 300)))
        if noise and chance.random() < 0.7:
            noise[0] = chance.choice((0xFD, 0xFE))
        list(parse(bytes(noise)))
    for number in numbers:  # good checksums around any payload
        payload = chance.randbytes(chance.randrange(1, 255))
        message = mavlink.MAVLink_message(number, "any")
        kind = mavlink.mavlink_map[number]
        packet = message._pack(ENCODER, kind.crc_extra, payload)
        list(parse(bytes(packet)))
