"""Lines to a flight controller: a serial port or a TCP socket behind one small interface.

A port is written `tcp:HOST:PORT`, `serial:DEVICE[:BAUD]` or simply as the device. Whatever goes wrong
with a line becomes a LinkError of one sentence that says how to mend it.
"""

from __future__ import annotations

import errno
import os
import socket
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Protocol

import serial

from neuroflight.toolchain.contract import MSP_BAUD_DEFAULT
from neuroflight.toolchain.errors import LinkError

CONNECT_TIMEOUT_S = 3.0
WRITE_TIMEOUT_S = 2.0
READ_BYTES_MAX = 4096
PSEUDO_TERMINALS = range(136, 144)  # major numbers of their devices on Linux

PORT_FORMS = "tcp:HOST:PORT, serial:DEVICE[:BAUD] or a device such as /dev/ttyUSB0"


class LineGoneError(LinkError):
    """An open line was lost."""


class Transport(Protocol):
    """An open line. Every method raises LineGoneError once the line is lost."""

    @property
    def name(self) -> str:
        """The port as the user would write it."""

    def read(self, timeout: float) -> bytes:
        """Read what has arrived, or what arrives first within `timeout` > 0 [s]; b"" for silence."""

    def write(self, data: bytes) -> None:
        """Send all of `data`."""

    def close(self) -> None:
        """Close the line; may be called twice."""


@dataclass(frozen=True)
class TcpPort:
    """Address of a TCP server; `port` 1..65535."""

    host: str
    port: int

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"tcp:{host}:{self.port}"


@dataclass(frozen=True)
class SerialPort:
    """A serial device and its speed in baud."""

    device: str
    baud: int = MSP_BAUD_DEFAULT

    def __str__(self) -> str:
        return f"serial:{self.device}:{self.baud}"


def parse_port(text: str) -> TcpPort | SerialPort:
    """Read a port as the user wrote it. Raises LinkError that lists the forms."""
    if not text.isprintable():
        raise LinkError(f"port {text!r} holds unprintable characters, expected {PORT_FORMS}")
    scheme, _, rest = text.partition(":")
    if scheme == "tcp":
        return _parse_tcp(text, rest)
    if scheme == "serial":
        return _parse_serial(text, rest)
    if text.startswith("/") or (text.upper().startswith("COM") and text[3:].isdecimal()):
        return SerialPort(text)
    raise LinkError(f"port {text!r} is of no known form, expected {PORT_FORMS}")


def open_transport(text: str, parity: str = "N") -> Transport:
    """Open the port that `text` names. Raises LinkError when it is malformed or cannot be opened.

    parity: of a serial port, "N" or "E"; TCP has none, and a pseudo terminal ignores it.
    """
    port = parse_port(text)
    return TcpTransport(port) if isinstance(port, TcpPort) else SerialTransport(port, parity)


def line_baud(text: str) -> int | None:
    """Return the speed of the serial line that `text` names; None where a baud rate limits nothing: TCP, USB.

    A serial port by USB's own class of modems (CDC ACM), which Linux calls ttyACM, has no line behind it.
    Raises LinkError.
    """
    port = parse_port(text)
    if isinstance(port, TcpPort) or os.path.realpath(port.device).startswith("/dev/ttyACM"):
        return None
    return port.baud


def _parse_tcp(text: str, rest: str) -> TcpPort:
    host, _, number = rest.rpartition(":")
    host = host.removeprefix("[").removesuffix("]")
    if not host or not _is_number(number) or not 1 <= int(number) <= 65535:
        raise LinkError(f"port {text!r} names no TCP server, expected tcp:HOST:PORT with PORT 1..65535")
    return TcpPort(host, int(number))


def _parse_serial(text: str, rest: str) -> SerialPort:
    device, separator, baud = rest.rpartition(":")
    if not separator:
        device, baud = rest, str(MSP_BAUD_DEFAULT)
    if not device or not _is_number(baud) or int(baud) < 1:
        raise LinkError(f"port {text!r} names no serial port, expected serial:DEVICE[:BAUD], BAUD above 0")
    return SerialPort(device, int(baud))


def _is_number(text: str) -> bool:
    return text.isascii() and text.isdecimal() and len(text) <= 9


