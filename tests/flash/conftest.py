"""Peers for the tests of flash: a scripted line without a clock, a TCP server and an independent client."""

from __future__ import annotations

import contextlib
import os
import select
import socket
import threading
import tty
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from yamspy import MSPy

from neuroflight.cli.main import main
from tests.flash.lockstep import booted as booted
from tests.flash.lockstep import host as host
from tests.flash.peers import Answer, HostBoard, Run, host_board
from tests.flash.virtual_pad import plugged as plugged


class ScriptedLine:
    """A Transport whose reads hand out a script, None meaning silence; its clock moves only on silence."""

    name = "test line"

    def __init__(self, script: list[bytes | None]) -> None:
        self.script = script
        self.written: list[bytes] = []
        self.now = 0.0
        self.closed = False

    def read(self, timeout: float) -> bytes:
        assert timeout > 0
        data = self.script.pop(0) if self.script else None
        self.now += timeout if data is None else 0.001
        return data or b""

    def write(self, data: bytes) -> None:
        self.written.append(data)

    def close(self) -> None:
        self.closed = True

    def clock(self) -> float:
        return self.now


@pytest.fixture
def scripted_line() -> type[ScriptedLine]:
    """The class ScriptedLine."""
    return ScriptedLine


class TcpServer:
    """Answers each piece that a client sends, one client after another, until closed."""

    def __init__(self, answer: Answer) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._answer = answer
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    @property
    def port(self) -> str:
        return f"tcp:127.0.0.1:{self._listener.getsockname()[1]}"

    def _serve(self) -> None:
        while True:
            try:
                connection, _ = self._listener.accept()
            except OSError:
                return
            # A client may leave without reading all answers.
            with connection, contextlib.suppress(ConnectionError):
                while data := connection.recv(4096):
                    reply = self._answer(data)
                    if reply == b"HANG UP":
                        break
                    connection.sendall(reply)

    def close(self) -> None:
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self._thread.join(timeout=5)


@pytest.fixture
def tcp_server() -> Iterator[Callable[[Answer], str]]:
    """Start servers: give it a function from request bytes to reply bytes, get the port's name."""
    servers: list[TcpServer] = []

    def start(answer: Answer) -> str:
        servers.append(TcpServer(answer))
        return servers[-1].port

    yield start
    for server in servers:
        server.close()


@pytest.fixture
def free_tcp_port() -> int:
    """A port on which nobody listens."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return int(listener.getsockname()[1])


class ByteLine:
    """The serial port that yamspy believes it has: reads from given bytes, keeps what is written."""

    def __init__(self, incoming: bytes = b"") -> None:
        self.incoming = incoming
        self.written = b""

    def read(self, size: int = 1) -> bytes:
        data, self.incoming = self.incoming[:size], self.incoming[size:]
        return data

    def write(self, data: bytes) -> int:
        self.written += bytes(data)
        return len(data)


@pytest.fixture
def yamspy_peer() -> MSPy:
    """yamspy, an independent MSP client, whose line is a ByteLine."""
    peer = MSPy(device="", logfilename=None, loglevel="WARNING")
    peer.conn = ByteLine()
    peer.INAV = False  # what it finds out when it connects by itself
    return peer


# --- A firmware, and a line to it -------------------------------------------------------------------
@pytest.fixture
def resting_host(host_program: Path, tmp_path: Path) -> Iterator[str]:
    """The port of a host program whose flash is tmp_path/flash.bin; no sample ever comes to it."""
    with host_board(host_program, tmp_path / "flash.bin", restarts=False) as board:
        yield board.port


@pytest.fixture
def reviving_host(host_program: Path, tmp_path: Path) -> Iterator[HostBoard]:
    """A host program whose flash is tmp_path/flash.bin."""
    with host_board(host_program, tmp_path / "flash.bin") as board:
        yield board


@pytest.fixture
def msp(capsys: pytest.CaptureFixture[str]) -> Run:
    """Give it a port and words behind `board`: exit code, stdout, stderr."""

    def run(port: str, *words: str) -> tuple[int, str, str]:
        code = main(["board", *words, "--port", port])
        output = capsys.readouterr()
        assert output.err.count("\n") <= 1
        assert "\x1b" not in output.out
        return code, output.out, output.err

    return Run(run)


Change = Callable[[bytes], bytes]


class PtyLine:
    """A serial cable to a TCP server: a pty, with whatever happens to bytes on their way."""

    def __init__(self, port: str, down: Change, up: Change) -> None:
        """down: what arrives of a piece that the client sends, up: of one that the server sends."""
        host, number = port.removeprefix("tcp:").split(":")
        self._ours, self._theirs = os.openpty()
        tty.setraw(self._theirs)
        self._server = socket.create_connection((host, int(number)))
        self._stop, self._stopper = socket.socketpair()
        self._down, self._up = down, up
        self._thread = threading.Thread(target=self._carry, daemon=True)
        self._thread.start()

    @property
    def device(self) -> str:
        return os.ttyname(self._theirs)

    def _carry(self) -> None:
        while True:
            ready, _, _ = select.select([self._ours, self._server.fileno(), self._stop.fileno()], [], [])
            if self._stop.fileno() in ready:
                return
            if self._ours in ready:
                self._server.sendall(self._down(os.read(self._ours, 4096)))
            if self._server.fileno() in ready:
                data = self._server.recv(4096)
                if not data:
                    return
                os.write(self._ours, self._up(data))

    def close(self) -> None:
        self._stopper.send(b"x")
        self._thread.join(timeout=5)
        for end in (self._server, self._stop, self._stopper):
            end.close()
        os.close(self._theirs)
        os.close(self._ours)


@pytest.fixture
def pty_line() -> Iterator[Callable[..., str]]:
    """Lay cables: give it a port, and what happens to bytes `down` and `up`; get the pty's device."""
    lines: list[PtyLine] = []

    def lay(port: str, down: Change = bytes, up: Change = bytes) -> str:
        lines.append(PtyLine(port, down, up))
        return lines[-1].device

    yield lay
    for line in lines:
        line.close()
