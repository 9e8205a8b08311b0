"""UDP to a ground station or companion: addresses that may be used, packets in, packets out."""

from __future__ import annotations

import contextlib
import ipaddress
import socket
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Protocol

from pymavlink.dialects.v20 import common as mavlink

from neuroflight.toolchain.errors import LinkError

FORM = "udp:HOST:PORT, such as udp:127.0.0.1:14550"
DATAGRAM_MAX = 2048  # bytes; a MAVLink frame has 280 at most, ground stations join a few
REFUSALS_MAX = 8  # errors of earlier packets, reported before the next packet
MESSAGES_MAX = 64  # in a datagram; further ones are dropped


class Peer(Protocol):
    """One ground station or companion."""

    def receive(self) -> bytes | None:
        """Return the next packet that has arrived, or None. Never waits."""

    def send(self, packet: bytes) -> None:
        """Send a packet; it is lost where nobody listens."""


@dataclass(frozen=True)
class Address:
    """The address that a peer listens at; numbers only."""

    family: socket.AddressFamily
    host: str
    port: int

    @property
    def loopback(self) -> bool:
        """True if only this computer can have the address."""
        return ipaddress.ip_address(self.host.partition("%")[0]).is_loopback


def parse_address(text: str, *, remote: bool = False) -> Address:
    """Read udp:HOST:PORT. remote: another computer may be meant. Raises LinkError."""
    scheme, _, rest = text.partition(":")
    host, _, number = rest.rpartition(":")
    host = host.removeprefix("[").removesuffix("]")
    good = text.isprintable() and scheme == "udp" and host and number.isascii() and number.isdecimal()
    if not good or not 1 <= int(number[:9]) <= 65535:
        raise LinkError(f"--mavlink got {text!r}, expected {FORM}")
    try:
        found = socket.getaddrinfo(host, int(number), type=socket.SOCK_DGRAM)
    except (OSError, UnicodeError):
        raise LinkError(
            f"--mavlink {text}: the host name {host!r} does not resolve, expected a name or an address; "
            "check its spelling or give the address"
        ) from None
    family, _, _, _, place = found[0]
    address = Address(family, str(place[0]), int(place[1]))
    if not address.loopback and not remote:
        raise LinkError(
            f"--mavlink {text}: {address.host} is another computer, expected this one; nothing was opened: "
            "MAVLink asks nobody who he is, so give --allow-remote only on a network that is yours alone"
        )
    return address


def _open(address: Address) -> socket.socket:
    """Open a non-blocking socket to `address` alone. Raises LinkError."""
    opened = socket.socket(address.family, socket.SOCK_DGRAM)
    try:
        opened.connect((address.host, address.port))
    except OSError as error:
        opened.close()
        why = (error.strerror or str(error)).lower()
        raise LinkError(
            f"--mavlink: {address.host} port {address.port}: {why}, expected a way there; "
            "check the address and the network"
        ) from None
    opened.setblocking(False)
    return opened


class UdpPeer:
    """A socket that talks to one address and hears no other."""

    def __init__(self, address: Address) -> None:
        """Open the socket. Raises LinkError if the system has no route to the address."""
        self._socket = _open(address)
        if self._socket.getsockname() == self._socket.getpeername():
            # While nobody listens there, the system may give a socket the very port it is to send to. It
            # would hear itself and keep that port from the peer. Another socket gets another port as long as
            # this one is open.
            with self._socket:
                self._socket = _open(address)

    def fileno(self) -> int:
        """Return the descriptor, for select."""
        return self._socket.fileno()

    def receive(self) -> bytes | None:
        """See Peer."""
        for _ in range(REFUSALS_MAX):
            try:
                return self._socket.recv(DATAGRAM_MAX)
            except ConnectionRefusedError:  # nobody listened when an earlier packet was sent
                continue
            except OSError:
                return None
        return None

    def send(self, packet: bytes) -> None:
        """See Peer."""
        with contextlib.suppress(OSError):  # nobody listens yet, or the buffer is full
            self._socket.send(packet)

    def close(self) -> None:
        """Close the socket; may be called twice."""
        self._socket.close()


class Wire:
    """MAVLink 2 to and from one peer, with the sequence numbers of that line."""

    def __init__(self, peer: Peer, system: int) -> None:
        self.peer = peer
        self._encoder = mavlink.MAVLink(None, system, mavlink.MAV_COMP_ID_AUTOPILOT1)

    def send(self, message: Any) -> None:  # noqa: ANN401 - pymavlink's are untyped
        """Send a message."""
        self.peer.send(bytes(message.pack(self._encoder)))
        self._encoder.seq = (self._encoder.seq + 1) % 256

    def messages(self, packets_max: int) -> Iterator[Any]:
        """Yield the messages of packets that have arrived, `packets_max` at most, skipping other bytes."""
        for _ in range(packets_max):
            packet = self.peer.receive()
            if packet is None:
                return
            yield from parse(packet)


def parse(packet: bytes) -> Iterator[Any]:
    """Yield the MAVLink messages of a packet. Other bytes are skipped; a frame cut short does not reach into
    the next packet."""
    parser = mavlink.MAVLink(None)
    parser.robust_parsing = True
    waiting = packet
    for _ in range(MESSAGES_MAX):
        try:
            message = parser.parse_char(waiting)
        except Exception:
            return
        waiting = b""
        if message is None:
            return
        if message.get_type() != "BAD_DATA" and not message.get_type().startswith("UNKNOWN"):
            yield message