class TcpTransport:
    """A TCP connection, such as to the host program's MSP port."""

    def __init__(self, port: TcpPort) -> None:
        """Connect. Raises LinkError when the host is unknown or nobody answers within 3 s."""
        self._name = str(port)
        try:
            self._socket = socket.create_connection((port.host, port.port), CONNECT_TIMEOUT_S)
        except ConnectionRefusedError:
            raise LinkError(
                f"{port}: nobody listens there, expected a firmware's MSP server; "
                "start the firmware first or correct the port number"
            ) from None
        except TimeoutError:
            raise LinkError(
                f"{port}: no answer within {CONNECT_TIMEOUT_S:g} s, expected a connection; "
                "check the address and the network"
            ) from None
        except (socket.gaierror, UnicodeError, ValueError):
            raise LinkError(
                f"{port}: the host name {port.host!r} does not resolve, expected a name or an address; "
                "check its spelling or give the address"
            ) from None
        except OSError as error:
            raise LinkError(
                f"{port}: {_sentence(error)}, expected a connection; check the address and the network"
            ) from None

    @property
    def name(self) -> str:
        """The port as the user would write it."""
        return self._name

    def read(self, timeout: float) -> bytes:
        """See Transport."""
        try:
            self._socket.settimeout(timeout)
            data = self._socket.recv(READ_BYTES_MAX)
        except TimeoutError:
            return b""
        except OSError as error:
            raise _lost(self._name, error) from None
        if not data:
            raise LineGoneError(
                f"{self._name}: the other end closed the connection, expected a reply; "
                "check that the firmware still runs and serves nobody else"
            )
        return data

    def write(self, data: bytes) -> None:
        """See Transport."""
        try:
            self._socket.settimeout(WRITE_TIMEOUT_S)
            self._socket.sendall(data)
        except OSError as error:
            raise _lost(self._name, error) from None

    def close(self) -> None:
        """See Transport."""
        self._socket.close()


class SerialTransport:
    """A serial port, 8N1 or 8E1, held for this program alone."""

    def __init__(self, port: SerialPort, parity: str = "N") -> None:
        """Open the device. Raises LinkError when it is missing, busy, forbidden or no serial port."""
        self._name = str(port)
        if _is_pseudo_terminal(port.device):
            parity = "N"  # the system refuses any other
        try:
            self._serial = serial.Serial(
                port.device, port.baud, parity=parity, write_timeout=WRITE_TIMEOUT_S, exclusive=True
            )
        except (OSError, ValueError, OverflowError) as error:
            got, mend = _OPEN_FAILURES.get(getattr(error, "errno", None) or 0, _OPEN_FAILURE_UNKNOWN)
            raise LinkError(f"{port}: {got}, expected a free serial port; {mend}") from None

    @property
    def name(self) -> str:
        """The port as the user would write it."""
        return self._name

    def read(self, timeout: float) -> bytes:
        """See Transport."""
        with self._guarded():
            self._serial.timeout = timeout
            first: bytes = self._serial.read(1)
            waiting = min(self._serial.in_waiting, READ_BYTES_MAX - 1) if first else 0
            rest: bytes = self._serial.read(waiting) if waiting else b""
            return first + rest

    def write(self, data: bytes) -> None:
        """See Transport."""
        with self._guarded():
            self._serial.write(data)

    def close(self) -> None:
        """See Transport."""
        self._serial.close()

    @contextmanager
    def _guarded(self) -> Iterator[None]:
        try:
            yield
        except (OSError, TypeError) as error:  # TypeError: pyserial's reaction to its closed handle
            raise _lost(self._name, error) from None


def _is_pseudo_terminal(device: str) -> bool:
    """Return True for a pseudo-terminal of Linux, which transmits bytes without a speed."""
    try:
        status = os.stat(device)  # noqa: PTH116 - whatever was written, a path or not
    except (OSError, ValueError):
        return False
    return stat.S_ISCHR(status.st_mode) and os.major(status.st_rdev) in PSEUDO_TERMINALS


_PLUG = "plug the board in and check the device's name"
_PERMIT = "`neuroflight doctor` says how to get it"
_OPEN_FAILURES = {
    errno.ENOENT: ("there is no such device", _PLUG),
    errno.ENODEV: ("there is no such device", _PLUG),
    errno.ENXIO: ("there is no such device", _PLUG),
    errno.EACCES: ("permission denied", _PERMIT),
    errno.EPERM: ("permission denied", _PERMIT),
    errno.EBUSY: ("the device is in use", "close the other program that has it open"),
    errno.EAGAIN: ("the device is in use", "close the other program that has it open"),
}
_OPEN_FAILURE_UNKNOWN = (
    "the device cannot be opened as a serial port at this speed",
    "check the device's name and the baud rate",
)


def _lost(name: str, error: Exception) -> LineGoneError:
    return LineGoneError(
        f"{name}: the line is gone ({_sentence(error)}), expected it to stay open; "
        "check the cable and that the firmware still runs"
    )


def _sentence(error: Exception) -> str:
    """Return the system's message without number or path, on one line."""
    text = getattr(error, "strerror", None) or str(error) or type(error).__name__
    return " ".join(text.split()).lower()
