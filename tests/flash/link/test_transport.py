"""Transports over a real pty pair and a real TCP server, and what is said when a port cannot be had."""

from __future__ import annotations

import os
import tty
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from neuroflight.flash.link.transport import SerialPort, TcpPort, open_transport, parse_port
from neuroflight.toolchain.errors import LinkError


@pytest.fixture
def pty_pair() -> Iterator[tuple[int, str]]:
    """A serial cable: the descriptor of one end, the device name of the other."""
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    yield ours, os.ttyname(theirs)
    os.close(theirs)
    os.close(ours)


def refusal(port: str) -> str:
    """The one line that opening `port` ends in."""
    with pytest.raises(LinkError) as caught:
        open_transport(port)
    line = str(caught.value)
    assert "\n" not in line and "expected" in line
    return line


# --- Names of ports --------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("text", "port"),
    [
        ("tcp:127.0.0.1:5761", TcpPort("127.0.0.1", 5761)),
        ("tcp:bench.local:1", TcpPort("bench.local", 1)),
        ("tcp:[::1]:65535", TcpPort("::1", 65535)),
        ("/dev/ttyUSB0", SerialPort("/dev/ttyUSB0", 115200)),
        ("serial:/dev/ttyUSB0", SerialPort("/dev/ttyUSB0", 115200)),
        ("serial:/dev/ttyACM0:921600", SerialPort("/dev/ttyACM0", 921600)),
        ("COM3", SerialPort("COM3", 115200)),
    ],
)
def test_port_is_understood_when_of_a_known_form(text: str, port: TcpPort | SerialPort) -> None:
    assert parse_port(text) == port
    assert parse_port(str(port)) == port


@pytest.mark.parametrize(
    "text",
    [
        *("", "ttyUSB0", "udp:127.0.0.1:5761", "COM", "tcp:", "tcp:5761", "tcp::5761", "tcp:host"),
        *("tcp:host:", "tcp:host:0", "tcp:host:65536", "tcp:host:-1", "tcp:host:five", "tcp:host:5761 "),
        "tcp:host:" + "9" * 5000,
        *("serial:", "serial::115200", "serial:/dev/x:0", "serial:/dev/x:fast", "tcp:a\nb:1", "/dev/tty\0"),
    ],
)  # fmt: skip
def test_port_is_refused_in_one_line_when_of_no_known_form(text: str) -> None:
    refusal(text)


# --- TCP -------------------------------------------------------------------------------------
def test_bytes_go_and_come_when_a_tcp_server_answers(tcp_server: Callable[..., str]) -> None:
    port = tcp_server(lambda data: data[::-1])
    line = open_transport(port)
    assert line.name == port
    line.write(b"abc")
    assert line.read(5.0) == b"cba"
    assert line.read(0.01) == b""
    line.write(b"xyz")
    assert line.read(5.0) == b"zyx"
    line.close()
    line.close()


def test_refusal_says_nobody_listens_when_the_tcp_port_is_free(free_tcp_port: int) -> None:
    line = refusal(f"tcp:127.0.0.1:{free_tcp_port}")
    assert f"tcp:127.0.0.1:{free_tcp_port}: nobody listens there" in line and "start the firmware" in line


@pytest.mark.parametrize("host", ["no-such-host.invalid", "a" * 64 + ".invalid", "host..invalid"])
def test_refusal_names_the_host_when_it_does_not_resolve(host: str) -> None:
    assert f"the host name {host!r} does not resolve" in refusal(f"tcp:{host}:5761")


def test_reading_says_closed_when_the_tcp_server_hangs_up(tcp_server: Callable[..., str]) -> None:
    line = open_transport(tcp_server(lambda data: b"HANG UP"))
    line.write(b"?")
    with pytest.raises(LinkError, match="closed the connection, expected"):
        line.read(5.0)
    line.close()


def test_line_is_gone_when_used_after_close(tcp_server: Callable[..., str]) -> None:
    line = open_transport(tcp_server(lambda data: data))
    line.close()
    with pytest.raises(LinkError, match="the line is gone"):
        line.write(b"?")
    with pytest.raises(LinkError, match="the line is gone"):
        line.read(0.01)


# --- Serial ----------------------------------------------------------------------------------
@pytest.mark.parametrize("form", ["{}", "serial:{}", "serial:{}:57600"])
def test_bytes_go_and_come_when_a_pty_is_opened(form: str, pty_pair: tuple[int, str]) -> None:
    ours, device = pty_pair
    line = open_transport(form.format(device))
    everything = bytes(range(256))
    line.write(everything)
    assert os.read(ours, 1000) == everything
    os.write(ours, everything)
    heard = b""
    while len(heard) < len(everything):
        piece = line.read(5.0)
        assert piece
        heard += piece
    assert heard == everything
    assert line.read(0.01) == b""
    line.close()
    line.close()


def test_line_is_gone_when_the_serial_port_was_closed(pty_pair: tuple[int, str]) -> None:
    line = open_transport(pty_pair[1])
    line.close()
    with pytest.raises(LinkError, match="the line is gone"):
        line.write(b"?")
    with pytest.raises(LinkError, match="the line is gone"):
        line.read(0.01)


def test_line_is_gone_when_the_board_is_unplugged() -> None:
    ours, theirs = os.openpty()
    line = open_transport(os.ttyname(theirs))
    os.close(theirs)
    os.close(ours)
    with pytest.raises(LinkError, match="the line is gone"):
        line.read(5.0)
    line.close()


def test_refusal_says_in_use_when_the_serial_port_is_open_elsewhere(pty_pair: tuple[int, str]) -> None:
    line = open_transport(pty_pair[1])
    assert "the device is in use" in refusal(pty_pair[1])
    line.close()


def test_refusal_says_no_such_device_when_it_is_missing(tmp_path: Path) -> None:
    line = refusal(f"serial:{tmp_path}/ttyUSB0")
    assert "there is no such device" in line and "plug the board in" in line


def test_refusal_comes_when_the_device_is_a_file(tmp_path: Path) -> None:
    (tmp_path / "notes").write_text("not a port")
    assert "cannot be opened as a serial port" in refusal(f"{tmp_path}/notes")
    assert (tmp_path / "notes").read_text() == "not a port"


# --- Parity ----------------------------------------------------------------------------------
def test_parity_is_even_when_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[str] = []

    def remember(*_: object, parity: str, **__: object) -> None:
        opened.append(parity)

    monkeypatch.setattr("serial.Serial", remember)
    for device in ("/dev/null", "/dev/ttyUSB0"):
        open_transport(device, "E")
        open_transport(device)
    assert opened == ["E", "N"] * 2


def test_pseudo_terminal_carries_bytes_when_parity_is_asked_for(pty_pair: tuple[int, str]) -> None:
    """The system refuses a parity there."""
    ours, name = pty_pair
    transport = open_transport(name, "E")
    transport.write(b"\x7f")
    assert os.read(ours, 10) == b"\x7f"
    os.write(ours, b"\x79")
    assert transport.read(1.0) == b"\x79"
    transport.close()
