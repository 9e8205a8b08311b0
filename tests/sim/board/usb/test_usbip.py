"""The USB/IP server by the bytes of its protocol (Linux, usbip_protocol.rst); a small device is behind it."""

from __future__ import annotations

import re
import socket
import struct
import threading
from collections.abc import Iterator
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import pytest

from neuroflight.sim.board.usb.enumeration import request
from neuroflight.sim.board.usb.host import FRAME, Host
from neuroflight.sim.board.usb.usbip import CLIENTS_MAX, TRANSFER_MAX, URBS_MAX, UsbIpServer
from neuroflight.toolchain.errors import LinkError

if TYPE_CHECKING:
    from tests.sim.board.usb.conftest import Echo

LIST = struct.pack(">HHI", 0x0111, 0x8005, 0)
SHORT_NOT_OK = 1
PIPE, CONNRESET, SHUTDOWN, NOENT, INVALID, NODEV, REMOTEIO = -32, -104, -108, -2, -22, -19, -121


def import_(busid: str) -> bytes:
    return struct.pack(">HHI", 0x0111, 0x8003, 0) + busid.encode().ljust(32, b"\0")


def submit(
    number: int,
    endpoint: int,
    data: bytes | int = b"",
    *,
    setup: bytes = bytes(8),
    device: int = 0x10002,
    flags: int = 0,
    packets: int = 0,
) -> bytes:
    """A URB: `data` to send, or how many bytes are wanted."""
    inward = isinstance(data, int)
    length = data if isinstance(data, int) else len(data)
    head = struct.pack(">5I", 1, number, device, inward, endpoint)
    head += struct.pack(">IiiII8s", flags, length, 0, packets, 0, setup)
    return head + (b"" if isinstance(data, int) else data)


def unlink(number: int, wanted: int) -> bytes:
    return struct.pack(">6I24x", 2, number, 0x10002, 0, 0, wanted)


class Wire:
    """The server, the board's time, and clients that do not wait for either."""

    def __init__(self, bench: Any, *devices: Echo) -> None:
        self.context = bench.context
        self.hosts = [Host(bench.context.engine, device, f"usb{i}") for i, device in enumerate(devices)]
        self.server = UsbIpServer(self.hosts, 0)
        self.clients: list[socket.socket] = []

    def run(self, frames: int = 1) -> None:
        for _ in range(frames):
            self.server.exchange(FRAME)
            self.context.run_to(self.context.cycle + FRAME)
        self.server.exchange(FRAME)

    def client(self, data: bytes = b"") -> socket.socket:
        made = socket.create_connection(("127.0.0.1", self.server.port))
        made.settimeout(2)
        made.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # else a second small message waits 40 ms
        made.sendall(data)
        self.clients.append(made)
        self.run(2)
        return made

    def imported(self, busid: str = "1-1") -> socket.socket:
        client = self.client(import_(busid))
        assert self.receive(client, 320)[:8] == struct.pack(">HHI", 0x0111, 3, 0)
        return client

    def receive(self, client: socket.socket, count: int, frames: int = 400) -> bytes:
        """`count` bytes, or what comes before the connection's end."""
        got = b""
        client.setblocking(False)
        for _ in range(frames):
            with suppress(BlockingIOError):
                while len(got) < count:
                    piece = client.recv(count - len(got))
                    if not piece:
                        return got
                    got += piece
            if len(got) == count:
                return got
            self.run()
        raise AssertionError(f"{len(got)} of {count} bytes")

    def answer(self, client: socket.socket, *, inward: bool = False) -> tuple[int, int, int, bytes]:
        """Number, status, length and data of a returned URB."""
        head = self.receive(client, 48)
        command, number, device, direction, endpoint, status, length = struct.unpack_from(">5Iii", head)
        assert (command, device, direction, endpoint) == (3, 0, 0, 0)
        return number, status, length, self.receive(client, length) if inward else b""

    def gone(self, client: socket.socket) -> bool:
        try:
            return self.receive(client, 1 << 24, 50) == b""
        except AssertionError:
            return False
        except ConnectionResetError:
            return True

    def close(self) -> None:
        for client in self.clients:
            client.close()
        self.server.close()


@pytest.fixture
def wire(bench: Any, echo: Echo) -> Iterator[Wire]:
    made = Wire(bench, echo)
    made.run(150)
    yield made
    made.close()


def test_devices_are_listed_when_they_are_enumerated(bench: Any, echo: Echo) -> None:
    other = type(echo)()
    wire = Wire(bench, echo, other)
    try:
        early = wire.client(LIST)  # waits until the devices have settled
        head = wire.receive(early, 12)
        assert head == struct.pack(">HHII", 0x0111, 5, 0, 2)
        rows = [wire.receive(early, 316) for _ in range(2)]
        for number, row in enumerate(rows, 1):
            assert row[256:288].rstrip(b"\0") == f"{number}-1".encode()
            assert struct.unpack(">IIIHHHBBBBBB", row[288:312]) == (
                *(number, 2, 2, 0x1209, 1, 0x0100),
                *(0, 0, 0, 1, 1, 1),
            )
            assert row[312:] == bytes([255, 0, 0, 0])
        other.attached = False
        wire.run(5)
        assert wire.receive(wire.client(LIST), 12) == struct.pack(">HHII", 0x0111, 5, 0, 1)
    finally:
        wire.close()


def test_an_import_is_granted_once_when_the_device_is_there(wire: Wire) -> None:
    assert wire.receive(wire.client(import_("9-9")), 8) == struct.pack(">HHI", 0x0111, 3, 4)
    first = wire.imported()
    assert wire.receive(wire.client(import_("1-1")), 8) == struct.pack(">HHI", 0x0111, 3, 2)
    first.close()
    wire.run(150)  # its device is reset and enumerated again
    wire.imported()


def test_urbs_become_transfers_in_both_directions(wire: Wire) -> None:
    client = wire.imported()
    data = bytes(range(200))
    client.sendall(submit(1, 1, data) + submit(2, 1, 200))
    assert wire.answer(client) == (1, 0, 200, b"")
    assert wire.answer(client, inward=True) == (2, 0, 200, data)
    client.sendall(submit(3, 0, 18, setup=request(0x80, 6, 0x100, 0, 18)))
    number, status, _, device = wire.answer(client, inward=True)
    assert (number, status, device[8:10]) == (3, 0, b"\x09\x12")
    client.sendall(submit(4, 2, 2))
    assert wire.answer(client, inward=True)[1:3] == (0, 2)


def test_a_client_is_heard_within_a_slice_of_the_boards_time(wire: Wire) -> None:
    client = wire.imported()
    for number in range(1, 5):
        client.sendall(submit(number, 1, b"soon"))
        wire.context.run_to(wire.context.cycle + FRAME // 3)  # without `exchange`
        client.settimeout(2)
        assert client.recv(48)[4:8] == bytes([0, 0, 0, number])


def test_what_cannot_be_is_answered_with_linuxs_numbers(wire: Wire, echo: Echo) -> None:
    client = wire.imported()
    cases = [
        (submit(1, 0, 4, setup=request(0xC0, 0x77, 0, 0, 4)), PIPE),
        (submit(2, 5, b"x"), NOENT),
        (submit(3, 1, b"x", packets=3), INVALID),
        (submit(4, 1, b"x", device=0x20002), NODEV),
        (submit(5, 0, 2, setup=request(0x80, 6, 0x100, 0, 18)), INVALID),
        (submit(6, 0, b"", setup=request(0, 5, 9)), 0),  # the address is the server's
        (submit(7, 0, b"", setup=request(0, 9, 1)), 0),
    ]
    for data, status in cases:
        client.sendall(data)
        assert wire.answer(client)[1] == status
    assert echo.address == 1
    echo.halted = True
    client.sendall(submit(8, 1, b"x"))
    assert wire.answer(client)[1] == PIPE
    echo.halted, echo.echo = False, b"short"
    client.sendall(submit(9, 1, 64, flags=SHORT_NOT_OK))
    assert wire.answer(client, inward=True)[1:] == (REMOTEIO, 5, b"short")


def test_a_waiting_urb_is_unlinked_when_asked(wire: Wire, echo: Echo) -> None:
    client = wire.imported()
    client.sendall(submit(1, 1, 64))
    wire.run(3)
    client.sendall(unlink(2, 1))
    assert struct.unpack_from(">5Ii", wire.receive(client, 48)) == (4, 2, 0, 0, 0, CONNRESET)
    client.sendall(unlink(3, 1))
    assert struct.unpack_from(">5Ii", wire.receive(client, 48)) == (4, 3, 0, 0, 0, 0)
    echo.echo = b"still there"
    client.sendall(submit(4, 1, 64))
    assert wire.answer(client, inward=True) == (4, 0, 11, b"still there")


def test_a_clients_reset_enumerates_the_device_again(wire: Wire, echo: Echo) -> None:
    client = wire.imported()
    resets = echo.heard.count("reset")
    client.sendall(submit(1, 0, b"", setup=request(0x23, 3, 4, 1)))
    assert wire.answer(client)[:2] == (1, 0)
    assert echo.heard.count("reset") == resets + 1 and echo.address == 1
    client.sendall(submit(2, 1, b"after"))
    assert wire.answer(client)[:2] == (2, 0)


def test_a_connection_ends_when_its_device_goes(wire: Wire, echo: Echo) -> None:
    client = wire.imported()
    client.sendall(submit(1, 1, 64))
    wire.run(2)
    echo.attached = False
    assert wire.answer(client)[:2] == (1, SHUTDOWN)
    assert wire.gone(client)
    echo.attached = True
    wire.run(160)
    wire.imported()


def test_a_client_that_goes_leaves_nothing_under_way(wire: Wire, echo: Echo) -> None:
    client = wire.imported()
    client.sendall(submit(1, 1, 64) + submit(2, 1, b"x" * 50))
    wire.run(2)
    resets = echo.heard.count("reset")
    client.close()
    wire.run(3)
    assert wire.hosts[0].pending == () and echo.heard.count("reset") == resets + 1


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"GET / HTTP/1.1\r\n\r\n", r"USB/IP version 0x4745 operation 0x5420, expected a list"),
        (struct.pack(">HHI", 0x0111, 0x8001, 0), r"operation 0x8001"),
        (import_("1-1") + struct.pack(">12I", 9, *[0] * 11), r"USB/IP command 9 of 0 bytes"),
        (import_("1-1") + submit(1, 1, TRANSFER_MAX + 1), rf"of {TRANSFER_MAX + 1} bytes"),
        (import_("1-1") + struct.pack(">7I20x", 1, 1, 0x10002, 0, 1, 0, 0xFFFFFFFF), r"of -1 bytes"),
        (import_("1-1") + submit(1, 1, 64) * 2, r"number 1, expected a URB of a new number"),
    ],
)
def test_what_is_no_usbip_ends_the_connection(wire: Wire, data: bytes, says: str) -> None:
    wire.client(data)
    wire.run(3)
    assert re.search(says, wire.server.refusal), wire.server.refusal
    wire.run(150)
    wire.imported()


def test_clients_beyond_the_limit_are_turned_away(wire: Wire) -> None:
    kept = [wire.client() for _ in range(CLIENTS_MAX)]
    assert wire.gone(wire.client(LIST))
    kept[0].sendall(LIST)
    assert wire.receive(kept[0], 12)


def test_a_client_that_asks_too_much_waits(wire: Wire) -> None:
    client = wire.imported()
    count = URBS_MAX + 20
    client.sendall(b"".join(submit(i + 1, 1, 64) for i in range(count)))
    wire.run(5)
    assert len(wire.hosts[0].pending) == URBS_MAX
    client.sendall(unlink(1000, 1))  # waits behind them
    wire.hosts[0].cancel_all()
    wire.run(3)
    assert len(wire.hosts[0].pending) <= 20


def test_a_taken_port_is_named(wire: Wire) -> None:
    with pytest.raises(LinkError, match=rf"USB/IP port {wire.server.port}: .*expected a free port"):
        UsbIpServer([], wire.server.port)


def test_pyusb_finds_the_device_and_talks_to_it(wire: Wire) -> None:
    backend = pytest.importorskip("usbip_backend.backend")
    core = pytest.importorskip("usb.core")
    results: list[object] = []

    def talk() -> None:
        try:
            device = core.find(
                backend=backend.USBIPBackend("127.0.0.1", wire.server.port), idVendor=0x1209, idProduct=1
            )
            device.set_configuration()
            results.append([e.bEndpointAddress for e in device[0][0, 0]])
            results.append(device.write(1, b"to and fro"))
            results.append(bytes(device.read(0x81, 64)))
            try:
                device.ctrl_transfer(0xC0, 0x77, 0, 0, 4)
            except core.USBError as error:
                results.append(error.backend_error_code or error.errno)
        except BaseException as error:
            results.append(error)

    thread = threading.Thread(target=talk)
    thread.start()
    while thread.is_alive():
        wire.run()
    thread.join()
    assert results[:3] == [[1, 0x81, 0x82], 10, b"to and fro"], results
    assert results[3] in (-PIPE, PIPE)
